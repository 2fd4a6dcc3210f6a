"""What a proxy recorded, in the files that it goes to."""

from __future__ import annotations

import json
from pathlib import Path

from bcapscope.capture.file import open_capture
from bcapscope.capture.series import Bounds
from bcapscope.cli.proxyrecord import ProxyRecorder
from bcapscope.proxy.ring import Kind, Record

ENDS = (("127.0.0.1", 50001), ("127.0.0.1", 5008), ("127.0.0.1", 50002), ("127.0.0.1", 5007))
ROOM = 10_000
TOLD: list[str] = []


def test_a_client_that_goes_begins_no_file_of_a_ring(tmp_path: Path) -> None:
    recorder = ProxyRecorder(tmp_path / "r.pcapng", Bounds(2, size=ROOM), TOLD.append)
    recorder.take([Record(Kind.OPENED, False, 1, 1, 0, json.dumps(["udp", *ENDS]).encode(), "")])
    for time in (1_000, 2_000):
        recorder.take([Record(Kind.DATA, True, 1, time, time + 1, bytes(ROOM), "")])
    recorder.take([Record(Kind.GONE, False, 1, 3_000, 0, b"", "")])
    recorder.close()
    times = []
    for path in sorted(tmp_path.iterdir()):
        with open_capture(str(path)) as capture:
            times.append([packet[0] for packet in capture])
    assert times == [[1_000, 1_001], [2_000, 2_001]]
    assert not TOLD
