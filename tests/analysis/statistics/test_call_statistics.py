"""Figures of calls against calls of which every number is known."""

from __future__ import annotations

import tracemalloc
from collections import Counter
from itertools import pairwise

import pytest
from hypothesis import given
from hypothesis import strategies as st

from bcapscope.analysis.statistics.call_statistics import (
    GRACE_NS,
    MAX_CODES,
    MAX_KINDS,
    OTHER_CLIENTS,
    OTHER_KINDS,
    CallFigures,
    SlicedStatistics,
    Statistics,
    StatisticsBuilder,
    StatisticsRow,
)
from bcapscope.traffic.call import Call
from bcapscope.traffic.call_kind import CallKind
from bcapscope.traffic.observation import Conversation
from tests.analysis.exchanges import CLIENT, MOVE, MS, READ, START, STOP, client, made

SECOND = 1000
CLIENTS = (CLIENT, client(50002))


@st.composite
def calls(draw: st.DrawFn) -> Call:
    latency = draw(st.none() | st.floats(0.001, 50))
    return made(
        draw(st.integers(0, 10_000)),
        latency,
        draw(st.sampled_from((MOVE, READ, STOP))),
        draw(st.sampled_from(CLIENTS)),
        code=draw(st.sampled_from((0, 0, 0, 0x0F200501, 0x83500121, 0x600B))),
        retries=draw(st.sampled_from((0, 0, 0, 1, 3))),
        late=draw(st.sampled_from((0, 0, 2))),
        notices=draw(st.sampled_from((0, 0, 1))),
        given_up=draw(st.booleans()),
    )


def summed(settled: list[Call]) -> Statistics:
    summary = StatisticsBuilder()
    for call in settled:
        summary.add_call(call)
    statistics = summary.statistics()
    assert statistics is not None
    return statistics


