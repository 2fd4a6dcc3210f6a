"""What the proxy says about its rules when it ends."""

from __future__ import annotations

import pytest

from bcapscope.protocol.codec.frame import Frame, encode_frame
from bcapscope.proxy.rule_report import names_with_counts, report_lines
from tests.faults.traffic import request


def test_each_rule_has_its_line() -> None:
    assert list(map(str, report_lines({"drop": 0, "slow": 1}, 2, 3, 4, None))) == [
        "fault drop: injected never",
        "fault slow: injected once",
        "guard: refused 2 times",
        "intercept: held 3 times",
        "held requests dropped because their client no longer waited: 4",
    ]
    assert list(map(str, report_lines({}, 0, 0, 0, None))) == ["guard: refused never"]
    assert report_lines({}, None, 0, 0, None) == []


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
