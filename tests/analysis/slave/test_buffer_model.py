"""The model of the controller's buffer against a controller that ticks."""

from __future__ import annotations

from collections.abc import Sequence
from unittest.mock import patch

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from bcapscope.analysis.slave.buffer_model import (
    DEFAULT_SLOTS,
    BufferBehaviour,
    BufferFacts,
    BufferModel,
)
from bcapscope.analysis.slave.notable_set_points import MAX_LISTED
from bcapscope.analysis.slave.set_point_table import SetPointTable
from bcapscope.protocol.slave_mode.modes import Generation, slave_mode_by_number
from bcapscope.protocol.tables.hresult import E_SLAVE_OVERFLOW, E_SLAVE_UNDERFLOW, S_BUF_FULL
from tests.analysis.slave.set_points import set_points

MS = 1_000_000
PERIOD = 8 * MS
ORIGIN = 1_700_000_000_000_000_000


def rules(value: int, generation: Generation = Generation.RC8) -> BufferBehaviour:
    return BufferBehaviour.of_mode(slave_mode_by_number(value, generation), guessed=False)


def arrivals(
    times: Sequence[float],
    replies: Sequence[float] = (),
    codes: dict[int, int] | None = None,
) -> SetPointTable:
    """Make set points of milliseconds; frames are 1, 3, 5, their replies one more."""
    sent = np.array([round(time * MS) for time in times], np.int64)
    entered = np.array([round(time * MS) for time in replies], np.int64) if replies else sent
    results = np.zeros(len(times), np.int64)
    for index, code in (codes or {}).items():
        results[index] = code
    return set_points(sent, entered, results)


def after(rows: SetPointTable, how: BufferBehaviour, moving: int = 1) -> BufferFacts:
    model = BufferModel(how, ORIGIN)
    model.add(rows, np.full(len(rows.times), moving))
    return model.facts()


def ticking(times: Sequence[int]) -> list[tuple[int, int]]:
    """Play a controller of endless room that takes a point each period from the first on.

    Returns:
        For each set point how many there were in the buffer when it came, and how many ticks before it had
        found nothing.
    """
    level, missed, tick = 0, 0, times[0]
    found = []
    for now in times:
        while tick < now:
            missed += level == 0
            level = max(level - 1, 0)
            tick += PERIOD
        found.append((level, missed))
        level, missed = level + 1, 0
    return found


@given(st.lists(st.integers(0, 40 * MS), max_size=60))
def test_without_a_limit_the_model_is_a_controller_that_ticks(gaps: list[int]) -> None:
    times = np.cumsum([0, *gaps])
    endless = BufferBehaviour(10_000, overwrites=False, replies_pace=False, assumptions=())
    model = BufferModel(endless, ORIGIN)
    model.add(set_points(times), np.zeros(len(times), np.int64))
    facts = model.facts()
    played = ticking(times.tolist())
    assert facts.possible_underflows == sum(missed == 1 for _, missed in played)
    assert facts.underflows == sum(missed > 1 for _, missed in played)
    assert [each.missed_ticks for each in facts.underflow_list] == [n for _, n in played if n > 1][
        :MAX_LISTED
    ]


@st.composite
def traffic(draw: st.DrawFn) -> tuple[list[int], list[int]]:
    """Return the times of set points and of their replies."""
    count = draw(st.integers(1, 50))
    pace = draw(st.sampled_from([0, MS, 7 * MS, PERIOD, PERIOD + MS]))
    jitter = draw(st.lists(st.integers(0, 3 * MS), min_size=count, max_size=count))
    times = np.cumsum(np.array(jitter, np.int64) + pace)
    waits = draw(st.lists(st.integers(0, PERIOD), min_size=count, max_size=count))
    return times.tolist(), (times + np.array(waits, np.int64)).tolist()


MODES = st.sampled_from([rules(0x002), rules(0x102), rules(0x202), rules(0x002, Generation.RC7)])


@given(traffic(), MODES, st.integers(0, 50))
def test_many_at_once_and_one_by_one_agree(
    times: tuple[list[int], list[int]], how: BufferBehaviour, cut: int
) -> None:
    models = BufferModel(how, ORIGIN), BufferModel(how, ORIGIN)
    slacks: list[list[int]] = [[], []]
    for part in (slice(cut), slice(cut, None)):
        sent, replied = (np.array(each[part], np.int64) for each in times)
        if len(sent):
            piece, still = set_points(sent, replied), np.zeros(len(sent), np.int64)
            slacks[0] += models[0].add(piece, still).tolist()
            with patch.object(BufferModel, "_add_at_once", return_value=None):
                slacks[1] += models[1].add(piece, still).tolist()
    assert slacks[0] == slacks[1]
    assert models[0].facts() == models[1].facts()


