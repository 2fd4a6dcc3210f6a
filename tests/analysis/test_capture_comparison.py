"""What two captures differ by, and what of it is notable."""

from __future__ import annotations

from pathlib import Path

import pytest

from bcapscope.analysis.capture_comparison import (
    FEWEST_SAMPLES,
    CaptureComparison,
    ComparedCapture,
    UnmatchedKind,
    compare,
)
from bcapscope.analysis.diagnosis import Diagnosis
from bcapscope.analysis.finding import Finding, Severity
from bcapscope.analysis.slave.slave_session import SlaveSession
from bcapscope.analysis.statistics.call_statistics import StatisticsBuilder
from bcapscope.capture.capture_file import open_capture
from bcapscope.capture.packet_decoder import PacketDecoder
from bcapscope.traffic.call import Call, CallState
from tests.analysis.exchanges import MOVE, READ, STOP, made
from tests.samples.findings import make_finding
from tests.traffic.playbook import run_pipeline

SAMPLES = Path(__file__).parents[2] / "captures"


def side(calls: list[Call], *findings: Finding) -> ComparedCapture:
    summary = StatisticsBuilder()
    for call in calls:
        summary.add_call(call)
    return ComparedCapture("", summary.statistics(), (), findings)


def read(name: str) -> ComparedCapture:
    """Take account of a sample."""
    stays: list[SlaveSession] = []
    diagnosis, summary = Diagnosis(on_slave_session=stays.append), StatisticsBuilder()
    with open_capture(str(SAMPLES / name)) as capture:
        run_pipeline(PacketDecoder().decode(capture), diagnosis, summary)
    stays += diagnosis.remaining_sessions()
    return ComparedCapture(name, summary.statistics(), tuple(stays), diagnosis.findings())


def run(count: int, latency: float = 1.0, pace: float = 8.0, retries: int = 0) -> list[Call]:
    return [made(pace * n, latency, retries=retries) for n in range(count)]


def notable(comparison: CaptureComparison) -> dict[str, tuple[object, object]]:
    return {each.figure: (each.good, each.bad) for each in comparison.differences if each.notable}


def test_a_capture_does_not_differ_from_itself() -> None:
    sample = read("slave-mode-lost.pcapng")
    assert compare(sample, sample) == CaptureComparison((), (), (), (1, 1), ())
    assert not compare(sample, sample).is_notable


def test_a_slower_reply_is_notable() -> None:
    comparison = compare(side(run(100)), side(run(100, 2.0)))
    assert notable(comparison) == {"latency_ms.p50": (1.0, 2.0), "latency_ms.p99": (1.0, 2.0)}
    assert {each.ratio for each in comparison.differences if each.notable} == {2.0}
    assert comparison.is_notable


@pytest.mark.parametrize(
    ("good", "bad"),
    [
        (run(100, 1.0), run(100, 1.4)),  # less than half as much again
        (run(100, 0.1), run(100, 0.25)),  # too short to hurt
        (run(FEWEST_SAMPLES - 1, 1.0), run(100, 5.0)),  # too few to tell
        (run(100, 1.0), run(50, 1.0)),  # the capture is shorter
    ],
)
def test_what_two_good_runs_differ_by_is_not_notable(good: list[Call], bad: list[Call]) -> None:
    for comparison in (compare(side(good), side(bad)), compare(side(bad), side(good))):
        assert notable(comparison) == {}
        assert not comparison.is_notable


def test_a_rate_that_halves_is_notable() -> None:
    assert "calls_per_s" in notable(compare(side(run(100)), side(run(100, pace=16))))


def test_a_single_refusal_is_notable() -> None:
    comparison = compare(side([made(0, 1.0)]), side([made(0, 1.0, code=0x83500121)]))
    assert notable(comparison) == {"refused_share": (0.0, 1.0)}
    comparison = compare(side([made(0, 1.0)]), side([made(0, None)]))
    assert notable(comparison) == {"unanswered_share": (0.0, 1.0)}


def test_what_was_not_followed_is_told_and_not_notable() -> None:
    call = made(0, None, given_up=False)
    call.state = CallState.EVICTED
    comparison = compare(side([made(0, 1.0)]), side([call]))
    assert ("not_followed_share", 1.0) in [(each.figure, each.bad) for each in comparison.differences]
    assert notable(comparison) == {}


def test_losses_are_notable_beyond_chance() -> None:
    def lossy(lost: int) -> ComparedCapture:
        return side(run(1000 - lost) + run(lost, 3.0, retries=1))

    assert "retried_share" not in notable(compare(lossy(10), lossy(15)))
    assert "retried_share" not in notable(compare(lossy(0), lossy(2)))
    assert notable(compare(lossy(10), lossy(30)))["retried_share"] == (0.01, 0.03)
    assert notable(compare(lossy(30), lossy(10)))["retried_share"] == (0.03, 0.01)
    comparison = compare(side(run(1)), side(run(1, 3.0, retries=1)))
    assert notable(comparison) == {}
    assert {each.figure for each in comparison.differences} >= {"retried_share", "latency_ms.p50"}


