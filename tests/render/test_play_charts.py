"""A run in slave mode while it lasts."""

from __future__ import annotations

import math

import pytest

from bcapscope.messages import Language, MessageFormatter
from bcapscope.player.lateness import Spread
from bcapscope.player.player_messages import PlayCounts, PlayProgress, PlayState
from bcapscope.protocol.slave_mode.modes import PoseType
from bcapscope.render.play_text import (
    axis_charts,
    cycle_histogram_lines,
    progress_bar,
    run_figure_lines,
)

PROGRESS = PlayProgress(
    PlayState.PLAYING,
    50,
    100,
    0.4,
    0.4,
    Spread(50, 1000, 2000, 3000, 4000),
    PlayCounts(50, retries=3, late=1),
    cycle=((7_864_320, 8_388_607, 48), (12_058_624, 12_582_911, 1)),
)


def test_figures() -> None:
    lines = list(run_figure_lines(PROGRESS, (1, 8.0, 3.4)))
    assert lines == [
        "playing  set point 50 of 100, elapsed 0.4 s, left 0.4 s",
        "late, ms: p50 0.001 p99 0.002 p99.9 0.003 max 0.004",
        "retries 3  late replies 1  unanswered 0  postponed 0",
        "buffer (model): 1 × 8 ms, left at the longest pause 3.4 / 8 ms",
    ]
    assert len(list(run_figure_lines(PlayProgress(PlayState.CONNECTING), None))) == 2


def test_figures_in_japanese() -> None:
    lines = list(run_figure_lines(PROGRESS, (1, 8.0, 3.4), words=MessageFormatter(Language.JAPANESE)))
    assert lines == [
        "再生中  指令値 50 / 100、経過 0.4 s、残り 0.4 s",
        "遅れ ms: p50 0.001 p99 0.002 p99.9 0.003 最大 0.004",
        "再送 3  遅れた応答 1  応答なし 0  繰り延べ 0",
        "バッファ (モデル): 1 × 8 ms、最長の間隔での残り 3.4 / 8 ms",
    ]


@pytest.mark.parametrize("state", PlayState)
def test_each_state_has_words(state: PlayState) -> None:
    for language in Language:
        assert not MessageFormatter(language).text(state.message).startswith("player.state.")


def test_cycle_times_have_a_row_each_bin() -> None:
    rows = list(cycle_histogram_lines(PROGRESS))
    assert rows[0].startswith("   7.864 – 8.389 ")
    assert rows[0].endswith("48   97.96%")
    assert rows[-1].startswith("   12.06 – 12.58 ")


def test_bar() -> None:
    assert progress_bar(PROGRESS, 10) == "━━━━━─────"
    assert progress_bar(PlayProgress(PlayState.PLAYING), 10) == ""


def test_axes_have_a_chart_each() -> None:
    course = [(0.0, (1.0, 2.0), (0.5, 2.0)), (1.0, (3.0, 2.0), (2.5, 2.0))]
    lines = list(axis_charts(PoseType.J, course, [0, 1], width=40, height=12))
    assert lines[0] == "J1  commanded 3.000  actual 2.500  behind 0.500"
    assert lines[6].startswith("J2  commanded 2.000")
    assert lines[1].startswith("       3°│")
    assert len(list(axis_charts(PoseType.J, [], [5], width=40, height=12))) == 12


def test_a_position_that_no_axis_has_takes_no_more_columns() -> None:
    course = [(0.0, (1e300,), (-1e300,)), (1.0, (1e300,), (math.nan,))]
    title, *_ = axis_charts(PoseType.J, course, [0], width=40, height=6)
    assert title == "J1  commanded 1e+300  actual nan  behind nan"
