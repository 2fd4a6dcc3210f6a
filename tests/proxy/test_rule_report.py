"""What the proxy says about its rules when it ends."""

from __future__ import annotations

import pytest

from bcapscope.protocol.codec.frame import Frame, encode_frame
from bcapscope.proxy.request_guard import RequestGuard
from bcapscope.proxy.rule_report import names_with_counts, report_lines
from bcapscope.traffic.observation import Direction
from tests.faults.traffic import MS, request
from tests.proxy.test_rule_policy import rules


def test_each_rule_has_its_line() -> None:
    made = rules("drop if serial == 9", "delay=1ms times 1 name slow", guard=RequestGuard(read_only=True))
    made.intercept.held_so_far, made.dropped_held = 3, 4
    for serial in (1, 2):
        made.receive(1, Direction.REQUEST, request(serial), 0)
        made.pop_due_actions(MS)
    assert list(map(str, report_lines(made))) == [
        "fault drop: injected never",
        "fault slow: injected once",
        "guard: refused 2 times",
        "intercept: held 3 times",
        "held requests dropped because their client no longer waited: 4",
    ]
    assert list(map(str, report_lines(rules(guard=RequestGuard())))) == ["guard: refused never"]
    assert report_lines(rules()) == []


def test_lost_requests_are_named_the_most_frequent_first() -> None:
    move, halt = Frame(request(1)), Frame(encode_frame(1, 0, 70))
    assert str(names_with_counts([halt, move, b"x", move])) == (
        "2 Robot_Execute slvMove, 1 Robot_Halt, 1 piece of a stream, or bytes that are not a frame"
    )


@pytest.mark.parametrize(
    ("names", "ending"), [(8, "1 Robot_Execute c7"), (9, " and 1 more"), (11, " and 3 more")]
)
def test_eight_names_are_enough(names: int, ending: str) -> None:
    text = str(names_with_counts([Frame(request(1, f"c{number}")) for number in range(names)]))
    assert text.endswith(ending)
    assert text.count("Robot_Execute") == 8


def test_of_a_long_name_eighty_characters_are_shown() -> None:
    text = str(names_with_counts([Frame(request(1, "c" * 100))]))
    assert text == "1 " + f"Robot_Execute {'c' * 100}"[:80]
