"""Captures that grow while they are read."""

from __future__ import annotations

from pathlib import Path
from threading import Event

import pytest

from bcapscope.capture import capture_file
from bcapscope.capture.capture_file import follow_capture
from bcapscope.errors import CaptureError
from tests.capture.packets import pcap


class Writer:
    """Writes the next piece of a capture whenever the reader has nothing to do."""

    def __init__(self, path: Path, pieces: list[bytes]) -> None:
        self.path, self.pieces, self.idles = path, pieces, 0
        self.ended = Event()
        path.write_bytes(b"")

    def idle(self) -> None:
        self.idles += 1
        if self.pieces:
            with self.path.open("ab") as file:
                file.write(self.pieces.pop(0))
        if not self.pieces:
            self.ended.set()


def over() -> Event:
    ended = Event()
    ended.set()
    return ended


@pytest.mark.parametrize("size", [1, 7, 40, 1000])
def test_packets_come_as_they_are_written(tmp_path: Path, size: int, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(capture_file, "POLL_INTERVAL", 0)
    whole = pcap(b"abc", b"defg", b"h")
    writer = Writer(tmp_path / "a", [whole[at : at + size] for at in range(0, len(whole), size)])
    with follow_capture(writer.path, writer.ended, writer.idle) as capture:
        assert [packet[1] for packet in capture] == [b"abc", b"defg", b"h"]
    assert writer.idles == -(-len(whole) // size)


def test_what_was_written_last_is_read_though_the_end_is_known(tmp_path: Path) -> None:
    path = tmp_path / "a"
    path.write_bytes(pcap(b"abc"))
    with follow_capture(path, over(), pytest.fail) as capture:
        assert [packet[1] for packet in capture] == [b"abc"]


def test_a_capture_that_ends_inside_a_packet(tmp_path: Path) -> None:
    path = tmp_path / "a"
    path.write_bytes(pcap(b"abc", b"defg")[:-2])
    with (
        follow_capture(path, over(), pytest.fail) as capture,
        pytest.raises(CaptureError, match="the capture ends inside"),
    ):
        list(capture)


def test_no_such_file(tmp_path: Path) -> None:
    with pytest.raises(CaptureError, match="no such file"):
        follow_capture(tmp_path / "a", over(), pytest.fail)
