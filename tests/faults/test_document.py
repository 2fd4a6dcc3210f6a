"""Rule files: the vocabulary, and errors that name line and field."""

from __future__ import annotations

from contextlib import suppress
from functools import reduce
from typing import Any

import msgspec
import pytest
from hypothesis import given
from hypothesis import strategies as st

from bcapscope.faults.document import (
    LONGEST_DOCUMENT,
    DocumentError,
    FieldError,
    RuleFile,
    convert_data,
    fault_from,
    read_document,
    to_plain_data,
)
from bcapscope.faults.fault_kinds import ACTIONS, AnswerFault, AnyFault, DelayFault, DropFault, RewriteFault
from bcapscope.faults.fault_notation import read_fault
from bcapscope.faults.quantities import DurationQuantity, FrameCondition, HresultQuantity, Share, Span
from bcapscope.messages import Message
from bcapscope.traffic.observation import Direction
from tests.faults.test_fault_notation import TABLE

SAMPLE = """\
faults:
  - action: drop          # one in twenty
    probability: 5%
    direction: response
    try: 1
    if: command == slvMove
  - {action: delay, time: 3ms, name: slow, for: 10 s}
  - action: answer
    hresult: 0x83500121
  - action: rewrite
    set:
      arg[2][0]: 10
    limit: {"arg[2]": ..90}
"""


def test_a_rule_file_is_read() -> None:
    assert read_document(SAMPLE, RuleFile).faults == (
        DropFault(
            probability=Share(0.05),
            direction=Direction.RESPONSE,
            attempt=1,
            when=FrameCondition.read("command == slvMove"),
        ),
        DelayFault(time=DurationQuantity(3_000_000), name="slow", lasts=DurationQuantity(10_000_000_000)),
        AnswerFault(hresult=HresultQuantity(0x83500121)),
        RewriteFault(set={"arg[2][0]": 10}, limit={"arg[2]": Span.read("..90")}),
    )


@pytest.mark.parametrize(
    ("text", "error"),
    [
        (
            "faults:\n  - action: delay\n    time: 3\n",
            "line 3: faults[0].time: 3 is not a duration such as 3ms",
        ),
        ("faults:\n  - action: delay\n", "line 2: faults[0]: time is missing"),
        (
            "faults:\n  - action: dely\n",
            "line 2: faults[0].action: there is no action 'dely', did you mean 'delay'?",
        ),
        (
            "faults:\n  - {action: loss, probability: 5%}\n",
            "line 2: faults[0].action: there is no action 'loss', did you mean 'drop'?",
        ),
        ("faults:\n  - time: 3ms\n", "line 2: faults[0]: action is missing, such as answer, bandwidth"),
        (
            "faults:\n  - action: drop\n    name: x\n    tims: 3\n",
            "line 4: faults[0]: there is no field 'tims', did you mean 'times'?",
        ),
        ("faults:\n  - action: drop\n    times: 0\n", "line 3: faults[0].times: Expected int >= 1"),
        (
            "faults:\n  - action: drop\n    direction: reply\n",
            "line 3: faults[0].direction: 'reply' is not one of request, response",
        ),
        (
            "faults:\n  - action: drop\n    if: comand == 1\n",
            "line 3: faults[0].if: there is no field 'comand', did you mean 'command'?\n  comand == 1\n  ^",
        ),
        ("faults:\n  - action: rewrite\n    set: {arg: 1}\n", "line 2: faults[0]: 'arg' is not an argument"),
        ("fault: []\n", "line 1: there is no field 'fault', did you mean 'faults'?"),
        ("faults: 5\n", "line 1: faults: Expected array, got int"),
        ("faults:\n  5\n", "line 1: faults: Expected array, got int"),
        ("faults:\n  - {1: 2, action: drop}\n", "line 2: faults[0]: a key is one word"),
        ("5\n", "line 1: Expected object, got int"),
        ("", "line 1: Expected object, got null"),
        ("faults: [\n", "line 2: "),
        ("faults: &a []\nb: *a\n", "line 2: YAML anchors are not supported"),
        ("faults: []\nfaults: []\n", "line 2: 'faults' is given twice"),
        ("? [a]\n: 1\n", "line 1: a key is one word"),
        ("faults: []\n---\nfaults: []\n", "line 2: but found another document"),
        ("\x00", "this is not YAML: "),
        ("faults: !!python/object:os.system []\n", "line 1: could not determine a constructor"),
        ("faults: " + "[" * 200_000, "line 1: more than 64 levels"),
        ("faults:\n" + "- " * 65, "line 2: more than 64 levels"),
        ("faults: 2001-99-99", "this is not YAML: month must be in 1..12"),
        ('faults: !!int ""', "this is not YAML: string index out of range"),
        ("faults: !!bool 9", "this is not YAML: '9'"),
        ("faults: !!timestamp 9", "this is not YAML: "),
        (f"faults: {'9' * 41}", "line 1: a number of more than 40 characters"),
        (f"faults: {'9' * 40}", "line 1: faults: Expected array, got int"),
        ("x" * (1 << 20) + "x", "longer than the limit of 1048576 characters"),
    ],
)
def test_errors_name_line_and_field(text: str, error: str) -> None:
    with pytest.raises(DocumentError) as caught:
        read_document(text, RuleFile)
    assert str(caught.value).startswith(error)
    assert " - at " not in str(caught.value)  # with these words, msgspec names the field a second time


