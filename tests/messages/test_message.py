"""Messages as data and as text."""

from __future__ import annotations

import pickle

import pytest

from bcapscope.messages import ENGLISH_WORDS, Language, Message, MessageFormatter, language_of
from bcapscope.messages.message import has_message, message_params
from bcapscope.messages.places import ClientPlace, Count, Duration, Times, WireText

JAPANESE_WORDS = MessageFormatter(Language.JAPANESE)


def test_a_message_is_its_id_and_its_places() -> None:
    message = Message("tester.tab", name="A")
    assert message == Message("tester.tab", name="A")
    assert hash(message) == hash(Message("tester.tab", name="A"))
    assert message != Message("tester.tab", name="B")
    assert message != "tester.tab"
    assert repr(message) == "Message('tester.tab', name='A')"


def test_a_message_never_changes() -> None:
    message = Message("tester.tab", name="A")
    with pytest.raises(AttributeError):
        message.id = "x"
    with pytest.raises(TypeError):
        message.places["name"] = "x"  # type: ignore[index]


@pytest.mark.parametrize("message", [Message("tester.tab", name="A"), Message.from_table("x", "as it is")])
def test_a_message_crosses_processes(message: Message) -> None:
    assert pickle.loads(pickle.dumps(message)) == message


def test_text_is_in_the_readers_language() -> None:
    message = Message("tester.tab", name="A")
    assert str(message) == ENGLISH_WORDS.text(message) == "Tab: A"
    assert JAPANESE_WORDS.text(message) == "タブ: A"


def test_english_from_a_table_is_shown_where_no_translation_is() -> None:
    message = Message.from_table("no-such-entry", "out of range")
    assert JAPANESE_WORDS.text(message) == str(message) == "out of range"


def test_an_unknown_id_is_shown_with_its_places() -> None:
    assert str(Message("no.such", wait=Duration(12_000_000), name="x")) == "no.such (wait=12 ms, name=x)"
    assert not has_message("no.such")


def test_a_place_that_was_not_given_stays_visible() -> None:
    assert str(Message("tester.tab")) == "Tab: {name}"


def test_values_are_never_taken_for_places() -> None:
    assert str(Message("traffic.reading-ended", reason="{0} {x}")) == "Reading ended: {0} {x}"


def test_japanese_words_have_no_space_between_them() -> None:
    message = Message("finding.type-not-checked", client=ClientPlace("10.0.0.2:1", "udp"), call="Motor")
    assert JAPANESE_WORDS.text(message).startswith("クライアントは Motor を呼びました。")


def test_counts_follow_the_language() -> None:
    assert [Count(n, "call").text(ENGLISH_WORDS) for n in (0, 1, 2)] == ["0 calls", "1 call", "2 calls"]
    assert Count(1, "call").text(JAPANESE_WORDS) == "呼び出し 1 件"
    assert [Times(n).text(ENGLISH_WORDS) for n in (1, 2, 3)] == ["once", "twice", "3 times"]
    assert Times(2).text(JAPANESE_WORDS) == "2 回"


def test_japanese_words_are_not_separated_by_spaces() -> None:
    only, named = ClientPlace("10.0.0.2:1025", "udp"), MessageFormatter(Language.JAPANESE, only_client=False)
    name = WireText(" ロボット ")
    held = Message(
        "finding.handle-leak", client=only, handles=Count(30, "handle"), kind="Variable", name=name
    )
    assert (
        JAPANESE_WORDS.text(held)
        == "クライアントが Variable「 ロボット 」のハンドル 30 個を同時に持ちました。"
    )
    assert named.text(held).startswith("クライアント 10.0.0.2:1025 (UDP) が Variable「")


def test_params_are_for_programs() -> None:
    inner = Message("tester.tab", name="A")
    message = Message("x", wait=Duration(1_500_000), what=inner, n=3)
    assert message_params(message) == {
        "wait": {"type": "duration", "ms": 1.5},
        "what": {"type": "message", "id": "tester.tab", "params": {"name": "A"}, "text": "Tab: A"},
        "n": 3,
    }


@pytest.mark.parametrize(
    ("environment", "language"),
    [
        ({}, Language.ENGLISH),
        ({"LANG": "ja_JP.UTF-8"}, Language.JAPANESE),
        ({"LANG": "ja_JP.UTF-8", "LC_ALL": "C"}, Language.ENGLISH),
        ({"LANG": "de_DE.UTF-8", "LC_MESSAGES": "ja_JP"}, Language.JAPANESE),
        ({"LANG": "", "LC_ALL": ""}, Language.ENGLISH),
    ],
)
def test_the_environment_chooses(environment: dict[str, str], language: Language) -> None:
    assert language_of(environment) is language


def test_no_message_has_an_empty_id() -> None:
    assert not has_message("")
