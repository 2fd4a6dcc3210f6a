"""Processors stay awake while set points pass, and no longer."""

from __future__ import annotations

import os
import socket
import struct
from contextlib import closing
from pathlib import Path

import pytest

from bcapscope.cli import wakefulness
from bcapscope.cli.proxyrun import Proxy
from bcapscope.cli.proxywishes import Look, Wishes
from bcapscope.cli.wakefulness import AGAIN_AFTER, LONG, MUCH, LightSleep, Wakefulness, passed, stolen
from bcapscope.proxy.ring import Count

LOOK = 0.05


class Scene:
    """A relay that looks twenty times a second."""

    def __init__(self) -> None:
        self.asked: list[tuple[float, bool]] = []
        self.now, self.passed, self.taken = 100.0, 0, 0.0
        self.wakefulness = Wakefulness(self._note, lambda: self.taken)

    def _note(self, awake: bool) -> None:
        self.asked.append((round(self.now, 2), awake))

    def go_on(self, seconds: float, each_look: int, stolen: float = 0.0) -> None:
        """Pass some datagrams between two looks, while the host takes a share of the time."""
        for _ in range(round(seconds / LOOK)):
            self.now += LOOK
            self.passed += each_look
            self.taken += stolen * LOOK
            self.wakefulness.look(self.passed, self.now)


def test_they_stay_awake_from_the_first_look_at_which_much_has_passed() -> None:
    scene = Scene()
    scene.go_on(10, MUCH - 1)
    assert scene.asked == []
    scene.go_on(10, MUCH)
    assert scene.asked == [(110.05, True)]


def test_they_may_sleep_a_second_after_that() -> None:
    scene = Scene()
    scene.go_on(10, MUCH)
    scene.go_on(LONG - 2 * LOOK, 0)
    assert scene.asked == [(100.05, True)]
    scene.go_on(10, MUCH - 1)
    (_, (when, awake)) = scene.asked
    assert not awake
    assert when == pytest.approx(110 + LONG, abs=2 * LOOK)
    scene.go_on(LOOK, MUCH)
    assert scene.asked[2:] == [(round(scene.now, 2), True)]


def test_a_host_that_takes_much_of_the_time_is_left_in_peace_for_a_minute() -> None:
    scene = Scene()
    scene.go_on(10, 50, stolen=0.04)
    assert scene.asked == [(100.05, True)]
    scene.go_on(AGAIN_AFTER, 50, stolen=0.2)
    (_, (when, awake)) = scene.asked
    assert not awake
    assert 110 < when <= 111.1
    scene.go_on(5, 50)
    (*_, (again, awake)) = scene.asked
    assert awake
    assert again - when == pytest.approx(AGAIN_AFTER, abs=2 * LOOK)
    scene.go_on(100, 50)  # what it took meanwhile counts no more
    assert len(scene.asked) == 3


def test_at_the_end_they_may_sleep() -> None:
    scene = Scene()
    scene.wakefulness.end()
    assert scene.asked == []
    scene.go_on(1, MUCH)
    scene.wakefulness.end()
    assert [awake for _, awake in scene.asked] == [True, False]


def test_pieces_of_streams_count_as_well() -> None:
    counts = [0] * len(Count)
    counts[Count.CAME_UP], counts[Count.CAME_DOWN], counts[Count.LEFT_UP] = 3, 4, 1000
    counts[Count.BYTES_UP], counts[Count.BYTES_DOWN] = 100, 92
    assert passed(counts) == 3 + 4 + 3


@pytest.fixture
def device(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Path:
    """Return what is asked instead of Linux."""
    path = tmp_path / "cpu_dma_latency"
    path.touch()
    monkeypatch.setattr(wakefulness, "_DEVICE", path)
    return path


def is_asked(device: Path, descriptor: int | None) -> bool:
    """Tell whether that is the device, open."""
    try:
        return os.path.samestat(os.fstat(-1 if descriptor is None else descriptor), device.stat())
    except OSError:
        return False


@pytest.mark.parametrize(("driver", "longest"), [("haltpoll\n", 0), ("intel_idle\n", 2), (None, 2)])
def test_what_is_asked_of_linux(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, device: Path, driver: str | None, longest: int
) -> None:
    monkeypatch.setattr(wakefulness, "_DRIVER", tmp_path / "current_driver")
    if driver is not None:
        (tmp_path / "current_driver").write_text(driver)
    light_sleep = LightSleep()
    light_sleep(True)
    asked = light_sleep._asked
    assert is_asked(device, asked)
    assert struct.unpack("@i", device.read_bytes()) == (longest,)
    light_sleep(False)
    assert not is_asked(device, asked)
    light_sleep(False)
    light_sleep(True)
    assert is_asked(device, light_sleep._asked)
    light_sleep(False)


def test_who_may_not_ask_does_without(device: Path) -> None:
    device.unlink()
    light_sleep = LightSleep()
    for wanted in (True, False, True, False):
        light_sleep(wanted)
    assert not device.exists()
    device.touch()
    light_sleep(True)
    assert not device.read_bytes()  # refused for good


@pytest.mark.parametrize(
    ("text", "seconds"),
    [
        ("cpu  1 2 3 4 5 6 7 800 9 10\ncpu0 0 0 0 0 0 0 0 0\n", 2.0),
        ("cpu 1 2 3\n", 0.0),
        ("", 0.0),
        (None, 0.0),
    ],
)
def test_the_time_that_the_host_took(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, text: str | None, seconds: float
) -> None:
    monkeypatch.setattr(wakefulness, "_STATISTICS", tmp_path / "stat")
    monkeypatch.setattr("os.cpu_count", lambda: 4)
    monkeypatch.setattr("os.sysconf", {"SC_CLK_TCK": 100}.__getitem__)
    if text is not None:
        (tmp_path / "stat").write_text(text)
    assert stolen() == seconds


def test_a_proxy_asks_while_much_passes_and_no_more_once_it_is_closed(device: Path) -> None:
    here, there = socket.socketpair()
    with here, there, closing(Proxy(Wishes(None, None, Look(None), "never"), here)) as proxy:
        light_sleep = proxy._wakefulness._keep_awake
        assert isinstance(light_sleep, LightSleep)
        proxy._look_around()
        assert not device.read_bytes()
        proxy._ring.counts[Count.CAME_UP] += 1000
        proxy._look_around()
        asked = light_sleep._asked
        assert is_asked(device, asked)
        assert device.read_bytes()
    assert not is_asked(device, asked)
