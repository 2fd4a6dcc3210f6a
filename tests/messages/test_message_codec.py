"""Messages that cross from one process to another."""

from __future__ import annotations

import pytest

from bcapscope.messages import Language, Message, MessageFormatter
from bcapscope.messages.message_codec import decode_message, encode_message
from bcapscope.messages.places import Count, Duration, IndentedLines, Listing, WireText

MESSAGES = [
    Message("os.no-answer"),
    Message("call.one", text="text", number=3, share=0.5),
    Message.from_table("os.EACCES", "permission denied"),
    Message(
        "call.unanswered",
        call="x",
        attempts=Count(2, "attempt"),
        log=IndentedLines((Message("os.no-answer"),)),
    ),
    Message("a.b", time=Duration(5), names=Listing(("a", Message("os.no-answer"))), wire=WireText("[red]")),
]


@pytest.mark.parametrize("message", MESSAGES)
def test_a_message_comes_back_as_it_was(message: Message) -> None:
    again = decode_message(encode_message(message))
    assert again == message
    assert str(again) == str(message)


def test_the_reader_decides_on_the_language() -> None:
    again = decode_message(encode_message(Message("os.no-answer")))
    assert MessageFormatter(Language.JAPANESE).text(again) == "応答がありません"
