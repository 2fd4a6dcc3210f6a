"""Faults in one line: what they mean, where the caret stands, and that they are written back."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from bcapscope.faults import fault_notation
from bcapscope.faults.document import RuleFile, read_document
from bcapscope.faults.fault import CloseMode, JitterDistribution
from bcapscope.faults.fault_kinds import (
    AnswerFault,
    AnyFault,
    BandwidthFault,
    BurstFault,
    CloseFault,
    CorruptFault,
    DelayFault,
    DropFault,
    DuplicateFault,
    ExecutingFault,
    GarbageFault,
    HalfOpenFault,
    PartitionFault,
    PassFault,
    ReorderFault,
    RewriteFault,
    SerialFault,
    TruncateFault,
)
from bcapscope.faults.fault_notation import NotationError, read_fault, rewrite_message, write_fault
from bcapscope.faults.quantities import DurationQuantity, FrameCondition, HresultQuantity, Rate, Share, Span
from bcapscope.traffic.observation import Direction
from tests.faults.traffic import request, talk

MS = 1_000_000

TABLE: list[tuple[str, AnyFault]] = [
    ("pass", PassFault()),
    ("drop", DropFault()),
    ("loss=5%", DropFault(probability=Share(0.05))),
    ("drop 5%", DropFault(probability=Share(0.05))),
    (
        "drop reply try 1 if command == slvMove",
        DropFault(direction=Direction.RESPONSE, attempt=1, when=FrameCondition.read("command == slvMove")),
    ),
    (
        "drop times 3 after 2s for 10s",
        DropFault(times=3, after=DurationQuantity(2000 * MS), lasts=DurationQuantity(10_000 * MS)),
    ),
    ("delay=3ms", DelayFault(time=DurationQuantity(3 * MS))),
    ("delay=3ms±1ms", DelayFault(time=DurationQuantity(3 * MS), jitter=DurationQuantity(MS))),
    ("delay=3ms+-1ms", DelayFault(time=DurationQuantity(3 * MS), jitter=DurationQuantity(MS))),
    (
        "delay time 3ms jitter 1ms distribution normal",
        DelayFault(
            time=DurationQuantity(3 * MS), jitter=DurationQuantity(MS), distribution=JitterDistribution.NORMAL
        ),
    ),
    ("duplicate=2 time 1ms", DuplicateFault(copies=2, time=DurationQuantity(MS))),
    ("reorder=3 time 20ms", ReorderFault(by=3, time=DurationQuantity(20 * MS))),
    ("corrupt=2 offset 5", CorruptFault(bits=2, offset=5)),
    ("truncate=20", TruncateFault(keep=20)),
    ("truncate", TruncateFault()),
    ("garbage=64 request", GarbageFault(size=64, direction=Direction.REQUEST)),
    ("garbage direction any", GarbageFault(direction=None)),
    ("burst=1%/25% bad 80%", BurstFault(enter=Share(0.01), leave=Share(0.25), bad=Share(0.8))),
    ("bandwidth=64kbit/s queue 1000", BandwidthFault(rate=Rate(8000), queue=1000)),
    ("answer=E_FAIL name no", AnswerFault(hresult=HresultQuantity(0x80004005), name="no")),
    ("serial=-1", SerialFault(by=-1)),
    ("serial=+2", SerialFault(by=2)),
    (
        "executing=2s every 50ms",
        ExecutingFault(time=DurationQuantity(2000 * MS), every=DurationQuantity(50 * MS)),
    ),
    ("close", CloseFault()),
    ("close=fin", CloseFault(how=CloseMode.FIN)),
    ("partition for 5s", PartitionFault(lasts=DurationQuantity(5000 * MS))),
    ("half-open", HalfOpenFault()),
    (
        'rewrite set arg[2][0]=10 set arg[1]="a \\"b\\" c" limit arg[2]=-90..90 step arg[2]=0.5 serial 5',
        RewriteFault(
            set={"arg[2][0]": 10, "arg[1]": 'a "b" c'},
            limit={"arg[2]": Span(-90, 90)},
            step={"arg[2]": 0.5},
            serial=5,
        ),
    ),
    ("rewrite set arg[0]=true set arg[1]=r4:1.5", RewriteFault(set={"arg[0]": True, "arg[1]": "r4:1.5"})),
    ("rewrite set arg[0]=false", RewriteFault(set={"arg[0]": False})),
    ("rewrite serial 0 reserved 65535", RewriteFault(serial=0, reserved=0xFFFF)),
    (
        "executing=10s every 1ms",
        ExecutingFault(time=DurationQuantity(10_000 * MS), every=DurationQuantity(MS)),
    ),
    (f"drop times {7:040}", DropFault(times=7)),
    ("drop times 1", DropFault(times=1)),
    ("drop times 1000000", DropFault(times=1_000_000)),
]

DEFAULTS: list[tuple[str, AnyFault]] = [
    ("drop", DropFault(name="", probability=Share(1), after=DurationQuantity(0))),
    ("burst=1%/25%", BurstFault(enter=Share(0.01), leave=Share(0.25), bad=Share(1), good=Share(0))),
    (
        "delay=3ms",
        DelayFault(
            time=DurationQuantity(3 * MS), jitter=DurationQuantity(0), distribution=JitterDistribution.UNIFORM
        ),
    ),
    ("duplicate", DuplicateFault(copies=1, time=DurationQuantity(0))),
    ("reorder", ReorderFault(by=1, time=DurationQuantity(100 * MS))),
    ("corrupt", CorruptFault(bits=1, offset=None)),
    ("garbage", GarbageFault(direction=Direction.RESPONSE, size=None)),
    ("serial", SerialFault(direction=Direction.RESPONSE, by=1)),
    ("answer=E_FAIL", AnswerFault(direction=Direction.REQUEST, hresult=HresultQuantity(0x80004005))),
    (
        "executing=1s",
        ExecutingFault(
            direction=Direction.RESPONSE,
            time=DurationQuantity(1000 * MS),
            every=DurationQuantity(100 * MS),
        ),
    ),
    ("close", CloseFault(how=CloseMode.RESET)),
    ("bandwidth=64kbit/s", BandwidthFault(rate=Rate(8000), queue=256 * 1024)),
]


@pytest.mark.parametrize(("text", "fault"), TABLE, ids=[text for text, _ in TABLE])
def test_reading_and_writing(text: str, fault: AnyFault) -> None:
    assert read_fault(text) == fault
    assert read_fault(write_fault(fault)) == fault


@pytest.mark.parametrize(("text", "fault"), DEFAULTS, ids=[text for text, _ in DEFAULTS])
def test_what_a_fault_does_unless_it_says_otherwise(text: str, fault: AnyFault) -> None:
    assert read_fault(text) == fault


def test_words_that_mean_something_else_are_quoted() -> None:
    for word in ("true", "5", "1e5", "if", "", " ", "any", '"'):
        fault = RewriteFault(set={"arg[1]": word})
        assert read_fault(write_fault(fault)) == fault


@pytest.mark.parametrize(
    "text",
    [
        "delay=3ms±1ms times 5 if command == slvMove",
        "burst=1%/25%",
        "drop name lossy response 5%",
        "garbage direction any",
        'rewrite set arg[0]=true set arg[1]=P5 set arg[2]="two words"',
    ],
)
def test_only_what_needs_quotes_is_written_in_quotes(text: str) -> None:
    assert write_fault(read_fault(text)) == text


def test_changes_of_a_message_leave_alone_what_is_no_frame() -> None:
    up, junk = talk().up, b"\x02no frame"
    assert rewrite_message(request(1) + junk, up, "serial 7") == request(7) + junk
    assert rewrite_message(request(1), up, "set arg[9]=0") == request(1)
    with pytest.raises(ValueError, match="a rewrite needs serial"):
        rewrite_message(request(1), up, "")


@pytest.mark.parametrize(
    ("text", "position", "reason"),
    [
        ("", 0, "expected an action: answer, "),
        ("  los=5%", 2, "there is no action 'los', did you mean 'loss'?"),
        ("loss", 4, "expected = and a value after loss"),
        ("loss=5", 5, "5 is not between 0% and 100%"),
        ("loss=x", 5, "'x' is not a percentage"),
        ("pass=5%", 4, "pass takes no value"),
        ("delay", 5, "time is missing"),
        ("delay if serial == 1", 5, "time is missing"),
        ("delay=3", 6, "3 is not a duration"),
        ("delay=3ms±x", 10, "'x' is not a duration"),
        ("delay=3ms+-x", 11, "'x' is not a duration"),
        ("delay=3ms±1ms±1ms", 6, "expected time±jitter"),
        ("delay=3ms+-1ms+-1ms", 6, "expected time±jitter"),
        ("burst=1%", 8, "leave is missing"),
        ("drop reply request", 11, "direction is given twice"),
        ("drop time 3ms", 5, "'time' is not allowed here, did you mean 'times'?"),
        ("drop times", 10, "a value for times is missing"),
        ("drop times 0", 11, "Expected int >= 1"),
        ("drop times 1000001", 11, "Expected int <= 1000000"),
        (f"drop times {7:041}", 11, "a number of more than 40 characters"),
        ("drop name a=b", 10, "a name has at most 60 letters, digits and _ . + -"),
        ("drop try x", 9, "Expected int | null, got str"),
        ("close=rst", 6, "'rst' is not one of reset, fin"),
        ("answer=E_FAL", 7, "'E_FAL' is not an HRESULT, did you mean 'E_FAIL'?"),
        ("executing=10s every 999999ns", 0, "every must be at least 1ms"),
        ("executing=10001ms every 1ms", 0, "more than 10000 notices"),
        ("drop if comand == 1", 8, "there is no field 'comand', did you mean 'command'?"),
        ("drop  if  ", 8, "the filter is empty"),
        ("drop if serial == 1 and", 23, "expected a field"),
        ("rewrite", 0, "a rewrite needs serial"),
        ("rewrite set arg[1]", 12, "expected an argument, = and a value"),
        ("rewrite serial -1", 15, "Expected int >= 0"),
        ("rewrite reserved 65536", 17, "Expected int <= 65535"),
        ("rewrite limit arg[0]=x", 14, "'x' is not a range"),
        ("rewrite set arg=1", 0, "'arg' is not an argument"),
        ("rewrite set arg[1]=1 set arg[1]=2", 25, "set arg[1] is given twice"),
        ('rewrite set arg[1]="\\q"', 19, "the text in quotes is not valid"),
    ],
)
def test_errors_point_at_the_spot(text: str, position: int, reason: str) -> None:
    with pytest.raises(NotationError) as caught:
        read_fault(text)
    assert reason in str(caught.value.reason)
    assert caught.value.position == position
    assert str(caught.value).splitlines()[-1].endswith("^")


@given(
    st.text(max_size=60)
    | st.lists(
        st.sampled_from([*'=±%5[]" ', "delay", "if", "rewrite", "set", "3ms", "arg[0]", "loss"]), max_size=12
    ).map(" ".join)
)
def test_any_text_is_read_or_refused(text: str) -> None:
    try:
        fault = read_fault(text)
    except NotationError as error:
        position: int | None = error.position
    else:
        position = None
        assert read_fault(write_fault(fault)) == fault
    assert position is None or 0 <= position <= len(text)


def test_the_names_that_files_have_for_main_values_are_told() -> None:
    help_text = fault_notation.__doc__ or ""
    for action, fields in fault_notation._MAIN_FIELDS.items():
        assert f"{action} {' '.join(fields)}" in help_text or action in ("loss", "delay")


def test_the_file_that_is_shown_can_be_read() -> None:
    help_text = fault_notation.__doc__ or ""
    start = help_text.index("    faults:")
    document = read_document(help_text[start : help_text.index("\n\n", start)], RuleFile)
    assert list(document.faults) == [
        read_fault("drop 5% response try 1"),
        read_fault("delay=3ms±1ms times 5 if command == slvMove"),
    ]
