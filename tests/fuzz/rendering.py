"""Frames shown in every way: what must hold for any bytes at all."""

from __future__ import annotations

import csv
import json
from collections.abc import Iterator

from bcapscope.protocol.codec.frame import Frame, Malformed, parse_datagram
from bcapscope.protocol.codec.frame_template import FrameTemplates
from bcapscope.protocol.codec.variant import VT, vt_name
from bcapscope.protocol.tables.command_catalogue import COMMAND_FUNCTIONS
from bcapscope.protocol.tables.function_table import signed_function_id
from bcapscope.render.csv_table import COLUMNS, CsvTableRenderer
from bcapscope.render.frame_line import FrameLineRenderer
from bcapscope.render.frame_record import FrameRecordRenderer
from bcapscope.render.frame_tree import FrameTreeRenderer
from bcapscope.render.hexdump import hexdump
from bcapscope.traffic.call_kind import CallKind, RecentRequests
from bcapscope.traffic.observation import (
    SERVER_PORT,
    Conversation,
    Direction,
    Endpoint,
    Flow,
    Observation,
    Transport,
)
from tests.samples.problems import problem_of

_CONVERSATION = Conversation(Endpoint("10.0.0.2", 50001), Endpoint("::1", 5007), Transport.UDP, SERVER_PORT)
_FLOWS = tuple(Flow(_CONVERSATION, direction) for direction in Direction)
_NOTE = problem_of(0, "cut", "the capture kept less than there was")


def render(data: bytes) -> None:
    """Show `data`, a datagram behind one byte that tells who sent it and whether it was cut (bits 0, 1).

    What is shown by the forms that frames share is what is shown with nothing shared.
    """
    if not data:
        return
    shared = FrameTemplates()
    shown = written(list(observed(data[0], data[1:], shared)))
    assert written(list(observed(data[0], data[1:], shared))) == shown
    assert written(list(observed(data[0], data[1:], None))) == shown
    for line in shown:
        assert all(char.isprintable() or char == "\u3000" for char in line)


def observed(
    head: int, raw: bytes, templates: FrameTemplates | None
) -> Iterator[tuple[Observation, CallKind | None]]:
    """Tell what is seen and what it is about."""
    about = RecentRequests().kind_of
    flow = _FLOWS[head & 1]
    for number, item in enumerate(parse_datagram(raw, templates), 1):
        noted = Frame(item.raw, _NOTE, templates) if head & 2 and isinstance(item, Frame) else item
        seen = Observation(number, number, number, flow, noted, number)
        question = about(seen)
        if isinstance(noted, Frame) and flow.direction is Direction.REQUEST:
            assert question == asked(noted)
        yield seen, question


def asked(frame: Frame) -> CallKind:
    """Tell what a request asks by its arguments alone."""
    second = frame.arguments[1].variant.value if len(frame.arguments) > 1 else None
    command = second if frame.code in COMMAND_FUNCTIONS and isinstance(second, str) else None
    return CallKind(signed_function_id(frame.code), command)


def written(observations: list[tuple[Observation, CallKind | None]]) -> list[str]:
    """Write observations in every way there is; check what a program would read."""
    lines, records, table = FrameLineRenderer(), FrameRecordRenderer(), CsvTableRenderer()
    trees = [FrameTreeRenderer(), FrameTreeRenderer(full=True, dump=True)]
    found: list[str] = []
    for seen, question in observations:
        record = records.record(seen, question).decode()
        check_record(record, seen)
        row = table.row(seen, question)
        assert [len(cells) for cells in csv.reader([row])] == [len(COLUMNS)]
        found += [lines.line(seen, question), record, row, *hexdump(seen.item.raw)]
        for tree in trees:
            found += tree.lines(seen, question)
    return found


def check_record(record: str, seen: Observation) -> None:
    """The JSON object says what the item says."""
    told = json.loads(record)
    item = seen.item
    assert [(each["offset"], each["code"]) for each in told["problems"]] == [p[:2] for p in item.problems]
    assert told.get("raw", item.raw.hex()) == item.raw.hex()
    assert ("raw" in told) is bool(item.problems)
    if isinstance(item, Malformed):
        assert told["kind"] == "malformed"
        return
    assert (told["serial"], told["reserved"], told["length"]) == (item.serial, item.reserved, item.length)
    assert [argument["type"] for argument in told["args"]] == [vt_name(a.variant.vt) for a in item.arguments]
    for said, argument in zip(told["args"], item.arguments, strict=True):
        if argument.variant.vt in (VT.BSTR, VT.I4, VT.BOOL, VT.UI8):
            assert said["value"] == argument.variant.value
