"""What a proxy shows is what `decode` and `calls` show."""

from __future__ import annotations

import json

import pytest

from bcapscope.cli.proxyview import View
from bcapscope.cli.proxywishes import Form, Look
from bcapscope.protocol.frame import encode
from bcapscope.protocol.hresult import S_EXECUTING
from bcapscope.proxy.witness import Witness
from bcapscope.render.moment import Clock
from bcapscope.render.palette import PLAIN
from bcapscope.traffic.fields import RecordKind
from bcapscope.traffic.filters import FilterError
from bcapscope.traffic.tracker import Tracker
from tests.proxy.test_witness import REPLY, REQUEST, data, opened

RECORDS = [
    opened("udp"),
    data(True, 10, 20, REQUEST, "a rule"),
    data(False, 30, 40_000, REPLY),
    data(False, 50, 60_000, encode(9, 0, S_EXECUTING)),
]


def shown(look: Look) -> list[str]:
    """Return all lines of some traffic."""
    view, tracker = View(look, PLAIN), Tracker()
    lines: list[str | bytes] = []
    for seen, note in Witness().observe(RECORDS):
        lines += view.frame(seen, note)
        for settled in tracker.observe(seen):
            lines += view.call(settled, None)
    for settled in tracker.close():
        lines += view.call(settled, None)
    return [line.decode() if isinstance(line, bytes) else line for line in lines]


def test_frames() -> None:
    lines = shown(Look(RecordKind.FRAME))
    assert len(lines) == 3
    assert lines[0].split()[1] == "0.000000"
    assert lines[0].endswith("# a rule")
    assert shown(Look(RecordKind.FRAME, clock=Clock.EPOCH))[1].split()[1] == "0.000040000"


def test_chosen_frames_as_json_and_as_trees() -> None:
    (line,) = shown(Look(RecordKind.FRAME, Form.JSON, "hresult == S_OK"))
    assert json.loads(line)["serial"] == 7
    tree = shown(Look(RecordKind.FRAME, Form.TREE, "hresult == S_OK"))
    assert len(tree) > 3
    assert tree[-1] == ""


def test_calls() -> None:
    lines = shown(Look(RecordKind.CALL))
    assert len(lines) == 2
    assert "Service_Stop  S_OK" in lines[1]
    assert "answers no request" in lines[0]
    (record,) = shown(Look(RecordKind.CALL, Form.JSON))
    assert json.loads(record)["function"] == "Service_Stop"
    assert len(shown(Look(RecordKind.CALL, Form.TREE))) == 4
    assert shown(Look(RecordKind.CALL, wanted="retries > 0")) == []


def test_nothing() -> None:
    assert shown(Look(None)) == []
    with pytest.raises(FilterError):
        Look(None, wanted="==").filter()
    with pytest.raises(FilterError):
        Look(RecordKind.FRAME, wanted="retries > 0").filter()  # frames have none
