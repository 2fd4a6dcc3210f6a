"""Live capture: on the loopback interface where that is allowed, and a sentence where it is not."""

from __future__ import annotations

import os
import signal
import socket
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from bcapscope.capture import live_capture
from bcapscope.capture.live_capture import LiveCapture, open_live_capture
from bcapscope.capture.packet_decoder import PacketDecoder
from bcapscope.errors import CaptureError
from tests.capture.packets import request
from tests.security.harness import process_tree

linux = pytest.mark.skipif(sys.platform != "linux", reason="packet sockets are Linux's")


@pytest.fixture
def conversation() -> Iterator[tuple[int, Callable[[bytes], int]]]:
    """A port on loopback, and how to send a datagram to it."""
    with (
        socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as server,
        socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as client,
    ):
        server.bind(("127.0.0.1", 0))
        address = server.getsockname()
        yield address[1], lambda data: client.sendto(data, address)


def started(begin: Callable[[str], LiveCapture], name: str) -> LiveCapture:
    try:
        return begin(name)
    except (CaptureError, PermissionError) as error:
        pytest.skip(f"no right to capture here: {error}")


@linux
@pytest.mark.parametrize("name", ["lo", "any"])
def test_sees_each_packet_once_with_the_kernels_time(
    name: str, conversation: tuple[int, Callable[[bytes], int]]
) -> None:
    port, send = conversation
    with started(open_live_capture, name) as capture:
        before = time.time_ns()
        for serial in (1, 2, 3):
            send(request(serial))
        # On loopback b-CAP of other tests passes, too, and is recognised on any port.
        observations = PacketDecoder({port}).decode(capture)
        ours = (each for each in observations if port in (each.flow.src.port, each.flow.dst.port))
        found = [next(ours) for _ in range(3)]
        assert [each.item.raw for each in found] == [request(1), request(2), request(3)]
        assert all(before - 1_000_000 <= each.time <= time.time_ns() for each in found)
        assert capture.lost == 0


@linux
def test_names_the_interface_it_came_from() -> None:
    with (
        started(open_live_capture, "lo") as capture,
        socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as client,
    ):
        client.sendto(b"x", ("127.0.0.1", 9))
        packet = next(iter(capture))
        assert packet[3].name == "lo"
        assert packet[2] == len(packet[1])


@linux
def test_scapys_socket_sees_them_too(conversation: tuple[int, Callable[[bytes], int]]) -> None:
    port, send = conversation
    with started(live_capture._SnifferProcess, "lo") as capture:
        send(request(1))
        seen = PacketDecoder({port}).decode(capture)  # others, too, may send to a port that had another owner
        observation = next(each for each in seen if each.item.raw == request(1))
        assert abs(observation.time - time.time_ns()) < 10 * 10**9
        assert capture.lost == 0


@linux
def test_the_process_that_captures_ends_with_the_capture() -> None:
    with started(live_capture._SnifferProcess, "lo"):
        (sniffer,) = _sniffers()
    assert not _sniffers()
    assert not Path(f"/proc/{sniffer}").exists()


@linux
def test_a_capture_whose_process_is_killed_ends_with_a_reason() -> None:
    with started(live_capture._SnifferProcess, "lo") as capture:
        (sniffer,) = _sniffers()
        os.kill(sniffer, signal.SIGKILL)
        with pytest.raises(CaptureError, match=r"^capturing on lo ended: the capturing process has ended$"):
            for _ in capture:
                pass


@linux
def test_the_process_that_captures_reports_what_scapy_refuses() -> None:
    started(live_capture._SnifferProcess, "lo").__exit__(None, None, None)
    with pytest.raises(CaptureError, match=r"^cannot capture on nowhere0: "):
        live_capture._SnifferProcess("nowhere0")
    assert not _sniffers()


def _sniffers() -> list[int]:
    """Return the processes that this one has started to capture with scapy."""
    return [
        pid
        for pid in process_tree(os.getpid())[1:]
        if b"capture.sniffer" in Path(f"/proc/{pid}/cmdline").read_bytes()
    ]


@linux
def test_a_buffer_as_large_as_allowed_will_do(monkeypatch: pytest.MonkeyPatch) -> None:
    class Modest(socket.socket):
        def setsockopt(self, level: int, option: int, value: int) -> None:  # type: ignore[override]
            if option == live_capture._SO_RCVBUFFORCE:
                raise PermissionError(1, "Operation not permitted")
            super().setsockopt(level, option, value)

    started(open_live_capture, "lo").__exit__(None, None, None)
    monkeypatch.setattr(socket, "socket", Modest)
    with open_live_capture("lo") as capture:
        assert capture.lost == 0


def test_an_unknown_interface_is_told_with_those_that_there_are() -> None:
    with pytest.raises(CaptureError, match=r"^no interface is named nowhere0. Choose one of these: .*lo"):
        open_live_capture("nowhere0")


@pytest.mark.parametrize(
    ("platform", "how"),
    [
        ("linux", "capturing on lo needs permission. Run as root, or run this once: sudo setcap"),
        ("darwin", "administrator"),
    ],
)
def test_missing_rights_are_told_with_how_to_give_them(
    monkeypatch: pytest.MonkeyPatch, platform: str, how: str
) -> None:
    def refuse(*_: object) -> None:
        raise PermissionError(1, "Operation not permitted")

    monkeypatch.setattr(live_capture, "_PacketSocket", refuse)
    monkeypatch.setattr(live_capture, "_SnifferProcess", refuse)
    monkeypatch.setattr(sys, "platform", platform)
    with pytest.raises(CaptureError, match=how):
        open_live_capture("lo")


def test_other_failures_are_told_too(monkeypatch: pytest.MonkeyPatch) -> None:
    def fail(*_: object) -> None:
        raise OSError(105, "No buffer space available")

    monkeypatch.setattr(live_capture, "_PacketSocket", fail)
    monkeypatch.setattr(sys, "platform", "linux")
    with pytest.raises(CaptureError, match=r"^cannot capture on lo: no buffer space available$"):
        open_live_capture("lo")


@linux
def test_a_socket_that_goes_away_is_told() -> None:
    with started(open_live_capture, "lo") as capture:
        capture.__exit__(None, None, None)
        with pytest.raises(CaptureError, match=r"^capturing on lo ended: "):
            next(iter(capture))