def test_more_late_replies_than_calls() -> None:
    late = side([made(8 * n, 3.0, retries=3, late=2) for n in range(20)])
    assert notable(compare(side(run(20, 3.0)), late))["late_replies_per_call"] == (0.0, 2.0)


def test_kinds_of_call_that_only_one_has() -> None:
    good = [*run(20), made(0, 1.0, STOP)]
    bad = [*run(20), made(0, 1.0, READ), made(1, 1.0, READ)]
    comparison = compare(side(good), side(bad))
    assert comparison.only_good == (UnmatchedKind(STOP, 1),)
    assert comparison.only_bad == (UnmatchedKind(READ, 2),)
    assert not comparison.is_notable


def test_all_calls_are_compared_where_there_are_several_kinds() -> None:
    good, bad = run(20), run(20, 3.0)
    assert {each.subject for each in compare(side(good), side(bad)).differences} == {MOVE}
    comparison = compare(side([*good, made(0, 1.0, READ)]), side([*bad, made(0, 1.0, READ)]))
    assert {each.subject for each in comparison.differences} == {None, MOVE}
    assert {each.figure for each in comparison.differences if each.subject is None} == {
        "calls_per_s",
        "line_time_share",
    }


def test_notable_differences_stand_first() -> None:
    comparison = compare(side(run(100)), side(run(120, 2.0, pace=20)))
    order = [each.notable for each in comparison.differences]
    assert order == sorted(order, reverse=True)
    assert True in order
    assert False in order


def test_a_capture_without_calls() -> None:
    comparison = compare(side([]), side(run(3)))
    assert comparison == CaptureComparison((), (), (UnmatchedKind(MOVE, 3),), (0, 0), ())


def test_a_value_that_one_lacks_has_no_ratio() -> None:
    comparison = compare(side(run(20)), side([made(8 * n, None) for n in range(20)]))
    by_figure = {each.figure: each for each in comparison.differences}
    assert (by_figure["latency_ms.p50"].bad, by_figure["latency_ms.p50"].ratio) == (None, None)
    assert by_figure["unanswered_share"].ratio is None


# findings


def finding(rule: str, severity: Severity = Severity.ERROR) -> Finding:
    return make_finding(rule, severity, f"{rule} was found.", (1,), None, "", "")


def test_findings_are_compared_by_rule() -> None:
    late, lost, note = finding("late"), finding("lost"), finding("note", Severity.NOTE)
    comparison = compare(side([], late, late, note), side([], lost, late, note))
    told = [(each.rule, len(each.good), len(each.bad)) for each in comparison.rules]
    assert told == [("lost", 0, 1), ("late", 2, 1)]
    assert comparison.is_notable


def test_a_note_is_not_notable() -> None:
    comparison = compare(side([]), side([], finding("note", Severity.NOTE)))
    assert [each.severity for each in comparison.rules] == [Severity.NOTE]
    assert not comparison.is_notable


# slave mode


def test_stays_are_compared_in_their_order() -> None:
    comparison = compare(read("slave-session.pcapng"), read("slave-mode-lost.pcapng"))
    found = {
        each.figure: (each.good, each.bad, each.notable)
        for each in comparison.differences
        if each.subject == 1
    }
    assert found["exit"] == ("left", "error (0x84201482)", True)
    assert found["gaps"] == (0.0, 1.0, True)
    assert found["reported_underflows"] == (0.0, 1.0, True)
    assert found["cycle_ms.max"][1:] == (64.0, True)
    assert found["cycle_ms.p50"][2] is False
    assert found["set_points"][2] is False
    assert "mode" not in found
    assert comparison.rules[0].rule == "set-point-gap"


def test_a_stay_that_only_one_has_is_notable() -> None:
    sample = read("slave-session.pcapng")
    without = ComparedCapture("", sample.statistics, (), sample.findings)
    comparison = compare(sample, without)
    assert comparison.session_counts == (1, 0)
    assert comparison.differences == ()
    assert comparison.is_notable


def test_what_was_not_seen_of_a_stay_is_no_difference() -> None:
    # the one capture knows neither how it began nor how it ended
    comparison = compare(read("slave-session.pcapng"), read("retry-story.pcapng"))
    found = {each.figure: each for each in comparison.differences if each.subject == 1}
    assert (found["mode"].bad, found["mode"].notable) == (None, False)
    assert (found["exit"].bad, found["exit"].notable) == ("capture ended", False)
