"""What the player tells, in words."""

from __future__ import annotations

import json

from bcapscope.messages import Language, Message, MessageFormatter
from bcapscope.player.lateness import Spread
from bcapscope.player.player_messages import (
    ControllerInfo,
    PlayCounts,
    PlayEnded,
    PlayerProblem,
    PlayOutcome,
    PlayProgress,
    PlayState,
)
from bcapscope.protocol.text_format import display_width
from bcapscope.render.play_text import (
    RETRIES_EXPECTED,
    controller_line,
    play_summary_lines,
    play_summary_record,
    progress_line,
    trouble_lines,
)

LATE = Spread(500, 1_000, 20_000, 300_000, 2_500_000)
HOSTILE = "a\x1b[31m\n\u202eb"


def test_who_is_there() -> None:
    peer = ControllerInfo(False, "RC7", {"type name": HOSTILE}, 2, (0.0,), 0.0)
    assert controller_line(peer) == (
        "a controller whose robot may move, RC7, type name a\\x1b[31m\\n\\u202eb; slave mode 0x002: J type, "
        "Sync: slvMove is answered when the controller takes the set point; a late set point is an error"
    )
    assert controller_line(ControllerInfo(True, "RC8", {}, 0x999, (), 0.0)) == (
        "bcapscope's simulator, no robot moves, RC8; slave mode 0x999"
    )


def test_progress_fits_into_its_line() -> None:
    progress = PlayProgress(
        PlayState.PLAYING,
        50,
        100,
        0.4,
        0.41,
        LATE,
        PlayCounts(54, retries=7),
        (1.0,),
        (1.234, -5.0),
        b"",
        b"",
    )
    line = progress_line(progress, 200)
    assert line == "playing 50/100, 0.4 s, 0.4 s left  late ms p99.9 0.300 max 2.500  retries 7  1.23 -5.00"
    assert progress_line(progress, 20) == line[:20]
    assert progress_line(PlayProgress(PlayState.LEAVING), 99) == "leaving 0, 0.0 s  retries 0"
    japanese = progress_line(progress, 40, MessageFormatter(Language.JAPANESE))
    assert "再送 7" in progress_line(progress, 200, MessageFormatter(Language.JAPANESE))
    assert 38 <= display_width(japanese) <= 40


def test_errors_of_the_controller() -> None:
    trouble = PlayerProblem(_text("refused"), ((0x84201482, HOSTILE), (0x80004005, "")))
    assert list(trouble_lines(trouble)) == [
        "refused",
        "  the controller shows 0x84201482: a\\x1b[31m\\n\\u202eb",
        "  the controller shows E_FAIL: ",
    ]


def test_the_summary() -> None:
    counts = PlayCounts(108, retries=3, late=1, shifted=2)
    ended = PlayEnded(
        PlayOutcome.STOPPED, _text("stop was asked for"), LATE, LATE, counts, 100, True, False, 12
    )
    assert list(play_summary_lines(ended)) == [
        "stopped on the way, at rest: stop was asked for",
        "set points: 108 sent, retries: 3, late replies: 1, postponed because the player was late: 2",
        "lateness, ms: p50 0.001, p99 0.020, p99.9 0.300, max 2.500, with real-time priority",
        "from one set point to the next, ms: p50 0.001, p99 0.020, p99.9 0.300, max 2.500",
        "12 records of the controller's log saved",
        "the player could not leave in order: its session, its arm or slave mode may still be active",
    ]


def test_retries_that_are_normal_are_called_so() -> None:
    def lines(retries: int, expected: bool) -> list[str]:
        ended = PlayEnded(
            PlayOutcome.DONE, counts=PlayCounts(100, retries=retries), retries_expected=expected
        )
        return [line for line in play_summary_lines(ended) if "retries per set point are normal" in line]

    assert lines(300, True) == [str(RETRIES_EXPECTED)]
    assert lines(300, False) == lines(0, True) == []


def test_a_reason_of_several_lines_and_nothing_sent() -> None:
    ended = PlayEnded(PlayOutcome.UNANSWERED, _text("no answer, 2 tries:\n  one\n  two"))
    assert list(play_summary_lines(ended)) == ["given up: no answer: no answer, 2 tries:", "  one", "  two"]


def test_a_stop_before_anything_moved() -> None:
    ended = PlayEnded(PlayOutcome.STOPPED, _text("stop was asked for"))
    assert list(play_summary_lines(ended)) == ["stopped before the first set point: stop was asked for"]


def test_every_outcome_has_words() -> None:
    assert (
        len({next(play_summary_lines(PlayEnded(outcome))) for outcome in PlayOutcome}) >= len(PlayOutcome) - 1
    )


def test_the_summary_as_json() -> None:
    found = json.loads(
        play_summary_record(
            PlayEnded(PlayOutcome.DONE, _text(HOSTILE), LATE, LATE, PlayCounts(9, retries=4), 5)
        )
    )
    assert found["reason"] == "a\\x1b[31m\\n\\u202eb"
    assert (found["outcome"], found["set_points"], found["sent"], found["retries"]) == ("done", 5, 9, 4)
    assert found["lateness_ms"] == {"p50": 0.001, "p99": 0.02, "p999": 0.3, "most": 2.5}


def _text(english: str) -> Message:
    return Message.from_table("text", english)
