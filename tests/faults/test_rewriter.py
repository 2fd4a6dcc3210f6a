"""Changing numbers in frames: what changes, what keeps its type, and what stays byte for byte."""

from __future__ import annotations

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from bcapscope.faults.fault_kinds import RewriteFault
from bcapscope.faults.fault_notation import read_fault
from bcapscope.faults.rewriter import MAX_BYTES, MAX_REMEMBERED, Rewriter, with_header
from bcapscope.protocol.codec.frame import Frame, Framing, encode_frame
from bcapscope.protocol.codec.variant import VT, Value, Variant
from bcapscope.traffic.observation import Endpoint, Flow, Transport
from tests.faults.traffic import request, talk
from tests.strategies import variants

FLOW = talk().up


def rewriter(text: str) -> Rewriter:
    """Make one of what stands behind rewrite."""
    fault = read_fault(f"rewrite {text}")
    assert isinstance(fault, RewriteFault)
    return Rewriter(fault)


def rewritten(text: str, *arguments: Variant, framing: Framing = Framing.PLAIN) -> list[Variant]:
    """Give the arguments after a change."""
    reserved = 1 if framing is Framing.VERSION_1_ZLIB else 0
    raw = rewriter(text).rewrite(Frame(encode_frame(5, reserved, 64, arguments, framing)), FLOW)
    frame = Frame(raw)
    assert not frame.problems
    assert (frame.serial, frame.code, frame.framing) == (5, 64, framing)
    return [argument.variant for argument in frame.arguments]


POSE = Variant.array(VT.R8, (1.0, 2.0, 100.0))
INTS = Variant.array(VT.I4, (1, 50))
SEVEN, NAME = Variant(VT.I4, 7), Variant(VT.BSTR, "P")
NESTED = Variant.array(VT.VARIANT, (POSE, SEVEN, NAME))


@pytest.mark.parametrize(
    ("text", "before", "after"),
    [
        ("set arg[0]=7", Variant(VT.I4, 1), Variant(VT.I4, 7)),
        ("set arg[0]=7", Variant(VT.R8, 1.0), Variant(VT.R8, 7.0)),
        ("set arg[0]=i2:7", Variant(VT.I4, 1), Variant(VT.I2, 7)),
        ("set arg[0]=x", Variant(VT.I4, 1), Variant(VT.I4, 1)),
        ("set arg[0]=x", Variant(VT.BSTR, "a"), Variant(VT.BSTR, "x")),
        ("set arg[0]=true", Variant(VT.BOOL, False), Variant(VT.BOOL, True)),
        ("set arg[0]=1,2", POSE, Variant.array(VT.R8, (1.0, 2.0))),
        ("set arg[0][1]=9", POSE, Variant.array(VT.R8, (1.0, 9.0, 100.0))),
        ("set arg[0][1]=r4:9", POSE, POSE),
        ("set arg[0][9]=9", POSE, POSE),
        ("set arg[9]=9", POSE, POSE),
        ("set arg[0][1]=7", Variant(VT.I4, 5), Variant(VT.I4, 5)),
        ("set arg[0][1]=200", Variant.array(VT.UI1, b"abc"), Variant.array(VT.UI1, b"a\xc8c")),
        ("set arg[0][0][2]=5", NESTED,
         NESTED._replace(value=(Variant.array(VT.R8, (1.0, 2.0, 5.0)), SEVEN, NAME))),
        ("set arg[0][1]=r8:9", NESTED, NESTED._replace(value=(POSE, Variant(VT.R8, 9.0), NAME))),
        ("set arg[0][9][0]=9", NESTED, NESTED),
        ("limit arg[0]=..90", POSE, Variant.array(VT.R8, (1.0, 2.0, 90.0))),
        ("limit arg[0]=5..90", INTS, Variant.array(VT.I4, (5, 50))),
        ("limit arg[0]=0.5..2.5", Variant(VT.I4, 3), Variant(VT.I4, 2)),
        ("limit arg[0]=0.5..2.5", Variant(VT.I4, 0), Variant(VT.I4, 1)),
        ("limit arg[0]=-1..1", Variant(VT.R8, math.nan), Variant(VT.R8, -1.0)),
        ("limit arg[0]=-1..1", Variant(VT.R8, math.inf), Variant(VT.R8, 1.0)),
        ("limit arg[0]=-1..1", Variant(VT.BSTR, "x"), Variant(VT.BSTR, "x")),
        ("limit arg[0]=..0", Variant(VT.BOOL, True), Variant(VT.BOOL, True)),
        ("limit arg[0]=..-1", Variant(VT.UI4, 7), Variant(VT.UI4, 7)),
    ],
)  # fmt: skip
def test_arguments_are_changed(text: str, before: Variant, after: Variant) -> None:
    assert rewritten(text, before) == [after]