def assert_figures(figures: CallFigures, settled: list[Call], nanoseconds: int) -> None:
    """Count everything the plain way, from the outside of the calls."""
    latencies = [call.reply.time - call.request.time for call in settled if call.reply is not None]
    outcomes = Counter(str(call.outcome) for call in settled)
    assert figures.calls == len(settled)
    assert (figures.answered, figures.refused) == (outcomes["answered"], outcomes["refused"])
    assert (figures.unanswered, figures.open) == (outcomes["unanswered"], outcomes["capture_ended"])
    assert figures.retries == sum(len(call.serials) - 1 for call in settled)
    assert figures.retried_calls == sum(len(call.serials) > 1 for call in settled)
    assert figures.late_replies == sum(len(call.late_replies) for call in settled)
    assert figures.executing == sum(len(call.notices) for call in settled)
    assert figures.request_bytes == sum(len(seen.item.raw) for call in settled for seen in call.attempts)
    codes = Counter(call.hresult for call in settled if call.outcome == "refused")
    assert dict(figures.refusal_codes) == codes
    assert list(figures.refusal_codes) == sorted(figures.refusal_codes, key=lambda code: (-code[1], code[0]))
    if nanoseconds:
        assert figures.calls_per_second == pytest.approx(len(settled) / (nanoseconds / 1e9))
        assert figures.line_time_share == pytest.approx(sum(latencies) / nanoseconds)
    else:
        assert (figures.calls_per_second, figures.line_time_share) == (None, None)
    if figures.latency is None:
        assert not latencies
    else:
        assert figures.latency.count == len(latencies)
        assert figures.latency.most == pytest.approx(max(latencies) / MS)
        assert figures.latency.p50 == pytest.approx(sorted(latencies)[(len(latencies) - 1) // 2] / MS)


@given(st.lists(calls(), min_size=1, max_size=30))
def test_figures_are_those_of_the_calls(settled: list[Call]) -> None:
    statistics = summed(settled)
    start = min(call.request.time for call in settled)
    end = max(call.last_activity for call in settled)
    assert (statistics.start, statistics.end) == (start, end)
    assert_figures(statistics.total.figures, settled, end - start)
    pairs = {(call.conversation, call.kind) for call in settled}
    assert {(row.conversation, row.call_kind) for row in statistics.commands} == pairs
    assert len(statistics.commands) == len(pairs)
    for row in (*statistics.clients, *statistics.commands, *statistics.kinds):
        assert_figures(row.figures, [call for call in settled if is_of(row, call)], end - start)


def is_of(row: StatisticsRow, call: Call) -> bool:
    return row.conversation in (None, call.conversation) and row.call_kind in (None, call.kind)


@given(st.lists(calls(), min_size=1, max_size=30))
def test_rows_are_in_order(settled: list[Call]) -> None:
    statistics = summed(settled)
    for one, two in pairwise(statistics.clients):
        assert one.figures.calls >= two.figures.calls
    for rows in (statistics.commands, statistics.kinds):
        for one, two in pairwise(rows):
            assert (one.figures.line_time_share or 0) >= (two.figures.line_time_share or 0)


def test_nothing_was_said() -> None:
    assert StatisticsBuilder().statistics() is None


def test_many_calls_are_counted_like_few() -> None:
    settled = [made(8 * n, 1 + n % 7 / 10, retries=n % 3 > 0) for n in range(3000)]
    statistics = summed(settled)
    assert_figures(statistics.total.figures, settled, statistics.end - statistics.start)


def test_a_time_that_is_given_is_what_rates_are_of() -> None:
    summary = StatisticsBuilder()
    for n in range(10):
        summary.add_call(made(n, 0.5))
    statistics = summary.statistics(START, START + 2 * SECOND * MS)
    assert statistics is not None
    assert (statistics.start, statistics.end) == (START, START + 2 * SECOND * MS)
    assert statistics.total.figures.calls_per_second == 5.0
    assert statistics.total.figures.line_time_share == pytest.approx(5 / 2000)


def test_a_reply_before_its_request_is_no_latency() -> None:
    figures = summed([made(0, -3.0), made(1, 2.0)]).total.figures
    assert figures.latency is not None
    assert (figures.latency.count, figures.latency.most) == (1, 2.0)


def test_beyond_a_number_of_kinds_they_are_counted_together() -> None:
    summary = StatisticsBuilder()
    for n in range(MAX_KINDS + 5):
        summary.add_call(made(n, 1.0, CallKind(64, f"c{n}")))
    summary.add_call(made(0, 1.0, CallKind(64, "c0")))
    summary.add_call(made(0, 1.0, CallKind(64, "another"), CLIENTS[1]))
    statistics = summary.statistics()
    assert statistics is not None
    assert len(statistics.commands) == MAX_KINDS + 2
    counts = {(row.conversation, row.call_kind): row.figures.calls for row in statistics.commands}
    assert counts[CLIENT, OTHER_KINDS] == 5
    assert counts[CLIENT, CallKind(64, "c0")] == 2
    assert counts[CLIENTS[1], OTHER_KINDS] == 1
    assert statistics.total.figures.calls == MAX_KINDS + 7


def test_beyond_a_number_of_clients_they_are_counted_together() -> None:
    summary = StatisticsBuilder()
    for n in range(2 * MAX_KINDS + 9):
        summary.add_call(made(n, 1.0, MOVE, client(n)))
    statistics = summary.statistics()
    assert statistics is not None
    assert len(statistics.clients) == 2 * MAX_KINDS + 1
    assert statistics.clients[0].conversation is OTHER_CLIENTS
    assert statistics.clients[0].figures.calls == 9


def test_only_so_many_result_codes_are_told_apart() -> None:
    settled = [made(n, 1.0, code=0x80000000 + n) for n in range(MAX_CODES + 4)]
    settled += [made(0, 1.0, code=0x80000000)]
    figures = summed(settled).total.figures
    assert len(figures.refusal_codes) == MAX_CODES
    assert figures.refusal_codes[0] == (0x80000000, 2)
    assert figures.refused == MAX_CODES + 5


def test_memory_does_not_grow_with_the_number_of_calls() -> None:
    call = made(0, 1.25)
    summary = StatisticsBuilder()
    for _ in range(20_000):
        summary.add_call(call)
    tracemalloc.start()
    before = tracemalloc.get_traced_memory()[0]
    for _ in range(50_000):
        summary.add_call(call)
    after = tracemalloc.get_traced_memory()[0]
    tracemalloc.stop()
    assert after - before < 100_000


# slices of time


def sliced(
    slices: SlicedStatistics, times: list[float], conversation: Conversation = CLIENT
) -> list[Statistics]:
    found = []
    for ms in times:
        found += slices.add_call(made(ms, 1.0, MOVE, conversation))
    return [*found, *slices.close()]


def counts(found: list[Statistics]) -> list[tuple[float, int]]:
    """Give second and number of calls of each slice."""
    return [((each.start - START) / 1e9, each.total.figures.calls) for each in found]


def test_a_call_is_in_the_slice_in_which_it_began() -> None:
    found = sliced(SlicedStatistics(SECOND * MS), [100, 500, 1099, 1100, 1200, 5000])
    assert counts(found) == [(0.1, 3), (1.1, 2), (4.1, 1)]
    assert {each.end - each.start for each in found} == {SECOND * MS}
    assert found[1].total.figures.calls_per_second == 2.0


def test_calls_may_settle_in_another_order() -> None:
    found = sliced(SlicedStatistics(SECOND * MS), [2500, 100, 2600, 1500])
    assert counts(found) == [(-0.5, 1), (1.5, 1), (2.5, 2)]


def test_slices_come_when_they_are_over() -> None:
    slices = SlicedStatistics(SECOND * MS)
    grace = GRACE_NS / MS
    assert slices.add_call(made(0, 1.0)) == []
    assert slices.add_call(made(grace + 999, 1.0)) == []
    assert counts(slices.add_call(made(grace + 1000, 1.0))) == [(0.0, 1)]
    assert slices.add_call(made(grace + 1001, 1.0)) == []
    assert counts(slices.close()) == [(200.0, 1), (201.0, 2)]


def test_where_time_goes_far_back_slices_begin_anew() -> None:
    day = 86_400 * SECOND
    found = sliced(SlicedStatistics(SECOND * MS), [day, day + 10, 0, 10, day])
    assert counts(found) == [(86400.0, 2), (0.0, 2), (86400.0, 1)]


@given(st.lists(st.integers(0, 10**9), max_size=40), st.sampled_from((100, 1000, 60_000)))
def test_no_call_is_lost_and_few_slices_are_open(times: list[int], window: int) -> None:
    slices = SlicedStatistics(window * MS)
    found = 0
    for ms in times:
        found += sum(each.total.figures.calls for each in slices.add_call(made(ms, 1.0)))
        assert len(slices._builders) <= 2 * (GRACE_NS // (window * MS) + 2)
    found += sum(each.total.figures.calls for each in slices.close())
    assert found == len(times)