def test_an_even_pace_never_runs_empty() -> None:
    facts = after(arrivals([8.0 * n for n in range(1000)]), rules(0x202))
    assert (facts.underflows, facts.possible_underflows, facts.smallest_slack_ms) == (0, 0, 0.0)
    assert facts.assumptions


@pytest.mark.parametrize("value", [0x002, 0x202])
def test_a_full_buffer_bridges_24_ms(value: int) -> None:
    begin = [0.0, 0.1, 0.2, 0.3]
    for gap, expected in ((23.0, (0, 0)), (25.0, (0, 1)), (33.0, (1, 0))):
        facts = after(arrivals([*begin, 0.3 + gap]), rules(value))
        assert (facts.underflows, facts.possible_underflows) == expected, gap


def test_a_pause_is_told_with_the_frames_on_both_sides() -> None:
    facts = after(arrivals([0, 8, 16, 80]), rules(0x202))
    (starved,) = facts.underflow_list
    assert starved == (ORIGIN + 24 * MS, 5, 7, 7, 56.0, True)
    assert (facts.underflows_in_motion, facts.smallest_slack_ms, facts.smallest_slack_frame) == (1, -56.0, 7)
    assert facts.smallest_level == 0


@pytest.mark.parametrize(("moving", "told", "counted"), [(1, True, 1), (0, False, 0), (-1, None, 1)])
def test_running_empty_matters_in_motion(moving: int, told: bool | None, counted: int) -> None:
    facts = after(arrivals([0, 8, 80]), rules(0x202), moving)
    assert (facts.underflows, facts.underflows_in_motion, facts.underflow_list[0].moving) == (
        1,
        counted,
        told,
    )


def test_too_many_at_once_are_too_many() -> None:
    facts = after(arrivals([0.01 * n for n in range(12)]), rules(0x002))
    assert facts.overflows == 12 - 5
    assert facts.overflow_frames[0] == 2 * 5 + 1


def test_a_fast_clock_overflows_once_a_period() -> None:
    times = [7.99 * n for n in range(10_000)]  # a point too many each 6.4 s
    facts = after(arrivals(times), rules(0x002))
    assert facts.overflows == pytest.approx(0.01 * 10_000 / 8, abs=4)


def test_where_replies_wait_for_room_nothing_is_too_many() -> None:
    replies = [0.1, 0.2, 0.3, *(8.0 * n for n in range(1, 200))]
    times = [0.0, *(reply + 0.05 for reply in replies[:-1])]
    facts = after(arrivals(times, replies), rules(0x202))
    assert (facts.overflows, facts.underflows, facts.possible_underflows) == (0, 0, 0)
    assert facts.levels == {1: 1, 2: 1, 3: len(times) - 3}


def test_the_newest_point_wins() -> None:
    facts = after(arrivals([1.0 * n for n in range(801)]), rules(0x102))
    assert facts.overwritten == pytest.approx(801 * 7 / 8, abs=2)
    assert (facts.overflows, facts.underflows) == (0, 0)


def test_what_the_controller_says_counts_more() -> None:
    codes = {2: S_BUF_FULL, 3: E_SLAVE_OVERFLOW, 5: E_SLAVE_UNDERFLOW}
    facts = after(arrivals([0, 1, 2, 3, 8, 90], codes=codes), rules(0x002))
    assert (facts.reported_full, facts.reported_overflows, facts.reported_underflows) == ((6,), (8,), (12,))
    full = after(arrivals([0, 8, 16, 39], codes={2: S_BUF_FULL}), rules(0x002))
    assert (full.underflows, full.possible_underflows) == (0, 0)
    assert after(arrivals([0, 8, 16, 39]), rules(0x002)).underflows == 1


def test_a_refused_point_is_not_in_the_buffer() -> None:
    kept = after(arrivals([0, 1, 2, 23]), rules(0x002))
    refused = after(arrivals([0, 1, 2, 23], codes={2: E_SLAVE_OVERFLOW}), rules(0x002))
    assert (kept.possible_underflows, refused.possible_underflows) == (0, 1)


def test_sync_of_rc7_has_one_slot() -> None:
    facts = after(arrivals([0, 8, 16, 35], [2, 10, 18, 36]), rules(0x001, Generation.RC7))
    assert (facts.slots, facts.replies_pace, facts.underflows) == (1, True, 1)


def test_an_unknown_mode_says_what_it_takes_for_granted() -> None:
    unknown = BufferBehaviour.of_mode(None, guessed=False)
    assert unknown.slots == DEFAULT_SLOTS
    assert "the mode is unknown" in str(unknown.assumptions[0])
    guessed = BufferBehaviour.of_mode(slave_mode_by_number(0x001), guessed=True)
    assert "the generation of the controller is unknown" in str(guessed.assumptions[0])


def test_lists_are_bounded_and_counts_are_not() -> None:
    facts = after(arrivals([50.0 * n for n in range(1000)]), rules(0x202))
    assert (facts.underflows, len(facts.underflow_list)) == (999, MAX_LISTED)