def test_a_document_of_the_longest_length_is_read() -> None:
    assert read_document("faults: [] ".ljust(LONGEST_DOCUMENT, "#"), RuleFile).faults == ()


class Rows(msgspec.Struct, frozen=True):
    """Rows of which the second one must have another title, even if it is not written down."""

    rows: tuple[dict[str, str], ...] = ()
    title: str = ""

    def __post_init__(self) -> None:
        raise FieldError(("rows", 1, "title"), Message("document.endless"))


@pytest.mark.parametrize(
    ("text", "line"),
    [
        ("title: x\nrows:\n  - title: x\n  - {}\n", 4),
        ("title: x\nrows:\n  - title: x\n", 2),
        ("a: 1\ntitle: x\n", 1),
    ],
)
def test_an_error_in_what_is_not_written_has_the_line_around_it(text: str, line: int) -> None:
    with pytest.raises(DocumentError, match=r"rows\[1\]\.title: ") as caught:
        read_document(text, Rows)
    assert caught.value.line == line


class Limits(msgspec.Struct, frozen=True):
    """Two fields that must fit each other."""

    low: int
    high: int

    def __post_init__(self) -> None:
        if self.low > self.high:
            raise FieldError(("low",), Message("scenario.above-high"))


def deep_list() -> list[Any]:
    """Make a list of more levels than Python can print."""
    return reduce(lambda inner, _: [inner], range(10_000), [])


@pytest.mark.parametrize(
    ("data", "kind", "error"),
    [
        ({"action": "rewrite", "set": {"arg": 1}}, AnyFault, "'arg' is not an argument"),
        ({"action": "delay"}, AnyFault, "time is missing"),
        ({"low": 2, "high": 1}, Limits, "low: "),
        ({"action": "drop", 1: 2}, AnyFault, "a key is one word"),
        ({"action": "delay", "time": deep_list()}, AnyFault, "lists are nested too deeply"),
        ({"action": "delay", "name": deep_list()}, AnyFault, "name: Expected str, got array"),
        ({"action": deep_list()}, AnyFault, "action: Expected str, got list"),
    ],
)
def test_errors_in_data_without_text_name_no_line(data: object, kind: Any, error: str) -> None:
    with pytest.raises(DocumentError) as caught:
        convert_data(data, kind)
    assert str(caught.value).startswith(error)


class Scene(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """A document of another kind that has faults in it."""

    wait: DurationQuantity
    faults: tuple[AnyFault, ...] = ()


def test_other_documents_have_faults_and_quantities_too() -> None:
    scene = read_document("wait: 5ms\nfaults: [{action: pass}]", Scene)
    assert (scene.wait, scene.faults[0].action) == (5_000_000, "pass")
    with pytest.raises(DocumentError, match=r"line 2: wait: 'x' is not a duration"):
        read_document("faults: []\nwait: x", Scene)


@pytest.mark.parametrize("text", [text for text, _ in TABLE])
def test_plain_data_becomes_the_same_fault(text: str) -> None:
    fault = read_fault(text)
    assert fault_from(to_plain_data(fault)) == fault


def test_the_table_has_every_action() -> None:
    assert {read_fault(text).action for text, _ in TABLE} == set(ACTIONS)


@given(
    st.recursive(
        st.none()
        | st.booleans()
        | st.integers()
        | st.floats()
        | st.sampled_from([*ACTIONS, "5%", "3ms", "action", "x"]),
        lambda inner: (
            st.lists(inner, max_size=3)
            | st.dictionaries(
                st.sampled_from(["action", "faults", "if", "set", "time", "name", "hresult"]),
                inner,
                max_size=4,
            )
        ),
    )
)
def test_any_data_is_taken_or_refused(data: object) -> None:
    with suppress(DocumentError):
        assert len(convert_data({"faults": [data]}, RuleFile).faults) == 1