def test_each_limit_acts_alone() -> None:
    assert rewritten("limit arg[0]=..90 limit arg[1]=..5", INTS, SEVEN) == [INTS, Variant(VT.I4, 5)]


def test_compressed_and_checked_frames_are_made_anew() -> None:
    for framing in (Framing.SERIAL_LINE, Framing.VERSION_1_ZLIB):
        assert rewritten("set arg[0]=7", Variant(VT.I4, 1), framing=framing) == [Variant(VT.I4, 7)]


def test_a_step_is_limited_from_one_message_to_the_next() -> None:
    machine = rewriter("step arg[2]=0.5")

    def pass_on(values: tuple[float, ...], command: str = "slvMove") -> Value:
        frame = Frame(machine.rewrite(Frame(request(1, command, values=values)), FLOW))
        return frame.arguments[2].variant.value

    assert pass_on((1, 1, 1)) == (1, 1, 1)
    assert pass_on((9, 1.25, -9)) == (1.5, 1.25, 0.5)
    assert pass_on((9, 1.25, math.nan)) == (2, 1.25, 0)
    assert pass_on((50, 50, 50), "Other") == (50, 50, 50)
    machine.close_conversation(FLOW.conversation)
    assert pass_on((9, 9, 9)) == (9, 9, 9)


@pytest.mark.parametrize(
    ("first", "second", "forwarded"),
    [
        (Variant.array(VT.R8, (1.0,)), Variant.array(VT.R8, (9.0, 9.0)), Variant.array(VT.R8, (1.5, 9.0))),
        (Variant(VT.BSTR, "x"), Variant(VT.R8, 9.0), Variant(VT.R8, 9.0)),
        (Variant(VT.R8, math.inf), Variant(VT.R8, 9.0), Variant(VT.R8, 9.0)),
    ],
)
def test_a_step_starts_from_a_finite_number(first: Variant, second: Variant, forwarded: Variant) -> None:
    machine = rewriter("step arg[0]=0.5")
    for value, changed in ((first, first), (second, forwarded)):
        raw = encode_frame(1, 0, 64, (value,))
        assert machine.rewrite(Frame(raw), FLOW) == encode_frame(1, 0, 64, (changed,))


def test_a_step_is_not_limited_from_one_command_or_code_to_another() -> None:
    machine = rewriter("step arg[0]=0.5")
    for value, (code, command) in enumerate(((64, "Move"), (64, "Speed"), (65, "Move"))):
        raw = encode_frame(1, 0, code, (Variant(VT.I4, value), Variant(VT.BSTR, command)))
        assert machine.rewrite(Frame(raw), FLOW) == raw


class Series:
    """Sends messages of many series, each with the next number of its series."""

    def __init__(self, size: int = 0) -> None:
        self.machine = rewriter("step arg[0]=1")
        self.filler = Variant.array(VT.UI1, b"")
        self.filler = Variant.array(VT.UI1, bytes(max(0, size - len(self.message(0, 0.0)))))

    def message(self, code: int, value: float) -> bytes:
        return encode_frame(1, 0, code, (Variant(VT.R8, value), self.filler))

    def start(self, *codes: int, flow: Flow = FLOW) -> None:
        """Send 0, from which a step may reach 1."""
        for code in codes:
            self.machine.rewrite(Frame(self.message(code, 0.0)), flow)

    def remembers(self, code: int) -> bool:
        """Send 9. Return whether the step was limited."""
        changed = self.machine.rewrite(Frame(self.message(code, 9.0)), FLOW)
        assert changed in (self.message(code, 1.0), self.message(code, 9.0))
        return changed == self.message(code, 1.0)


def test_the_series_without_news_for_longest_is_forgotten() -> None:
    series = Series()
    series.start(*range(MAX_REMEMBERED))
    assert series.remembers(0)
    series.start(MAX_REMEMBERED)
    assert not series.remembers(1)  # takes the place of 2
    assert series.remembers(3)
    series.start(0)
    assert series.remembers(0)


