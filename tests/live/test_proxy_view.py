"""What a proxy shows is what `decode` and `calls` show."""

from __future__ import annotations

import json

import pytest

from bcapscope.live.proxy_options import TrafficFormat, ViewOptions
from bcapscope.live.proxy_view import ProxyView
from bcapscope.protocol.codec.frame import encode_frame
from bcapscope.protocol.tables.hresult import S_EXECUTING
from bcapscope.proxy.record_decoder import RecordDecoder
from bcapscope.render.color_palette import PLAIN
from bcapscope.render.timestamp import TimeFormat
from bcapscope.traffic.call import Call, PairingResult
from bcapscope.traffic.filter.compiler import FilterError
from bcapscope.traffic.filter.field_table import RecordKind
from bcapscope.traffic.tracker import Tracker
from tests.proxy.test_record_decoder import REPLY, REQUEST, data, opened

RECORDS = [
    opened("udp"),
    data(True, 10, 20, REQUEST, "a rule"),
    data(False, 30, 40_000, REPLY),
    data(False, 50, 60_000, encode_frame(9, 0, S_EXECUTING)),
]


def shown(look: ViewOptions) -> list[str]:
    """Return all lines of some traffic."""
    view, tracker = ProxyView(look, PLAIN), Tracker()
    results: list[PairingResult] = []
    for seen, note in RecordDecoder().decode(RECORDS):
        view.add_frame(seen, note)
        results += tracker.observe(seen)
    for settled in (*results, *tracker.close()):
        if isinstance(settled, Call):
            view.on_call(settled, None)
        else:
            view.on_stray_reply(settled)
    return [line.decode() if isinstance(line, bytes) else line for line in view.lines]


def test_frames() -> None:
    lines = shown(ViewOptions(RecordKind.FRAME))
    assert len(lines) == 3
    assert lines[0].split()[1] == "0.000000"
    assert lines[0].endswith("# a rule")
    assert shown(ViewOptions(RecordKind.FRAME, time_format=TimeFormat.EPOCH))[1].split()[1] == "0.000040000"


def test_chosen_frames_as_json_and_as_trees() -> None:
    (line,) = shown(ViewOptions(RecordKind.FRAME, TrafficFormat.JSON, "hresult == S_OK"))
    assert json.loads(line)["serial"] == 7
    tree = shown(ViewOptions(RecordKind.FRAME, TrafficFormat.TREE, "hresult == S_OK"))
    assert len(tree) > 3
    assert tree[-1] == ""


def test_calls() -> None:
    lines = shown(ViewOptions(RecordKind.CALL))
    assert len(lines) == 2
    assert "Service_Stop  S_OK" in lines[1]
    assert "answers no request" in lines[0]
    (record,) = shown(ViewOptions(RecordKind.CALL, TrafficFormat.JSON))
    assert json.loads(record)["function"] == "Service_Stop"
    assert len(shown(ViewOptions(RecordKind.CALL, TrafficFormat.TREE))) == 4
    assert shown(ViewOptions(RecordKind.CALL, expression="retries > 0")) == []


def test_nothing() -> None:
    assert shown(ViewOptions(None)) == []
    with pytest.raises(FilterError):
        ViewOptions(None, expression="==").compiled_filter()
    with pytest.raises(FilterError):
        ViewOptions(RecordKind.FRAME, expression="retries > 0").compiled_filter()  # frames have none
