"""Figures for people and programs."""

from __future__ import annotations

import json
import unicodedata
from collections.abc import Callable
from typing import Any

import pytest

from bcapscope.analysis.statistics.call_statistics import (
    MAX_KINDS,
    OTHER_CLIENTS,
    OTHER_KINDS,
    Statistics,
    StatisticsBuilder,
)
from bcapscope.render.color_palette import ANSI
from bcapscope.render.statistics_text import MAX_ROWS, call_kind_text, statistics_lines, statistics_record
from bcapscope.traffic.call import Call, CallState
from bcapscope.traffic.call_kind import CallKind
from tests.analysis.exchanges import EXECUTE, MOVE, READ, START, STOP, client, made
from tests.render.scenes import HOSTILE

OTHER = client(50002)


def summed(calls: list[Call]) -> Statistics:
    summary = StatisticsBuilder()
    for call in calls:
        summary.add_call(call)
    statistics = summary.statistics()
    assert statistics is not None
    return statistics


def several() -> Statistics:
    """Two clients, of which one has trouble."""
    calls = [made(8 * n, 1.0 + n % 10 / 100) for n in range(200)]
    calls += [made(8 * n, 4.2, retries=2, late=1, notices=1) for n in range(3)]
    calls += [made(50, None), made(60, 1.5, READ, code=0x83500121), made(61, 1.5, READ, code=0x600B)]
    calls += [made(70, 2.0, CallKind(EXECUTE, HOSTILE)), made(80, 1.0, STOP, OTHER)]
    calls += [made(90, None, READ, OTHER, given_up=False)]
    return summed(calls)


def test_figures_of_several_clients(golden: Callable[[str, bytes], None]) -> None:
    golden("statistics.txt", "".join(f"{line}\n" for line in statistics_lines(several())).encode())


def test_figures_in_colour(golden: Callable[[str, bytes], None]) -> None:
    lines = statistics_lines(several(), ANSI)
    golden("statistics.ansi", "".join(f"{line}\n" for line in lines).encode())


def test_figures_as_json(golden: Callable[[str, bytes], None]) -> None:
    golden("statistics.json", statistics_record(several()) + b"\n")


def test_nothing_from_the_wire_is_raw() -> None:
    for text in (*statistics_lines(several()), statistics_record(several()).decode()):
        assert not [char for char in text if unicodedata.category(char)[0] == "C"]


def test_calls_that_were_not_followed_are_counted_apart() -> None:
    call = made(0, None, given_up=False)
    assert "not followed" not in "".join(statistics_lines(summed([call])))
    call.state = CallState.EVICTED
    statistics = summed([call])
    assert list(statistics_lines(statistics))[-1] == "not followed to the end, as too many were open: 1 call"
    total = json.loads(statistics_record(statistics))["total"]
    assert [total[each] for each in ("unanswered", "capture_ended", "not_followed")] == [0, 0, 1]


def test_one_client_is_not_told_twice() -> None:
    lines = list(statistics_lines(summed([made(0, 1.0), made(8, 1.0)])))
    assert not [line for line in lines if "all clients" in line]
    assert lines[0] == "2023-11-14T22:13:20.000000000Z, 0.009 s"
    assert lines[3].split() == [
        *("10.0.0.2:50001", ">", "10.0.0.1:5007", "udp", "2", "222.2", "22.2%"),
        *["1.000"] * 5,
    ]


def test_no_time_has_no_rate() -> None:
    statistics = summed([made(0, None, given_up=False)])
    assert statistics.start == statistics.end == START
    assert list(statistics_lines(statistics))[3].split()[-1] == "1"
    total = json.loads(statistics_record(statistics))["total"]
    assert (total["calls_per_s"], total["line_time_share"], total["latency_ms"]) == (None, None, None)


def test_of_many_kinds_those_that_took_most_time_are_told() -> None:
    calls = [made(n, 1.0 + n, CallKind(EXECUTE, f"c{n}")) for n in range(MAX_ROWS + 3)]
    lines = list(statistics_lines(summed(calls)))
    assert lines[-1] == "… and 3 more"
    assert f"c{MAX_ROWS + 2}" in "".join(lines)
    assert not [line for line in lines if line.startswith("Robot_Execute c2 ")]


def test_of_many_clients_those_that_called_most_are_told() -> None:
    calls = [made(n, 1.0, MOVE, client(n)) for n in range(1, MAX_ROWS + 4)]
    busiest = client(9999)
    calls += [made(0, 1.0, MOVE, busiest) for _ in range(2)]
    text = "\n".join(statistics_lines(summed(calls)))
    assert text.index("all clients") < text.index(":9999 ")
    assert text.count("\nby ") == MAX_ROWS
    assert "… and 5 more" in text  # with the line of all


def test_others_are_named() -> None:
    calls = [made(n, 1.0, CallKind(EXECUTE, f"c{n}")) for n in range(MAX_KINDS + 1)]
    calls += [made(n, 1.0, CallKind(0, None)) for n in range(3)]
    record: dict[str, Any] = json.loads(statistics_record(summed(calls)))
    assert {"others"} < {row["function"] for row in record["commands"]}
    assert call_kind_text(OTHER_KINDS) == "(others)"
    assert call_kind_text(CallKind(0, None)) == "Unknown(0)"


def test_clients_beyond_all_bounds_are_named() -> None:
    lines = statistics_lines(summed([made(0, 1.0, MOVE, OTHER_CLIENTS)]))
    assert [line for line in lines if line.startswith("(other clients) ")]


@pytest.mark.parametrize(
    ("call_kind", "expected"),
    [
        (MOVE, "Robot_Execute slvMove"),
        (STOP, "Service_Stop"),
        (CallKind(EXECUTE, ""), "Robot_Execute "),
        (CallKind(EXECUTE, "x" * 50), f"Robot_Execute {'x' * 39}…"),
        (CallKind(200, None), "Unknown(200)"),
    ],
)
def test_how_a_kind_of_call_is_named(call_kind: CallKind, expected: str) -> None:
    assert call_kind_text(call_kind) == expected
