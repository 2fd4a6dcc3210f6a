"""The audit log, as far as `test_desk` does not show it."""

from __future__ import annotations

from pathlib import Path

import orjson

from bcapscope.protocol.frame import encode, parse_datagram
from bcapscope.traffic.observation import Conversation, Direction, Endpoint, Flow, Observation, Transport
from bcapscope.tui.desk.audit import Audit
from bcapscope.tui.desk.record import Who

TIME = 1_700_000_000_000_000_000
HALT = 63


def test_what_comes_behind_the_end_is_written_and_leaves_no_file_open(tmp_path: Path) -> None:
    troubles: list[str] = []
    audit = Audit(tmp_path, troubles.append)
    ends = Conversation(Endpoint("127.0.0.1", 50001), Endpoint("127.0.0.1", 5007), Transport.UDP, "port")
    for serial in (1, 2):
        (item,) = parse_datagram(encode(serial, 0, HALT, []))
        audit.take(Observation(serial, TIME, TIME, Flow(ends, Direction.REQUEST), item, 0), Who.USER)
        audit.close()
        assert audit._file is None
    audit.take(Observation(3, TIME, TIME, Flow(ends, Direction.REQUEST), item, 0), Who.USER)
    assert audit._file is None
    lines = [orjson.loads(line) for line in audit.path(TIME).read_bytes().splitlines()]
    assert len(lines) == 3
    assert troubles == []


def test_an_answer_is_theirs_who_asked(tmp_path: Path) -> None:
    audit = Audit(tmp_path, lambda text: None)
    ends = Conversation(Endpoint("127.0.0.1", 50001), Endpoint("127.0.0.1", 5007), Transport.UDP, "port")
    for direction, code, who in ((Direction.REQUEST, HALT, Who.USER), (Direction.RESPONSE, 0, Who.SCREEN)):
        (item,) = parse_datagram(encode(1, 0, code, []))
        audit.take(Observation(1, TIME, TIME, Flow(ends, direction), item, 0), who)
    audit.close()
    lines = [orjson.loads(line) for line in audit.path(TIME).read_bytes().splitlines()]
    assert [(line["who"], "received" in line) for line in lines] == [("user", False), ("user", True)]
