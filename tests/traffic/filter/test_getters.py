"""Each field of the filter language read from real frames and real calls."""

from __future__ import annotations

import pytest

from bcapscope.protocol.codec.arguments import Argument
from bcapscope.protocol.codec.frame import Frame, Malformed, encode_frame
from bcapscope.traffic.call import Call
from bcapscope.traffic.call_kind import RecentRequests
from bcapscope.traffic.filter.compiler import compile_filter
from bcapscope.traffic.filter.field_table import (
    FIELDS,
    SINCE_FIRST,
    FieldType,
    FilterField,
    RecordKind,
    fields_of,
)
from bcapscope.traffic.filter.getters import CALL_GETTERS, FRAME_GETTERS, AnnotatedFrame
from bcapscope.traffic.observation import Direction, Endpoint
from tests.samples.problems import problem_of
from tests.traffic.playbook import (
    MOVE,
    POSE,
    S_EXECUTING,
    START,
    START_SERVICE,
    Script,
    calls_of,
    execute,
)

HOLE = Malformed(b"", (problem_of(0, "gap", "120 bytes of the stream are missing"),), 120)
NO_FRAME = Malformed(b"=HELLO", (problem_of(0, "soh", "first byte is 3D, a frame begins with 01"),))


def script() -> Script:
    """Play a session with a retry, notices, a refusal, a call without reply and bytes that are no frame."""
    found = Script()
    client = found.client()
    client.ask(0, 1, 0, START_SERVICE)
    client.reply(1, 1)
    client.ask(8, 2, 0, MOVE)
    client.ask(10, 3, 2, MOVE)
    client.reply(10.5, 2, 0, 0, POSE)
    client.reply(11, 3, 0, 0, POSE)
    client.ask(20, 4, 0, execute("Motor"))
    client.reply(21, 4, 0, S_EXECUTING)
    client.reply(23, 4, 0, 0x83500121)
    client.see(24, Direction.REQUEST, NO_FRAME)
    client.see(25, Direction.RESPONSE, HOLE)
    client.ask(30, 5, 0, (200, ()))
    client.see(33, Direction.REQUEST, Frame(encode_frame(6, 0, 2)[:-1]))
    return found


def told() -> list[AnnotatedFrame]:
    about = RecentRequests().kind_of
    return [AnnotatedFrame(seen, about(seen)) for seen in script().seen]


def calls() -> list[Call]:
    return calls_of(script().track())


def test_a_frame_and_its_meaning() -> None:
    frames = told()
    request, refusal = frames[2], frames[8]
    assert request.frame is request.observation.item
    assert (request.number, request.time) == (request.observation.number, request.observation.time)
    assert request.conversation is request.observation.flow.conversation
    assert request.raw == encode_frame(2, 0, *MOVE)
    assert (request.kind, request.problems, request.hresult) == ("request", (), None)
    assert (request.function, request.command) == ("Robot_Execute", "slvMove")
    assert (refusal.kind, refusal.hresult, refusal.command) == ("response", 0x83500121, "Motor")


def test_bytes_that_are_no_frame_have_no_meaning() -> None:
    garbage = told()[9]
    assert (garbage.kind, garbage.frame, garbage.raw) == ("malformed", None, b"=HELLO")
    assert garbage.problems == NO_FRAME.problems
    assert (garbage.function, garbage.command, garbage.hresult) == (None, None, None)


_TYPES: dict[FieldType, tuple[type, ...]] = {
    FieldType.NUMBER: (int,),
    FieldType.TEXT: (str,),
    FieldType.TIME: (int,),
    FieldType.DURATION: (int,),
    FieldType.HRESULT: (int,),
    FieldType.ENDPOINT: (Endpoint,),
    FieldType.NUMBERS: (list, tuple),
    FieldType.TEXTS: (list, tuple),
    FieldType.VALUES: (list, tuple),
}
_ELEMENTS: dict[FieldType, type] = {
    FieldType.NUMBERS: int,
    FieldType.TEXTS: str,
    FieldType.VALUES: Argument,
}


@pytest.mark.parametrize(
    ("kind", "getters"), [(RecordKind.FRAME, FRAME_GETTERS), (RecordKind.CALL, CALL_GETTERS)]
)
def test_there_is_a_getter_for_each_field_and_none_besides(
    kind: RecordKind, getters: dict[str, object]
) -> None:
    names = {field.getter_name for field in fields_of(kind).values()} - {SINCE_FIRST}
    assert names == getters.keys()


def assert_type(field: FilterField, values: list[object]) -> None:
    """Hold all values to the type of the field, and see that some record has one."""
    there = [value for value in values if value is not None]
    assert there
    for value in there:
        assert isinstance(value, _TYPES[field.type])
        if isinstance(value, list | tuple) and field.type in _ELEMENTS:
            assert all(isinstance(item, _ELEMENTS[field.type]) for item in value)
        if field.values and field.name != "function":
            assert value in field.values


@pytest.mark.parametrize(
    "field", [field for field in FIELDS if field.name != SINCE_FIRST], ids=lambda field: field.name
)
def test_values_are_of_the_type_of_the_field(field: FilterField) -> None:
    if RecordKind.FRAME in field.applies_to:
        assert_type(field, [FRAME_GETTERS[field.getter_name](each) for each in told()])
    if RecordKind.CALL in field.applies_to:
        assert_type(field, [CALL_GETTERS[field.getter_name](each) for each in calls()])


def frames_with(expression: str) -> list[int]:
    """List the numbers of the frames for which an expression holds."""
    test = compile_filter(expression, RecordKind.FRAME).bind(FRAME_GETTERS)
    return [each.observation.number for each in told() if test(each)]


