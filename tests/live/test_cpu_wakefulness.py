"""Processors stay awake while set points pass, and no longer."""

from __future__ import annotations

import os
import socket
import struct
import sys
from collections.abc import Iterator
from contextlib import closing, contextmanager
from io import BytesIO
from pathlib import Path

import numpy as np
import pytest

from bcapscope.live import cpu_wakefulness
from bcapscope.live.cpu_wakefulness import (
    BUSY_WITHIN,
    MAX_STOLEN_SHARE,
    PAUSED_FOR,
    CpuWakefulness,
    datagrams_passed,
    low_latency_problem,
)
from bcapscope.live.proxy_options import ProxyOptions, ViewOptions
from bcapscope.live.proxy_supervisor import ProxySupervisor
from bcapscope.proxy.ring_buffer import RelayCounter
from tests.english import english

LOOK = 0.05
LINUX = pytest.mark.skipif(sys.platform != "linux", reason="Linux can be asked")


@pytest.fixture
def device(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Path:
    """Return what is asked instead of Linux."""
    path = tmp_path / "cpu_dma_latency"
    path.touch()
    monkeypatch.setattr(cpu_wakefulness, "_DEVICE", path)
    monkeypatch.setattr(cpu_wakefulness, "_CPU_FOLDER", tmp_path)
    monkeypatch.setattr(cpu_wakefulness, "_STATISTICS", tmp_path / "stat")
    (tmp_path / "stat").write_text(f"cpu  {'12345678901 ' * 7}800 9 10\ncpu0 0 0 0 0 0 0 0 0\n")
    return path


def be_driven_by(folder: Path, driver: str, *latencies: int) -> None:
    """Say what puts the processors to sleep, and how many µs they take to wake from each of its states."""
    (folder / "cpuidle").mkdir()
    (folder / "cpuidle" / "current_driver").write_text(f"{driver}\n")
    for number, latency in enumerate(latencies):
        state = folder / "cpu0" / "cpuidle" / f"state{number}"
        state.mkdir(parents=True)
        (state / "latency").write_text(f"{latency}\n")
        (state / "disable").write_text("0\n")


def descriptors() -> int:
    """Return how many files are open."""
    return len(os.listdir("/proc/self/fd"))


@contextmanager
def closing_limit(wakefulness: CpuWakefulness) -> Iterator[CpuWakefulness]:
    """Let the processors sleep in the end."""
    try:
        yield wakefulness
    finally:
        wakefulness.allow_deep_sleep()


class Statistics:
    """What /proc/stat says of a host that took so many seconds, and when it was read."""

    def __init__(self) -> None:
        self.now, self.taken = 0.0, 0.0
        self.read_at: list[float] = []

    def open(self, mode: str) -> BytesIO:
        """Return the file, as `Path.open` does."""
        self.read_at.append(self.now)
        return BytesIO(f"cpu  {'0 ' * 7}{round(self.taken * 100)} 9 10\n".encode())


class Scene:
    """A relay that looks twenty times a second, and processors that are watched."""

    def __init__(self, statistics: Statistics) -> None:
        self.seen: list[tuple[float, str]] = []
        self.now, self.count = 100.0, 0
        self.statistics = statistics
        self.wakefulness = CpuWakefulness()

    @property
    def states(self) -> list[str]:
        return [what for _, what in self.seen]

    def go_on(self, seconds: float, a_second: float, robbed: float = 0.0) -> None:
        """Pass so many datagrams, while the host takes a share of a processor's time."""
        start, already = self.now, self.count
        while self.now < start + seconds - LOOK / 2:
            self.now += LOOK
            self.count = already + int((self.now - start) * a_second)
            self.statistics.now = self.now
            self.statistics.taken += robbed * LOOK
            before = self.wakefulness.is_limit_set
            self.wakefulness.update(self.count, self.now)
            if self.wakefulness.is_limit_set != before:
                self.seen.append((round(self.now, 2), "asleep" if before else "awake"))


@pytest.fixture
def scene(monkeypatch: pytest.MonkeyPatch, tmp_path: Path, device: Path) -> Scene:
    """Return a guest of a host that can take its time."""
    statistics = Statistics()
    monkeypatch.setattr(cpu_wakefulness, "_STATISTICS", statistics)
    monkeypatch.setattr("os.sysconf", {"SC_CLK_TCK": 100}.__getitem__)
    be_driven_by(tmp_path, "haltpoll")
    return Scene(statistics)


@LINUX
@pytest.mark.parametrize(("a_second", "after"), [(250, 0.4), (2000, 0.05), (40_000, 0.05), (110, 0.95)])
def test_they_stay_awake_as_soon_as_much_has_passed(scene: Scene, a_second: float, after: float) -> None:
    scene.go_on(30, a_second)
    ((when, what),) = scene.seen
    assert what == "awake"
    assert when - 100 == pytest.approx(after, abs=2 * LOOK)


@LINUX
def test_little_keeps_no_one_awake_nor_do_a_few_calls_at_once(scene: Scene) -> None:
    scene.go_on(100, 90)
    for _ in range(100):
        scene.go_on(LOOK, 30 / LOOK)
        scene.go_on(BUSY_WITHIN - LOOK, 0)
    assert scene.seen == []


@LINUX
def test_they_may_sleep_two_seconds_after_that(scene: Scene) -> None:
    scene.go_on(10, 2000)
    scene.go_on(30, 20)
    scene.go_on(1, 250)
    assert scene.states == ["awake", "asleep", "awake"]
    assert scene.seen[1][0] == pytest.approx(112, abs=2 * LOOK)


@LINUX
def test_a_host_that_takes_much_of_the_time_is_left_in_peace_for_a_minute(scene: Scene) -> None:
    scene.go_on(10, 250, robbed=0.8 * MAX_STOLEN_SHARE)
    assert scene.states == ["awake"]
    scene.go_on(30, 250, robbed=4 * MAX_STOLEN_SHARE)
    assert scene.states == ["awake", "asleep"]
    assert scene.seen[1][0] == pytest.approx(111, abs=BUSY_WITHIN)
    scene.go_on(30, 250, robbed=1)
    scene.go_on(200, 250)  # what it took meanwhile counts no more
    assert scene.states == ["awake", "asleep", "awake"]
    assert scene.seen[2][0] - scene.seen[1][0] == pytest.approx(60, abs=2 * LOOK)


@LINUX
@pytest.mark.parametrize(("robbed", "states"), [(0.04, ["awake"]), (0.06, ["awake", "asleep"])])
def test_how_much_a_host_may_take(scene: Scene, robbed: float, states: list[str]) -> None:
    scene.go_on(10, 2000, robbed=robbed)
    assert scene.states == states


@LINUX
def test_what_the_host_takes_is_measured_once_a_second_from_the_beginning_on(scene: Scene) -> None:
    scene.go_on(10.5, 2000)
    read_at = scene.statistics.read_at
    assert [read_at[0], *np.diff(read_at)] == pytest.approx([100.1, *[1.0] * 9], abs=2 * LOOK)


@LINUX
def test_a_host_that_takes_much_at_once(scene: Scene) -> None:
    scene.go_on(3, 2000, robbed=1)
    assert scene.states == ["awake", "asleep"]
    assert scene.seen[1][0] == pytest.approx(101.1, abs=2 * LOOK)


@LINUX
@pytest.mark.parametrize("text", ["", "cpu 1 2 3\n", "cpu 1 2 3 4 5 6 7 much\n", None])
def test_a_host_of_which_nothing_is_known_took_nothing(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, scene: Scene, text: str | None
) -> None:
    scene.go_on(10, 250)
    monkeypatch.setattr(cpu_wakefulness, "_STATISTICS", tmp_path / "other")
    if text is not None:
        (tmp_path / "other").write_text(text)
    scene.go_on(10, 250)
    scene.statistics.taken = 1000.0
    monkeypatch.setattr(cpu_wakefulness, "_STATISTICS", scene.statistics)
    scene.go_on(10, 250)
    assert scene.states == ["awake"]


@LINUX
def test_who_is_refused_asks_again_after_a_minute(scene: Scene, device: Path) -> None:
    device.unlink()
    scene.go_on(10, 250)
    device.touch()
    scene.go_on(PAUSED_FOR, 250)
    ((when, what),) = scene.seen
    assert what == "awake"
    assert when - 100.4 == pytest.approx(PAUSED_FOR, abs=2 * LOOK)


@LINUX
def test_at_the_end_they_may_sleep(scene: Scene, device: Path) -> None:
    scene.wakefulness.allow_deep_sleep()
    before = descriptors()
    scene.go_on(1, 250)
    assert scene.states == ["awake"]
    assert descriptors() == before + 1
    for _ in range(2):
        scene.wakefulness.allow_deep_sleep()
        assert descriptors() == before


def test_bytes_of_streams_count_as_well() -> None:
    counts = [0] * len(RelayCounter)
    counts[RelayCounter.CAME_UP], counts[RelayCounter.CAME_DOWN], counts[RelayCounter.LEFT_UP] = 3, 4, 1000
    counts[RelayCounter.BYTES_UP], counts[RelayCounter.BYTES_DOWN] = 100, 91
    assert datagrams_passed(counts) == 3 + 4 + 2


def set_limit(wakefulness: CpuWakefulness) -> bool:
    """Let much pass, and tell whether the limit could be set."""
    wakefulness.update(1000, 100.0)
    return wakefulness.is_limit_set


@LINUX
@pytest.mark.parametrize(
    ("driver", "latencies", "longest"),
    [
        ("intel_idle", (0, 3, 10, 200), 3),
        ("psci_idle", (1, 500), 1),
        ("none", (), 2),
        ("haltpoll", (0, 1), 0),
    ],
)
def test_what_is_asked_of_linux(
    tmp_path: Path, device: Path, driver: str, latencies: tuple[int, ...], longest: int
) -> None:
    be_driven_by(tmp_path, driver, *latencies)
    wakefulness, before = CpuWakefulness(), descriptors()
    for passed in (1000, 2000):
        wakefulness.update(passed, 100.0)
        assert wakefulness.is_limit_set
        assert struct.unpack("@i", device.read_bytes()) == (longest,)
        assert descriptors() == before + 1
        wakefulness.allow_deep_sleep()
        assert not wakefulness.is_limit_set
        assert descriptors() == before


@LINUX
def test_a_sleep_that_is_switched_off_is_not_the_lightest(tmp_path: Path, device: Path) -> None:
    be_driven_by(tmp_path, "intel_idle", 0, 1, 10)
    (tmp_path / "cpu0" / "cpuidle" / "state1" / "disable").write_text("1\n")
    with closing_limit(CpuWakefulness()) as wakefulness:
        assert set_limit(wakefulness)
    assert struct.unpack("@i", device.read_bytes()) == (10,)


@LINUX
@pytest.mark.parametrize("latency", ["", "soon", None])
def test_where_nobody_says_how_long_waking_takes_it_is_not_forbidden_to_sleep(
    tmp_path: Path, device: Path, latency: str | None
) -> None:
    be_driven_by(tmp_path, "intel_idle", 1)
    stated = tmp_path / "cpu0" / "cpuidle" / "state0" / "latency"
    if latency is None:
        stated.unlink()
    else:
        stated.write_text(latency)
    with closing_limit(CpuWakefulness()) as wakefulness:
        assert set_limit(wakefulness)
    assert struct.unpack("@i", device.read_bytes()) == (2,)


@LINUX
def test_who_may_not_ask_makes_no_file(device: Path) -> None:
    before = descriptors()
    device.unlink()
    assert not set_limit(CpuWakefulness())
    device.mkdir()
    assert not set_limit(CpuWakefulness())
    device.rmdir()
    assert not device.exists()
    assert descriptors() == before


@LINUX
def test_what_cannot_be_asked_is_left(tmp_path: Path, device: Path) -> None:
    before = descriptors()
    be_driven_by(tmp_path, "intel_idle", 1 << 32)
    assert not set_limit(CpuWakefulness())
    assert not device.read_bytes()
    (tmp_path / "cpuidle" / "current_driver").write_text("haltpoll")
    (tmp_path / "stat").unlink()
    assert not set_limit(CpuWakefulness())
    assert descriptors() == before


@LINUX
def test_a_host_can_take_no_time_from_those_that_sleep(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, device: Path
) -> None:
    statistics = Statistics()
    monkeypatch.setattr(cpu_wakefulness, "_STATISTICS", statistics)
    be_driven_by(tmp_path, "intel_idle")
    scene = Scene(statistics)
    scene.go_on(10, 250, robbed=1)
    assert scene.states == ["awake"]
    assert not statistics.read_at


@LINUX
def test_a_proxy_leaves_the_machine_alone_unless_low_latency_is_asked_for(device: Path) -> None:
    here, there = socket.socketpair()
    with (
        here,
        there,
        closing(ProxySupervisor(ProxyOptions(None, None, ViewOptions(None), "never"), here)) as proxy,
    ):
        opened = descriptors()
        proxy._ring.counts[RelayCounter.CAME_UP] += 1000
        proxy._do_periodic_work()
        assert not device.read_bytes()
        assert descriptors() == opened


@LINUX
def test_why_processors_cannot_be_kept_awake(device: Path) -> None:
    assert low_latency_problem() is None
    device.unlink()
    assert english(low_latency_problem()).startswith(f"cannot write {device}: no such file or directory. Run")
    assert not device.exists()


@LINUX
def test_a_proxy_asks_while_much_passes_and_no_more_once_it_is_closed(device: Path) -> None:
    here, there = socket.socketpair()
    options = ProxyOptions(None, None, ViewOptions(None), "never")
    with here, there, closing(ProxySupervisor(options, here, low_latency=True)) as proxy:
        assert proxy._wakefulness is not None
        proxy._do_periodic_work()
        assert not device.read_bytes()
        proxy._ring.counts[RelayCounter.CAME_UP] += 1000
        proxy._do_periodic_work()
        assert proxy._wakefulness.is_limit_set
        assert device.read_bytes()
        wakefulness = proxy._wakefulness
    assert not wakefulness.is_limit_set
