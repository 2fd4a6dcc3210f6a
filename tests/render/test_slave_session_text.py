"""Stays as text and as JSON: whatever was sent, lines that fit and no harm to the terminal."""

from __future__ import annotations

import json
import math

import orjson
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from bcapscope.messages import Language, MessageFormatter
from bcapscope.protocol.codec.variant import VT, Variant
from bcapscope.render.color_palette import ANSI
from bcapscope.render.json_values import json_ready
from bcapscope.render.slave_session_record import slave_session_record
from bcapscope.render.slave_session_text import slave_session_lines
from tests.analysis.driving import (
    ENTER,
    NOT_ALLOWED,
    NOT_IN_SLAVE_MODE,
    OFF,
    OVERFLOW,
    UNDERFLOW,
    Plan,
    Step,
    joints,
    play,
    steps,
)

PACE = [8.0 * n for n in range(1, 31)]


def text_of(plan: Plan) -> str:
    (session,) = plan.stays()
    return "\n".join(slave_session_lines(session))


@settings(deadline=None, max_examples=100)
@given(steps, st.integers(0, 2))
def test_any_stay_can_be_written(played: list[Step], release: int) -> None:
    for session in play(played, release):
        lines = list(slave_session_lines(session))
        assert all(line.isprintable() and len(line) <= 140 for line in lines)
        record = orjson.loads(slave_session_record(session))
        assert record["set_points"]["sent"] == session.counts.sent
        assert "NaN" not in json.dumps(record).replace('"NaN"', "")


def test_lines_fit_on_a_screen() -> None:
    plan = Plan()
    driver = plan.driver()
    driver.change(0, ENTER)
    for ms in PACE:
        driver.move(ms, retries=(2.0,) * (round(ms) % 3))
    driver.move(500, code=NOT_IN_SLAVE_MODE)
    assert all(len(line) <= 100 for line in text_of(plan).splitlines())


def test_retries_that_should_not_be() -> None:
    plan = Plan()
    driver = plan.driver()
    driver.change(0, 0x102)
    for ms in PACE:
        driver.move(ms, retries=(2.0,))
    text = text_of(plan)
    assert "retries     30 (retries × set points: 1 × 30)" in text
    assert "30 superfluous: new set points replace waiting ones" in text
    assert "frames 4, 7, 10, 13, 16, 19, 22, 25 and 22 more" in text.replace("\n              ", " ")


def test_what_was_not_seen_is_said() -> None:
    plan = Plan()
    plan.driver().move(8, Variant.array(VT.R8, (1.0, 2.0)))
    text = text_of(plan)
    assert "before the capture" in text
    assert "mode        unknown: the capture has no slvChangeMode" in text
    assert "the mode is unknown: 3 slots, and replies that do not wait" in text
    assert "1 unreadable, or of another type" in text
    assert "the capture ended first" in text


def test_a_guessed_generation_is_marked() -> None:
    plan = Plan()
    driver = plan.driver()
    driver.execute(0, "slvChangeMode", Variant(VT.I4, 0x001), result=Variant(VT.I4, 0))
    driver.execute(8, "slvMove", Variant(VT.BSTR, "P(1,2,3,4,5,6,5)"))
    assert "of unknown generation, assumed to be an RC8" in text_of(plan)


def test_odd_motion_is_told() -> None:
    plan = Plan()
    driver = plan.driver()
    driver.change(0, 0x002)
    for n, j1 in enumerate((0.0, 0.1, 0.2, 0.2, 0.3, 9.3, 9.4, math.nan, 9.5)):
        driver.move(8.0 * (n + 1), joints(j1))
    driver.move(80, code=OVERFLOW)
    text = " ".join(text_of(plan).split())
    assert "1 set point equal to the one before, 1 of them between two that move; frame 9" in text
    assert (
        "1 step far larger than those around, or than any axis can follow, the first 9 on J1; frame 13"
        in text
    )
    assert "1 with NaN or infinity; frame 17" in text
    assert "overflow reported by the controller frame 22" in text


def test_who_ended_it() -> None:
    plan = Plan()
    driver, other = plan.driver(), plan.driver(50002)
    driver.change(0, ENTER)
    driver.moves(PACE)
    other.execute(243, "\x1b[31m", code=NOT_ALLOWED)
    driver.move(248, code=NOT_IN_SLAVE_MODE)
    text = text_of(plan)
    assert "frames 63, 64, 65, 66  error of another call\n              \\x1b[31m by 10.0.0.2:50002" in text


def test_a_session_in_japanese() -> None:
    plan = Plan()
    driver = plan.driver()
    driver.change(0, ENTER)
    driver.moves(PACE)
    driver.change(300, OFF)
    (session,) = plan.stays()
    text = "\n".join(slave_session_lines(session, words=MessageFormatter(Language.JAPANESE)))
    assert text.startswith("スレーブモード区間 1  10.0.0.2:50001 > ")
    assert "  モード      0x202\n              J 型、モード 2: " in text
    assert "  指令値      送信 30、受理 30\n" in text
    assert "  終了        " in text
    assert "正常に終了" in text


def test_slices_are_a_table() -> None:
    plan = Plan()
    driver = plan.driver()
    driver.change(0, ENTER)
    driver.moves(8.0 * n for n in range(1, 301))
    (session,) = plan.stays(window=1_000_000_000)
    table = list(slave_session_lines(session))[-4:]
    assert [line.split()[:2] for line in table[1:]] == [["+0", "125"], ["+1", "125"], ["+2", "50"]]


def test_colours_change_no_character() -> None:
    plan = Plan()
    driver = plan.driver()
    driver.change(0, ENTER)
    driver.moves(PACE)
    driver.change(300, OFF)
    (session,) = plan.stays()
    coloured = "\n".join(slave_session_lines(session, ANSI))
    for sequence in (ANSI.number, ANSI.name, ANSI.problem, ANSI.good, ANSI.bad, ANSI.dim, ANSI.reset):
        coloured = coloured.replace(sequence, "")
    assert coloured == "\n".join(slave_session_lines(session))


@pytest.mark.parametrize(
    ("value", "written"),
    [(1.5, 1.5), (None, None), (math.nan, "NaN"), (math.inf, "Infinity"), (-math.inf, "-Infinity")],
)
def test_numbers_of_all_kinds(value: float | None, written: object) -> None:
    assert json_ready(value) == written


def test_json_keeps_what_the_stay_knows() -> None:
    plan = Plan()
    driver = plan.driver()
    driver.change(0, ENTER)
    driver.moves(PACE)
    driver.change(300, OFF)
    (session,) = plan.stays()
    record = orjson.loads(slave_session_record(session))
    assert record["entry"]["command"] == "slvChangeMode"
    assert record["entered"] == pytest.approx(session.entered_at / 1e9)
    assert record["timing"]["cycle_ms"]["p99.9"] == pytest.approx(8.0)
    assert [axis["axis"] for axis in record["motion"]["axes"]] == [f"J{n}" for n in range(1, 9)]
    assert _leaves(record) > 200


def _leaves(value: object) -> int:
    if isinstance(value, dict):
        return sum(map(_leaves, value.values()))
    return sum(map(_leaves, value)) if isinstance(value, list) else 1


def test_what_was_not_answered_after_the_end_was_not_refused() -> None:
    plan = Plan()
    driver = plan.driver()
    driver.change(0, ENTER)
    driver.move(8)
    driver.move(16, code=UNDERFLOW)
    driver.move(24, takes=None)
    assert "1 refused, 1 more refused or unanswered after the end" in " ".join(text_of(plan).split())
