"""JSON: every frame an object, every value exact, nothing from the wire raw."""

from __future__ import annotations

import json
import math
from collections.abc import Callable
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from bcapscope.protocol.codec.frame import Frame, Malformed, encode_frame, parse_datagram
from bcapscope.protocol.codec.variant import ARRAY, VT, Value, Variant, vt_name
from bcapscope.render.frame_record import MAX_TEMPLATES, FrameRecordRenderer
from bcapscope.traffic.call_kind import CallKind, call_kind_of
from bcapscope.traffic.filter.field_table import RecordKind, fields_of
from bcapscope.traffic.observation import Direction
from tests.render.scenes import JOINTS, ROBOT, START, observe, scenes
from tests.samples.problems import problem_of
from tests.strategies import variants

ASK, ANSWER = Direction.REQUEST, Direction.RESPONSE
KEYS = [
    *("frame", "time", "packet", "src", "dst", "transport", "kind", "length", "serial", "reserved"),
    *("function_id", "function", "command", "hresult", "hresult_name"),
]


def record(raw: bytes, direction: Direction = ASK, call_kind: CallKind | None = None) -> dict[str, Any]:
    (item,) = parse_datagram(raw)
    if call_kind is None and direction is ASK and isinstance(item, Frame):
        call_kind = call_kind_of(item)
    text = FrameRecordRenderer().record(observe(item, direction), call_kind)
    value: dict[str, Any] = json.loads(text)
    return value


def test_filters_ask_for_frames_by_the_same_names() -> None:
    """But for `arg`, which is one of the `args`, and for bytes and remarks, which nobody compares."""
    renderer = FrameRecordRenderer()
    keys = {key for scene in scenes() for key in json.loads(renderer.record(*scene))}
    assert keys - fields_of(RecordKind.FRAME).keys() == {"args", "raw", "missing"}


def test_all_scenes(golden: Callable[[str, bytes], None]) -> None:
    renderer = FrameRecordRenderer()
    golden("records.json", b"".join(renderer.record(*scene) + b"\n" for scene in scenes()))


def test_a_request() -> None:
    raw = encode_frame(5, 0, 64, (ROBOT, Variant(VT.BSTR, "slvChangeMode"), Variant(VT.I2, 2)))
    assert record(raw) == {
        "frame": 1,
        "time": START / 1e9,
        "packet": 1,
        "src": "10.0.0.2:50001",
        "dst": "[fe80::1%eth0]:5007",
        "transport": "udp",
        "kind": "request",
        "length": 82,
        "serial": 5,
        "reserved": 0,
        "function_id": 64,
        "function": "Robot_Execute",
        "command": "slvChangeMode",
        "hresult": None,
        "hresult_name": None,
        "args": [
            {"name": "hRobot", "type": "VT_I4", "value": 1},
            {"name": "bstrCommand", "type": "VT_BSTR", "value": "slvChangeMode"},
            {"name": "vntParam", "type": "VT_I2", "value": 2},
        ],
        "problems": [],
    }


def test_a_reply_has_its_result_and_what_it_answers() -> None:
    reply = record(encode_frame(5, 0, 0x83500121), ANSWER, CallKind(64, "slvMove"))
    assert (reply["kind"], reply["hresult"], reply["hresult_name"]) == ("response", 0x83500121, "0x83500121")
    assert reply["hresult_text"] == "slvMove while slave mode is off"
    assert (reply["function"], reply["function_id"], reply["command"]) == ("Robot_Execute", 64, "slvMove")


def test_a_reply_to_nothing_seen_says_so() -> None:
    reply = record(encode_frame(5, 0, 0), ANSWER)
    assert (reply["function"], reply["function_id"], reply["command"]) == (None, None, None)


def test_time_has_nine_digits() -> None:
    text = FrameRecordRenderer().record(observe(Frame(encode_frame(1, 0, 2))), CallKind(2, None))
    assert b'"time":1700000000.123456000,' in text


def test_malformed_bytes_keep_the_same_keys() -> None:
    value = record(b"GET /")
    assert list(value)[: len(KEYS)] == KEYS
    assert value["kind"] == "malformed"
    assert value["raw"] == b"GET /".hex()
    assert value["problems"] == [
        {"offset": 0, "code": "soh", "reason": "first byte is 47, but a frame begins with 01"}
    ]


def test_a_hole_tells_its_size() -> None:
    hole = Malformed(b"", (problem_of(0, "gap", "12 bytes of the stream were not seen"),), 12)
    value = json.loads(FrameRecordRenderer().record(observe(hole), None))
    assert (value["kind"], value["missing"], value["raw"]) == ("malformed", 12, "")


def test_a_damaged_frame_brings_its_bytes() -> None:
    raw = encode_frame(13, 0, 4, (ROBOT,))[:-1]
    value = record(raw)
    assert value["kind"] == "request"
    assert value["raw"] == raw.hex()
    assert [problem["code"] for problem in value["problems"]] == ["length", "eot"]


