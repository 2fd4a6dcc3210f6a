"""The action log: its lines, its size, and what happens when the disk does not take them."""

from __future__ import annotations

import errno
import math
import os
import threading
from datetime import datetime
from pathlib import Path
from typing import Any

import orjson
import pytest

from bcapscope.client.action_log import LINE_TIMEOUT, ActionLog, ArmedCallLogger, LogFiles, LoggedConnection
from bcapscope.protocol.codec.frame import Frame, encode_frame, parse_datagram
from bcapscope.protocol.codec.variant import EMPTY, VT, Variant

TIME = 1_700_000_000_123_456_000
ROBOT = LoggedConnection("192.0.2.1", 5007, "udp")
HANDLE = Variant(VT.I4, 1)


class Disk:
    """A log in a folder, and what it reported."""

    def __init__(self, folder: Path) -> None:
        self.troubles: list[tuple[Path, str]] = []
        self.log = ActionLog(folder, "call", lambda path, error: self.troubles.append((path, str(error))))
        self._folder = folder

    def lines(self) -> list[dict[str, Any]]:
        """Close the log and read it."""
        self.log.close()
        paths = sorted(self._folder.glob("actions-*.jsonl"))
        return [orjson.loads(line) for path in paths for line in path.read_bytes().splitlines()]


def execute(command: str, parameter: Variant, serial: int = 1) -> Frame:
    return Frame(encode_frame(serial, 0, 64, (HANDLE, Variant(VT.BSTR, command), parameter)))


def test_a_call_and_its_result(tmp_path: Path) -> None:
    disk = Disk(tmp_path)
    request = execute("Motor", Variant.array(VT.I4, (1, 0)), serial=7)
    disk.log.log_request(ROBOT, request, TIME, "user")
    disk.log.log_reply(ROBOT, Frame(encode_frame(8, 0, 0, ())), TIME)
    disk.log.log_reply(ROBOT._replace(port=5008), Frame(encode_frame(7, 0, 0, ())), TIME)
    disk.log.log_reply(ROBOT, Frame(encode_frame(7, 0, 0x83500120, ())), TIME + 1_000_000)
    sent, received = disk.lines()
    assert {key: sent[key] for key in ("program", "pid", "who", "host", "port", "transport", "serial")} == {
        "program": "call",
        "pid": os.getpid(),
        "who": "user",
        "host": "192.0.2.1",
        "port": 5007,
        "transport": "udp",
        "serial": 7,
    }
    assert sent["sent"] == received["call"] == "Robot_Execute Motor"
    assert sent["arguments"][2] == {"type": "VT_I4|VT_ARRAY", "value": [1, 0]}
    assert bytes.fromhex(sent["hex"]) == request.raw
    assert received["received"] == "0x83500120"
    moment = datetime.fromisoformat(sent["time"])
    assert moment.utcoffset() is not None
    assert moment.timestamp() == pytest.approx(TIME / 1e9, abs=1e-6)


def test_a_call_that_needs_arming_is_written_before_it_returns(tmp_path: Path) -> None:
    disk = Disk(tmp_path)
    disk.log.log_request(ROBOT, execute("Motor", Variant(VT.I4, 1)), TIME, "user")
    (path,) = tmp_path.iterdir()
    assert path.read_bytes().endswith(b"}\n")
    disk.log.close()


def test_hostile_text_is_escaped_and_shortened(tmp_path: Path) -> None:
    disk = Disk(tmp_path)
    text = '\x1b]0;x\x07\x7f\n"}\u202e\ud800\u3042' + "x" * 100_000
    values = (Variant.array(VT.R8, (math.nan, math.inf)), Variant.array(VT.UI1, b"\xff" * 5000))
    nested = Variant.array(VT.VARIANT, (Variant.array(VT.I4, tuple(range(5000))),))
    disk.log.log_request(
        ROBOT, Frame(encode_frame(1, 0, 64, (HANDLE, Variant(VT.BSTR, text), *values, nested))), TIME, "user"
    )
    disk.log.close()
    (path,) = tmp_path.iterdir()
    raw = path.read_bytes()
    assert raw.count(b"\n") == 1
    assert all(32 <= byte < 127 for byte in raw[:-1])
    assert len(raw) < 10_000
    line = orjson.loads(raw.replace(b"\\ud800", b"?"))
    assert line["arguments"][1]["value"].startswith('\x1b]0;x\x07\x7f\n"}\u202e')
    assert line["arguments"][2]["value"] == ["nan", "inf"]
    assert "more" in line["arguments"][4]["value"][0]["value"][-1]
    assert line["bytes"] > 100_000


def test_bytes_that_are_no_frame(tmp_path: Path) -> None:
    disk = Disk(tmp_path)
    for item in parse_datagram(b"\x01\x02\x03"):
        disk.log.log_request(ROBOT, item, TIME, "user")
        disk.log.log_reply(ROBOT, item, TIME)
    (line,) = disk.lines()
    assert (line["sent"], line["hex"]) == (None, "010203")


