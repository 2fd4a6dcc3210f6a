"""What a proxy recorded, in the files that it goes to."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from bcapscope.capture.file import open_capture
from bcapscope.capture.series import Bounds
from bcapscope.cli.proxyrecord import ProxyRecorder
from bcapscope.proxy.ring import Kind, Record

ENDS = (("127.0.0.1", 50001), ("127.0.0.1", 5008), ("127.0.0.1", 50002), ("127.0.0.1", 5007))
ROOM = 10_000
TOLD: list[str] = []


_FIN, _RST = 1, 4
TELLING = _FIN | _RST


@pytest.mark.parametrize("kind", [Kind.END, Kind.RESET])
@pytest.mark.parametrize("up", [True, False])
@pytest.mark.parametrize("by_proxy", [True, False])
def test_the_ends_of_a_stream_are_those_of_who_sent_them(
    kind: Kind, up: bool, by_proxy: bool, tmp_path: Path
) -> None:
    why, flag = b"a rule" if by_proxy else b"", _FIN if kind is Kind.END else _RST
    recorder = ProxyRecorder(tmp_path / "r.pcapng", None, TOLD.append)
    recorder.take([Record(Kind.OPENED, False, 1, 1, 0, json.dumps(["tcp", *ENDS]).encode(), "")])
    recorder.take([Record(Kind.DATA, True, 1, 2, 3, b"x", "")])
    if by_proxy:
        recorder.take([Record(kind, side, 1, 0, 5, why, "") for side in (up, not up)])
    else:
        recorder.take([Record(kind, up, 1, 4, 0, b"", ""), Record(kind, up, 1, 0, 5, b"", "")])
    recorder.take([Record(Kind.GONE, False, 1, 6, 0, b"", "")])
    recorder.close()
    ended = []
    with open_capture(str(tmp_path / "r.pcapng")) as capture:
        for time, raw, _, _, comments in capture:
            if raw[33] & TELLING:
                source, target = (int.from_bytes(raw[at : at + 2], "big") for at in (20, 22))
                assert (raw[33] & TELLING, comments) == (flag, ("a rule",) if by_proxy else ())
                ended.append((time, source, target))
    client, listen, upstream, controller = (port for _, port in ENDS)
    if by_proxy:
        assert sorted(ended) == [(5, listen, client), (5, upstream, controller)]
    elif up:
        assert ended == [(4, client, listen), (5, upstream, controller)]
    else:
        assert ended == [(4, controller, upstream), (5, listen, client)]
    assert not TOLD


def test_a_client_that_goes_begins_no_file_of_a_ring(tmp_path: Path) -> None:
    recorder = ProxyRecorder(tmp_path / "r.pcapng", Bounds(2, size=ROOM), TOLD.append)
    recorder.take([Record(Kind.OPENED, False, 1, 1, 0, json.dumps(["udp", *ENDS]).encode(), "")])
    for time in (1_000, 2_000):
        recorder.take([Record(Kind.DATA, True, 1, time, time + 1, bytes(ROOM // 2), "")])
    recorder.take([Record(Kind.GONE, False, 1, 3_000, 0, b"", "")])
    recorder.close()
    times = []
    for path in sorted(tmp_path.iterdir()):
        with open_capture(str(path)) as capture:
            times.append([packet[0] for packet in capture])
    assert times == [[1_000, 1_001], [2_000, 2_001]]
    assert not TOLD


def test_packets_stand_in_the_order_of_their_times_however_they_are_taken(tmp_path: Path) -> None:
    records = [Record(Kind.OPENED, False, 1, 1, 0, json.dumps(["udp", *ENDS]).encode(), "")]
    records += [
        Record(Kind.DATA, True, 1, time, time + 25, bytes(time % 300), "") for time in range(10, 400, 10)
    ]
    for size in (1, 2, 7, 100):
        path = tmp_path / f"{size}.pcapng"
        recorder = ProxyRecorder(path, None, TOLD.append)
        for start in range(0, len(records), size):
            recorder.take(records[start : start + size])
        recorder.close()
        with open_capture(str(path)) as capture:
            times = [packet[0] for packet in capture]
        assert times == sorted([*range(10, 400, 10), *range(35, 425, 10)])
    assert not TOLD


def test_what_is_flushed_can_be_read_before_the_end(tmp_path: Path) -> None:
    path = tmp_path / "r.pcapng"
    recorder = ProxyRecorder(path, None, TOLD.append)
    recorder.take([Record(Kind.OPENED, False, 1, 1, 0, json.dumps(["udp", *ENDS]).encode(), "")])
    recorder.take([Record(Kind.DATA, True, 1, 10, 20, b"x", "")])
    recorder.flush()
    with open_capture(str(path)) as capture:
        assert [packet[0] for packet in capture] == [10, 20]
    recorder.close()