@pytest.mark.parametrize(
    ("value", "expected"),
    [
        (Variant(VT.CY, 123456), {"type": "VT_CY", "value": 123456, "scaled": "12.3456"}),
        (Variant(VT.DATE, 39873.5), {"type": "VT_DATE", "value": 39873.5, "date": "2009-03-01 12:00:00"}),
        (Variant(VT.R8, math.nan), {"type": "VT_R8", "value": "NaN"}),
        (
            Variant.array(VT.R8, (1.5, math.inf, -math.inf)),
            {"type": "VT_R8|VT_ARRAY", "value": [1.5, "Infinity", "-Infinity"]},
        ),
        (Variant.array(VT.UI1, b"\x00\xff"), {"type": "VT_UI1|VT_ARRAY", "value": [0, 255]}),
        (Variant.array(VT.R4, ()), {"type": "VT_R4|VT_ARRAY", "value": []}),
        (Variant(VT.BSTR, "100 %s %d"), {"type": "VT_BSTR", "value": "100 %s %d"}),
        (Variant(VT.EMPTY, None), {"type": "VT_EMPTY", "value": None}),
        (Variant(0x0009, b""), {"type": "VT_0x0009", "value": []}),
        (
            Variant.array(VT.VARIANT, (Variant(VT.I4, 1), Variant.array(VT.R4, (0.5,)))),
            {
                "type": "VT_VARIANT|VT_ARRAY",
                "value": [{"type": "VT_I4", "value": 1}, {"type": "VT_R4|VT_ARRAY", "value": [0.5]}],
            },
        ),
    ],
)
def test_values(value: Variant, expected: dict[str, object]) -> None:
    raw = _unknown() if value.vt == 9 else encode_frame(5, 0, 102, (ROBOT, value))
    argument = record(raw)["args"][1]
    assert argument == {"name": "newVal", **expected}


def _unknown() -> bytes:
    """A frame whose second argument is of type 9, which b-CAP does not have."""
    raw = bytearray(encode_frame(5, 0, 102, (ROBOT, Variant(VT.EMPTY, None))))
    raw[33] = 9
    return bytes(raw)


@pytest.mark.parametrize("text", ["\x1b[31m", "\x9b", "\x7f", "\u202e", "\u2028", "\ud800", "\n"])
def test_strings_are_exact_and_never_raw(text: str) -> None:
    raw = encode_frame(5, 0, 64, (ROBOT, Variant(VT.BSTR, text), Variant(VT.BSTR, text)))
    (frame,) = parse_datagram(raw)
    assert isinstance(frame, Frame)
    line = FrameRecordRenderer().record(observe(frame), call_kind_of(frame))
    assert text.encode("utf-8", "surrogatepass") not in line
    value = json.loads(line)
    assert value["command"] == value["args"][2]["value"] == text


def test_forms_are_forgotten_in_time() -> None:
    renderer = FrameRecordRenderer()
    for number in range(MAX_TEMPLATES + 10):
        frame = Frame(encode_frame(5, 0, 64, (ROBOT, Variant(VT.BSTR, f"c{number}"), JOINTS)))
        renderer.record(observe(frame), call_kind_of(frame))
        assert len(renderer._templates) <= MAX_TEMPLATES


@given(st.lists(variants(), max_size=4), st.sampled_from(Direction), st.integers(0, 2**32 - 1))
def test_every_value_comes_back(values: list[Variant], direction: Direction, code: int) -> None:
    for _ in range(2):  # the second time through the learnt layout
        arguments = record(encode_frame(5, 0, code, values), direction)["args"]
        assert [argument["type"] for argument in arguments] == [vt_name(value.vt) for value in values]
        found = [argument["value"] for argument in arguments]
        assert [repr(item) for item in found] == [repr(plain(value)) for value in values]


@given(st.binary(max_size=120), st.sampled_from(Direction))
def test_any_bytes_are_objects(raw: bytes, direction: Direction) -> None:
    for item in parse_datagram(raw):
        call_kind = call_kind_of(item) if isinstance(item, Frame) else None
        text = FrameRecordRenderer().record(observe(item, direction), call_kind)
        assert json.loads(text)["length"] >= 0
        assert b"\n" not in text


def plain(variant: Variant) -> object:
    """Say a value as JSON has it."""
    value = variant.value
    if variant.vt == ARRAY | VT.VARIANT and isinstance(value, tuple):
        items = [item for item in value if isinstance(item, Variant)]
        return [_with_type(item) for item in items]
    if isinstance(value, tuple | bytes):
        return [_spelled(item) for item in value]
    return _spelled(value)


def _with_type(variant: Variant) -> dict[str, object]:
    encoded = encode_frame(5, 0, 102, (variant,))
    argument: dict[str, object] = record(encoded)["args"][0]
    assert argument["value"] == plain(variant)
    return {key: value for key, value in argument.items() if key != "name"}


def _spelled(value: Value | Variant) -> object:
    if not isinstance(value, float) or math.isfinite(value):
        return value
    return "NaN" if math.isnan(value) else "Infinity" if value > 0 else "-Infinity"