def test_lines_after_the_end_are_written(tmp_path: Path) -> None:
    disk = Disk(tmp_path)
    for serial in (1, 2):
        disk.log.log_request(ROBOT, execute("CurJnt", EMPTY, serial), TIME, "user")
        assert len(disk.lines()) == serial
    assert disk.troubles == []


# When the disk does not take it.


def test_a_log_that_cannot_be_written_is_reported_once(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    disk = Disk(tmp_path / "file")
    for serial in range(3):
        disk.log.log_request(ROBOT, execute("Motor", Variant(VT.I4, 1), serial), TIME, "user")
    disk.log.close()
    ((path, error),) = disk.troubles
    assert path == tmp_path / "file"
    assert error


def test_a_disk_that_hangs_delays_one_call_a_little_and_no_stop(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / f"actions-{datetime.now():%Y-%m-%d}.jsonl")  # nobody reads it: opening it hangs
    disk = Disk(tmp_path)
    times = []
    for _ in range(2):
        for command, value in (("slvChangeMode", 0), ("Motor", 1)):
            began = datetime.now()
            disk.log.log_request(ROBOT, execute(command, Variant(VT.I4, value)), TIME, "user")
            times.append((datetime.now() - began).total_seconds())
    assert [error for _, error in disk.troubles] == ["[Errno 0] the disk does not answer"]
    assert times[1] >= LINE_TIMEOUT
    assert max(times[0], times[2], times[3]) < LINE_TIMEOUT / 2
    with open(next(tmp_path.iterdir()), "rb") as reader:
        disk.log.close()
        assert reader.read().count(b"\n") == 4


def test_a_file_is_bounded_and_the_oldest_go(tmp_path: Path) -> None:
    files = LogFiles(tmp_path)
    files.max_file_size, files.max_total_size = 100, 350
    stranger = tmp_path / "sent-2020-01-01.jsonl"
    stranger.write_bytes(b"x" * 1000)
    for number in range(100):
        files.append(b"%040d\n" % number)
    found = list(tmp_path.glob("actions-*"))
    assert sum(path.stat().st_size for path in found) <= 350
    assert b"%040d\n" % 99 in b"".join(path.read_bytes() for path in found)
    assert stranger.exists()
    again = LogFiles(tmp_path)
    again.max_file_size, again.max_total_size = 100, 350
    again.append(b"again\n")
    assert again.path == files.path


def test_a_line_that_was_torn_does_not_spoil_the_next(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    files, write = LogFiles(tmp_path), os.write
    monkeypatch.setattr(os, "write", lambda descriptor, data: write(descriptor, data[:3]))
    with pytest.raises(OSError, match=os.strerror(errno.ENOSPC)):
        files.append(b'{"a":1}\n')
    monkeypatch.undo()
    files.append(b'{"b":2}\n')
    assert files.path.read_bytes() == b'{"a\n{"b":2}\n'


def test_several_programs_write_whole_lines(tmp_path: Path) -> None:
    def write(name: str) -> None:
        files = LogFiles(tmp_path)
        files.max_file_size = 5000
        for _ in range(200):
            files.append(name.encode() * 50 + b"\n")

    threads = [threading.Thread(target=write, args=(name,)) for name in "abc"]
    for each in threads:
        each.start()
    for each in threads:
        each.join()
    lines = [line for path in tmp_path.iterdir() for line in path.read_bytes().splitlines()]
    assert len(lines) == 600
    assert all(len(set(line)) == 1 and len(line) == 50 for line in lines)


# The calls of a connection.


def test_only_armed_calls_are_logged_and_set_points_are_counted(tmp_path: Path) -> None:
    disk = Disk(tmp_path)
    calls = ArmedCallLogger(disk.log, ROBOT)
    point = Variant.array(VT.R8, (0.0,) * 8)
    frames = [
        execute("CurJnt", EMPTY, 1),
        execute("slvChangeMode", Variant(VT.I4, 0x102), 2),
        *(execute("slvMove", point, serial) for serial in range(3, 103)),
        execute("slvChangeMode", Variant(VT.I4, 0), 103),
        execute("Motor", Variant(VT.I4, 1), 104),
        execute("Motor", Variant(VT.I4, 0), 105),
        execute("slvMove", point, 106),
    ]
    for frame in frames:
        calls.add_frame(True, frame.raw, TIME)
        calls.add_frame(False, encode_frame(frame.serial, 0, 0, ()), TIME)
    calls.add_frame(True, b"\x01", TIME)
    calls.add_frame(True, execute("slvMove", Variant(VT.I4, 1), 107).raw, TIME)
    calls.add_frame(True, execute("slvMove", Variant(VT.I4, 1), 108).raw, TIME)
    calls.end_set_points()
    lines = disk.lines()
    assert [(line["sent"], line.get("set_points")) for line in lines if "sent" in line] == [
        ("Robot_Execute slvChangeMode", None),
        ("Robot_Execute slvMove", None),
        ("Robot_Execute slvMove", 100),
        ("Robot_Execute Motor", None),
        ("Robot_Execute slvMove", None),
        ("Robot_Execute slvMove", 2),
    ]
    assert [line["received"] for line in lines if "received" in line] == ["S_OK"] * 4
