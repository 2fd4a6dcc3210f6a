"""Differences for people and programs."""

from __future__ import annotations

import json
import unicodedata
from collections.abc import Callable

from bcapscope.analysis.capture_comparison import ComparedCapture, compare
from bcapscope.analysis.finding import Finding, Severity
from bcapscope.analysis.statistics.call_statistics import OTHER_KINDS, StatisticsBuilder
from bcapscope.render.color_palette import ANSI, PLAIN, Palette
from bcapscope.render.comparison_text import MAX_ROWS, comparison_lines, comparison_record
from bcapscope.traffic.call import Call
from bcapscope.traffic.call_kind import CallKind
from tests.analysis.exchanges import EXECUTE, READ, STOP, made
from tests.analysis.test_capture_comparison import read
from tests.render.scenes import HOSTILE
from tests.samples.findings import make_finding

HOSTILE_QUESTION = CallKind(EXECUTE, HOSTILE)


def side(name: str, calls: list[Call], *findings: Finding) -> ComparedCapture:
    summary = StatisticsBuilder()
    for call in calls:
        summary.add_call(call)
    return ComparedCapture(name, summary.statistics(), (), findings)


def found(rule: str, severity: Severity = Severity.ERROR) -> Finding:
    return make_finding(rule, severity, f"{HOSTILE} made {rule} happen.", (1, 2), None, "Stop it.", "nobody")


def good() -> ComparedCapture:
    calls = [made(8 * n, 1.0) for n in range(50)]
    return side("good.pcap", [*calls, made(0, 1.0, STOP)], found("late"), found("late"))


def bad() -> ComparedCapture:
    calls = [made(8 * n, 2.5, retries=2, late=1) for n in range(45)]
    calls += [made(8 * n, None) for n in range(5)]
    calls += [made(1, 1.0, HOSTILE_QUESTION), made(2, 1.0, HOSTILE_QUESTION), made(3, 0.5, READ, code=0x600B)]
    return side(f"bad{HOSTILE}.pcap", calls, found("lost"), found("late"), found("odd", Severity.NOTE))


def lines(first: ComparedCapture, second: ComparedCapture, palette: Palette = PLAIN) -> list[str]:
    return list(comparison_lines(compare(first, second), first, second, palette))


def test_differences_of_calls(golden: Callable[[str, bytes], None]) -> None:
    golden("comparison.txt", "".join(f"{line}\n" for line in lines(good(), bad())).encode())


def test_differences_in_colour(golden: Callable[[str, bytes], None]) -> None:
    golden("comparison.ansi", "".join(f"{line}\n" for line in lines(good(), bad(), ANSI)).encode())


def test_differences_as_json(golden: Callable[[str, bytes], None]) -> None:
    record = comparison_record(compare(good(), bad()), good(), bad())
    json.loads(record)
    golden("comparison.json", record + b"\n")


def test_differences_of_stays() -> None:
    first, second = read("slave-session.pcapng"), read("slave-mode-lost.pcapng")
    text = "\n".join(lines(first, second))
    assert "slave-mode session 1   ended by                               left  →  error (0x84201482)" in text
    record = json.loads(comparison_record(compare(first, second), first, second))
    assert (record["good"]["stays"], record["bad"]["stays"]) == (1, 1)
    sessions = {each["figure"]: each for each in record["differences"] if each["stay"] == 1}
    assert sessions["reported_underflows"] == {
        "function": None,
        "command": None,
        "stay": 1,
        "figure": "reported_underflows",
        "good": 0.0,
        "bad": 1.0,
        "ratio": None,
        "notable": True,
    }


def test_another_number_of_stays_is_told() -> None:
    sample = read("slave-session.pcapng")
    text = lines(sample, ComparedCapture("none", sample.statistics, (), sample.findings))
    assert text[2:] == ["", "notable", "  slave-mode sessions: 1 → 0"]


def test_nothing_from_the_wire_is_raw() -> None:
    record = comparison_record(compare(good(), bad()), good(), bad()).decode()
    for text in (*lines(good(), bad()), record):
        assert not [char for char in text if unicodedata.category(char)[0] == "C"]


def test_nothing_differs() -> None:
    assert lines(good(), good())[2:] == ["", "nothing notable differs"]


def test_captures_without_calls() -> None:
    empty = side("empty.pcap", [])
    assert lines(empty, empty) == [
        "good  empty.pcap  no calls",
        "bad   empty.pcap  no calls",
        "",
        "nothing notable differs",
    ]
    record = json.loads(comparison_record(compare(empty, empty), empty, empty))
    assert record["good"] == {"name": "empty.pcap", "calls": 0, "seconds": 0.0, "stays": 0, "findings": 0}


def test_long_tables_are_cut() -> None:
    many = [made(n, 1.0, CallKind(EXECUTE, f"c{n}")) for n in range(MAX_ROWS + 7)]
    text = lines(side("a", [made(0, 1.0)]), side("b", many))
    assert "  … and 7 more" in text


def test_what_prints_the_same_is_not_told() -> None:
    text = lines(side("a", [made(0, 1.0)]), side("b", [made(0, 1.0001)]))
    assert text[2:4] == ["", "nothing notable differs"]
    assert not [line for line in text if "latency" in line]


def test_others_are_named() -> None:
    first, second = side("a", []), side("b", [made(0, 1.0, OTHER_KINDS)])
    record = json.loads(comparison_record(compare(first, second), first, second))
    assert record["only_bad"] == [{"function": "others", "command": None, "calls": 1}]


def test_what_one_lacks_is_told() -> None:
    text = lines(side("a", [made(0, 1.0)]), side("b", [made(0, None)]))
    assert "  Robot_Execute slvMove  latency p50  1.000 ms  →  none" in text
