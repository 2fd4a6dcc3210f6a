"""What rooms below say, in Japanese."""

from __future__ import annotations

import importlib
import pkgutil
import re
import time
from collections.abc import Iterator

import pytest
from hypothesis import given
from hypothesis import strategies as st

from bcapscope.messages import Language, MessageFormatter
from bcapscope.player.lateness import Spread
from bcapscope.player.player_messages import (
    ControllerInfo,
    PlayProgress,
    PlayState,
)
from bcapscope.protocol.codec.variant_notation import parse_variant
from bcapscope.protocol.slave_mode.modes import MODES
from bcapscope.protocol.tables.command_table import COMMAND_ROWS
from bcapscope.protocol.tables.table_text import table_message
from bcapscope.render.play_text import controller_line
from bcapscope.render.slave_run_charts import run_figure_lines
from bcapscope.tui import words
from bcapscope.tui.reader_language import localized, reader_words
from bcapscope.tui.words import PHRASES
from bcapscope.tui.words.phrases import KINDS, LONGEST, Phrasebook
from tests.tui.words.english import left_over

pytestmark = pytest.mark.usefixtures("japanese_screen")

JAPANESE = re.compile("[ぁ-んァ-ヶ一-龥]")
BOOK = Phrasebook(
    {
        "a {text} of {text2}": "{text2} の {text}",
        "a {n} of {text}": "{text} の {n} 番",
        "{axes} moves": "{axes} が動く",
        "cat": "猫",
        "{client} called {name}": "{client} が {name} を呼んだ",
        "your client": "クライアント",
        "{clause} ({times} in all)": "{clause} (計 {times})",
        "twice": "2 回",
    }
)


def is_japanese(text: str) -> bool:
    japanese = localized(text)
    return bool(JAPANESE.search(japanese)) and not left_over(japanese)


@pytest.mark.parametrize(
    ("english", "japanese"),
    [
        ("cat", "猫"),
        ("dog", "dog"),
        ("", ""),
        ("a tail of cat", "猫の tail"),
        ("a 3 of cat", "猫の 3 番"),
        ("a -1.5e-07 of cat", "猫の -1.5e-07 番"),
        ("J1, J2 moves", "J1, J2 が動く"),
        ("nothing moves", "nothing moves"),
        ("cat, a {0} of {x}", "猫、{x} の {0}"),
        ("a tail\nor x of cat", "猫の tail\nor x"),
        ("Your client called cat.", "クライアントが cat を呼んだ。"),
        ("Your client called cat; cat; a 3 of cat.", "クライアントが cat を呼んだ。猫。猫の 3 番。"),
        ("Your client called x; y; cat (twice in all).", "クライアントが x; y を呼んだ。猫 (計 2 回)。"),
        ("dog (twice in all)", "dog (twice in all)"),
        ("cat; dog", "猫; dog"),
        ("Dog.", "Dog."),
    ],
)
def test_phrases_and_what_stands_in_their_places(english: str, japanese: str) -> None:
    assert BOOK.japanese(english) == japanese


def test_japanese_has_the_places_of_the_english() -> None:
    for english, japanese in PHRASES.items():
        ours, theirs = (re.findall(r"\{(.*?)\}", text) for text in (japanese, english))
        assert set(ours) <= set(theirs), english
        assert len(theirs) == len(set(theirs)), english
        assert {name.rstrip("0123456789") for name in theirs} <= set(KINDS), english


def texts_of_commands() -> Iterator[str]:
    for row in (row for rows in COMMAND_ROWS.values() for row in rows):
        yield row.text
        yield from filter(re.compile("[a-z]{3}").search, (row.elements, row.returns))


def test_everything_that_is_said_of_commands_is_there() -> None:
    japanese = MessageFormatter(Language.JAPANESE)
    texts = {text: japanese.text(table_message(text)) for text in texts_of_commands()}
    assert [text for text, found in texts.items() if found == text or left_over(found)] == []


def test_books_do_not_disagree() -> None:
    names = [module.name for module in pkgutil.iter_modules(words.__path__, f"{words.__name__}.")]
    books = [getattr(importlib.import_module(name), "PHRASES", {}) for name in names]
    for book in books:
        assert {english: PHRASES[english] for english in book} == book


def messages() -> Iterator[str]:
    for text in ("i2:x", "bool:2", "empty:1", "empty[]:1", "variant:1"):
        with pytest.raises(ValueError, match=r".") as raised:
            parse_variant(text)
        yield str(raised.value)
    yield from (mode.text for mode in MODES if mode.pose_type)


@pytest.mark.parametrize(
    ("note", "translation"),
    [
        ("loss=5%: dropped", "loss=5%: 破棄"),
        (
            "delay=3ms if command == slvMove: delayed by 3.214 ms",
            "delay=3ms if command == slvMove: 3.214 ms 遅延",
        ),
        ("guard: Robot_Move is blocked", "保護: Robot_Move は遮断対象"),
        (
            "guard: read-only: Robot_Execute slvMove, answered with E_ACCESSDENIED",
            "保護: 読み取り専用 (Robot_Execute slvMove)、E_ACCESSDENIED で応答",
        ),
        ("intercept: edited after 1.2 s", "保留: 1.2 s 後に変更して送信"),
    ],
)
def test_what_a_proxy_did_to_a_packet(note: str, translation: str) -> None:
    assert localized(note) == translation


def test_what_else_the_tester_shows() -> None:
    assert [text for text in messages() if not is_japanese(text)] == []


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
        "バージョン 3.0.0; スレーブモード 0x002: J 型、Sync: slvMove は取り込まれたとき応答、遅れるとエラー"
    )


WHOLE = Phrasebook(PHRASES)
PIECES = sorted({piece for english in PHRASES for piece in re.split(r"\{\w+\}", english) if piece})


@given(
    st.one_of(
        st.text("J1 ,:;'{}of typea", max_size=LONGEST + 1),
        st.lists(st.sampled_from(PIECES), max_size=60).map("".join),
    )
)
def test_no_text_takes_long_or_breaks(text: str) -> None:
    began = time.process_time()
    assert isinstance(WHOLE.japanese(text), str)
    assert time.process_time() - began < 5


def test_long_text_stays_as_it_is() -> None:
    text = "cat, " * LONGEST
    assert BOOK.japanese(text) == text