def test_large_messages_are_remembered_up_to_a_number_of_bytes() -> None:
    series = Series(MAX_BYTES // 4)
    series.start(1, 2, 3, 4, 4)
    assert [series.remembers(code) for code in (1, 2, 3, 4)] == [True] * 4
    series.start(1, 2, 3, 4, 5)
    assert [series.remembers(code) for code in (2, 3, 4, 5)] == [True] * 4
    assert not series.remembers(1)


def test_the_bytes_of_a_closed_conversation_count_no_longer() -> None:
    series, other = Series(MAX_BYTES // 4), talk(client=Endpoint("10.0.0.3", 50001)).up
    series.start(1, 2)
    series.start(1, 2, flow=other)
    series.machine.close_conversation(other.conversation)
    series.start(3, 4)
    assert [series.remembers(code) for code in (1, 2, 3, 4)] == [True] * 4


def test_the_latest_message_is_remembered_whatever_its_size() -> None:
    series = Series(MAX_BYTES + 1)
    series.start(1)
    assert series.remembers(1)
    series.start(2)
    assert not series.remembers(1)


def test_every_try_of_a_call_goes_on_alike_whatever_a_step_allows() -> None:
    machine = rewriter("step arg[2]=0.5")

    def pass_on(serial: int, reserved: int, *values: float) -> bytes:
        came = request(serial, "slvMove", values=values, reserved=reserved)
        raw = machine.rewrite(Frame(came), FLOW)
        assert raw[:9] == came[:9]
        return raw[9:]

    pass_on(1, 0, 0.0, 0.0)
    first = pass_on(2, 0, 9.0, 9.0)
    assert first == request(2, "slvMove", values=(0.5, 0.5))[9:]
    assert pass_on(3, 2, 9.0, 9.0) == first
    assert pass_on(4, 3, 9.0, 9.0) == first
    assert pass_on(4, 3, 9.0, 9.0) == first  # a copy that the network made
    assert pass_on(5, 0, 9.0, 9.0) == request(5, "slvMove", values=(1.0, 1.0))[9:]


def test_nothing_is_another_try_on_tcp() -> None:
    machine, up = rewriter("step arg[2]=0.5"), talk(Transport.TCP).up
    values = [Frame(machine.rewrite(Frame(request(0, values=(value,))), up)) for value in (0.0, 9.0, 9.0)]
    assert [frame.arguments[2].variant.value for frame in values] == [(0.0,), (0.5,), (1.0,)]


def test_numbers_of_the_header_are_changed_in_place() -> None:
    odd_true = encode_frame(1, 0, 64, (Variant(VT.BOOL, True),)).replace(b"\xff\xff", b"\1\0")
    for raw in (request(1) + b"tail", odd_true):
        changed = with_header(Frame(raw), serial=7, reserved=8, code=9)
        assert (Frame(changed).serial, Frame(changed).reserved, Frame(changed).code) == (7, 8, 9)
        assert (changed[:5], changed[13:]) == (raw[:5], raw[13:])


def test_a_checksum_goes_with_a_new_serial() -> None:
    raw = encode_frame(1, 0, 64, (Variant(VT.I4, 1),), Framing.SERIAL_LINE)
    changed = Frame(with_header(Frame(raw), serial=7))
    assert (changed.serial, changed.problems) == (7, ())


def test_only_the_header_of_a_frame_with_problems_is_changed() -> None:
    checked = encode_frame(1, 0, 64, (Variant(VT.I4, 1),), Framing.SERIAL_LINE)
    wrongly_checked = checked.replace(checked[-3:-1], b"\0\0")
    for raw in (request(1)[:-2], request(1)[:-1] + b"x", wrongly_checked):
        assert Frame(raw).problems
        changed = rewriter("serial 7 set arg[0]=9").rewrite(Frame(raw), FLOW)
        assert changed == raw[:5] + b"\7\0" + raw[7:]


@given(
    st.lists(variants(), max_size=4),
    st.sampled_from(["set arg[9]=1", "limit arg[0][1][2][3]=0..", "serial 5"]),
)
def test_what_does_not_change_stays_as_it_came(arguments: list[Variant], text: str) -> None:
    raw = encode_frame(5, 0, 64, arguments)
    assert rewriter(text).rewrite(Frame(raw), FLOW) is raw or "limit" in text


@given(
    st.lists(variants(), max_size=4),
    st.sampled_from(
        ["set arg[0]=1", "set arg[1][0]=x", "limit arg[0]=0..5", "limit arg[1][0]=..3", "step arg[0]=1"]
    ),
)
def test_any_frame_is_changed_without_trouble(arguments: list[Variant], text: str) -> None:
    machine = rewriter(text)
    raw = encode_frame(5, 0, 64, arguments)
    for _ in range(2):
        changed = Frame(machine.rewrite(Frame(raw), FLOW))
        assert changed.argc == len(arguments)
        assert not changed.problems