@pytest.mark.parametrize(
    ("expression", "expected"),
    [
        ("frame == 3", [3]),
        ("packet == 3", [3]),
        ("time >= 1700000000.023 and time < 1700000000.025", [9, 10]),
        ("src == 10.0.0.2 and kind == request", [1, 3, 4, 7, 12, 13]),
        ("dst == 10.0.0.2:50001", [2, 5, 6, 8, 9, 11]),
        ("client == 10.0.0.2:50001 and server == 10.0.0.1", list(range(1, 14))),
        ("transport == tcp", []),
        ("kind == malformed", [10, 11]),
        ("length == 6", [10]),
        ("length == 0", [11]),
        ("serial == 3", [4, 6]),
        ("reserved > 0", [4]),
        ("function == Service_Start", [1, 2]),
        ("function_id == 200", [12]),
        ("function == null", [10, 11]),
        ("command == SLVMOVE", [3, 4, 5, 6]),
        ("arg[0] == 1 and arg[1] == Motor", [7]),
        ("arg[2][0] == 1.0", [3, 4]),
        ("hresult == S_OK", [2, 5, 6]),
        ("hresult < 0", [9]),
        ("hresult == null", [1, 3, 4, 7, 10, 11, 12, 13]),
        ("hresult_name == S_EXECUTING", [8]),
        ('hresult_text ~ "slave mode"', [9]),
        ('problems contains "missing"', [11]),
        ("problems", [10, 11, 13]),
    ],
)
def test_filters_on_frames(expression: str, expected: list[int]) -> None:
    assert frames_with(expression) == expected


def calls_with(expression: str) -> list[int]:
    """List the numbers of the calls for which an expression holds."""
    test = compile_filter(expression, RecordKind.CALL).bind(CALL_GETTERS)
    return [each.number for each in calls() if test(each)]


@pytest.mark.parametrize(
    ("expression", "expected"),
    [
        ("call > 3", [4, 5]),
        ("client == 10.0.0.2 and server == 10.0.0.1:5007", [1, 2, 3, 4, 5]),
        ("transport == udp and function_id == 64", [2, 3]),
        ("function == Service_Start", [1]),
        ('function == "Unknown(200)"', [4]),
        ("command in (slvMove, motor)", [2, 3]),
        ("command == null", [1, 4, 5]),
        ("arg[2][1] == 2", [2]),
        ("hresult == 0x83500121", [3]),
        ("hresult_name == S_OK", [1, 2]),
        ("hresult_name == null", [4, 5]),
        ("started < 1700000000.010", [1, 2]),
        ("requests contains 4", [2]),
        ("serials[1] == 3", [2]),
        ("retries > 0", [2]),
        ("unseen_retries > 0", []),
        ("replies == null or not replies", [4, 5]),
        ("late_replies contains 5", [2]),
        ("lost_replies", []),
        ("duplicates", []),
        ('hresult_text ~ "slave mode"', [3]),
        ("executing == 1", [3]),
        ("outcome == refused", [3]),
        ("outcome == unanswered", [4]),
        ("outcome == capture_ended", [5]),
        ("latency > 2ms", [2, 3]),
        ("latency_ms == 3", [2, 3]),
        ("rtt == 1ms", [1, 2]),
        ("rtt_ms < 2", [1, 2]),
        ("convention == unknown", [1, 2, 3, 4, 5]),
        ('verdict == "reply late"', [2]),
    ],
)
def test_filters_on_calls(expression: str, expected: list[int]) -> None:
    assert calls_with(expression) == expected


def test_what_an_observation_and_its_ends_look_like() -> None:
    seen = script().seen[1]
    assert repr(seen.flow.conversation) == "Conversation(10.0.0.2:50001 > 10.0.0.1:5007 udp)"
    assert repr(seen.flow) == "Flow(10.0.0.1:5007 > 10.0.0.2:50001 udp response)"
    assert str(Endpoint("fe80::1", 5007)) == "[fe80::1]:5007"
    assert str(Endpoint("client", 0)) == "client"
    assert seen.time == START + 1_000_000


def elapsed(expression: str) -> list[int]:
    """List the numbers of the frames of `told` for which an expression holds, in ms since the first."""
    first = next(iter(told())).observation.time
    test = compile_filter(expression, RecordKind.FRAME).bind(FRAME_GETTERS, lambda: first)
    return [each.observation.number for each in told() if test(each)]


def test_t_is_the_time_since_the_first_frame() -> None:
    frames = [each.observation for each in told()]
    first = frames[0].time
    for expression, limit in (("t > 0.001", 1_000_000), ("t > 5ms", 5_000_000), ("t > 0", 0)):
        assert elapsed(expression) == [each.number for each in frames if each.time - first > limit]
    assert elapsed("t == 0") == [each.number for each in frames if each.time == first]


def test_t_counts_from_the_first_record_that_is_tested() -> None:
    last = list(told())[-1].observation
    assert frames_with("t == 0 and kind == request") == elapsed("t == 0 and kind == request")
    expression = f"serial == {last.item.serial} and t > 0" if isinstance(last.item, Frame) else "t > 0"
    assert frames_with(expression) == elapsed(expression)
    assert last.number in frames_with(expression)


def test_t_of_a_call_is_that_of_its_first_request() -> None:
    found = list(calls())
    first = min(call.request.time for call in found)
    test = compile_filter("t > 2ms", RecordKind.CALL).bind(CALL_GETTERS, lambda: first)
    wanted = [call.number for call in found if call.request.time - first > 2_000_000]
    assert [call.number for call in found if test(call)] == wanted
