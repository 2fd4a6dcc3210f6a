"""Notes of the proxy, commands, and the player at work, in Japanese."""

from __future__ import annotations

import re
from collections.abc import Iterator

import pytest

from bcapscope.errors import InputError
from bcapscope.faults.fault_injector import FaultInjector
from bcapscope.faults.fault_notation import read_fault
from bcapscope.messages import Language, Message, MessageFormatter
from bcapscope.player.lateness import Spread
from bcapscope.player.player_messages import (
    ControllerInfo,
    PlayProgress,
    PlayState,
)
from bcapscope.protocol.codec.variant_notation import parse_variant
from bcapscope.protocol.tables.table_rows import table_rows
from bcapscope.protocol.tables.table_text import table_message
from bcapscope.render.play_text import controller_line, run_figure_lines
from bcapscope.tui.reader_language import reader_words
from tests.faults.traffic import request, talk
from tests.tui.japanese.english import left_over

pytestmark = pytest.mark.usefixtures("japanese_screen")

JAPANESE = re.compile("[ぁ-んァ-ヶ一-龥]")


def texts_of_commands() -> Iterator[str]:
    for row in table_rows("commands"):
        yield row["text"]
        yield from filter(re.compile("[a-z]{3}").search, (row["elements"], row["returns"]))


def test_everything_that_is_said_of_commands_is_there() -> None:
    japanese = MessageFormatter(Language.JAPANESE)
    texts = {text: japanese.text(table_message(text)) for text in texts_of_commands()}
    assert [text for text, found in texts.items() if found == text or left_over(found)] == []


def messages() -> Iterator[str]:
    for text in ("i2:x", "bool:2", "empty:1", "empty[]:1", "variant:1"):
        with pytest.raises(InputError) as raised:
            parse_variant(text)
        yield reader_words().text(raised.value.message)


def fault_note(rule: str) -> Message:
    """Return what a fault says about a message that it hits."""
    injector = FaultInjector([read_fault(rule)], seed=1, now=0)
    (note,) = injector.process_message(talk().up, request(1), 0).fault_notes
    return note


@pytest.mark.parametrize(
    ("note", "translation"),
    [
        (fault_note("drop name lossy"), "lossy: 破棄"),
        (fault_note("delay=3.214ms name slow"), "slow: 3.214 ms 遅延"),
        (
            Message("guard.refused", reason=Message("guard.blocked", name="Robot_Move")),
            "保護: Robot_Move は遮断対象",
        ),
        (
            Message("guard.answered", reason=Message("guard.read-only", name="Robot_Execute slvMove")),
            "保護: 読み取り専用（Robot_Execute slvMove）、E_ACCESSDENIED で応答",
        ),
        (Message("held.edited", time="1.2 s"), "保留: 1.2 s 後に変更して送信"),
    ],
)
def test_what_a_proxy_did_to_a_packet(note: Message, translation: str) -> None:
    assert reader_words().text(note) == translation


def test_what_else_the_tester_shows() -> None:
    assert [text for text in messages() if not JAPANESE.search(text) or left_over(text)] == []


def test_the_player_at_work() -> None:
    progress = PlayProgress(PlayState.PLAYING, 50, 100, 0.4, 0.4, Spread(50, 1000, 2000, 3000, 4000))
    assert all(
        JAPANESE.search(line) for line in run_figure_lines(progress, (1, 8.0, 3.4), words=reader_words())
    )


def test_who_is_there_before_anything_moves() -> None:
    facts = {"type name": "VS-068, no answer", "type": "10", "version": "3.0.0"}
    assert controller_line(
        ControllerInfo(False, "RC7", facts, 0x002, (0.0,), 0.0), MessageFormatter(Language.JAPANESE)
    ) == (
        "ロボットが動く可能性のあるコントローラ, RC7, 型式名 VS-068, no answer, 型式番号 10, "
        "バージョン 3.0.0; スレーブモード 0x002: J 型、Sync: "
        "コントローラが指令値を取り込むと slvMove に応答。指令値が遅れるとエラー"
    )
