"""Messages between the proxy and the process of the scripts, and their bounds."""

from __future__ import annotations

from typing import Any

import pytest

from bcapscope.proxy.script_protocol import (
    LARGEST_FRAME_SIZE,
    LONGEST_SENTENCE,
    MAX_SENTENCES,
    ClientGone,
    FrameUnpacker,
    ScriptAnswer,
    ScriptOrder,
    ScriptStatement,
    WireError,
    WireSentence,
    pack,
)


def unpacked(message: ScriptOrder | ScriptStatement, kinds: Any = ScriptStatement) -> object:
    unpacker: FrameUnpacker[object] = FrameUnpacker(kinds)
    unpacker.feed_bytes(pack(message))
    return unpacker.next_frame()


def sentence(text: str = "") -> WireSentence:
    return WireSentence("x" * 60, {"place": text})


@pytest.mark.parametrize(
    "answer",
    [
        ScriptAnswer(results=(0,) * 63 + (0xFFFFFFFF,)),
        ScriptAnswer(notices=(sentence(),) * MAX_SENTENCES),
        ScriptAnswer(notices=(sentence("x" * LONGEST_SENTENCE),)),
    ],
)
def test_an_answer_at_its_bounds_is_read(answer: ScriptAnswer) -> None:
    assert unpacked(answer) == answer


@pytest.mark.parametrize(
    "answer",
    [
        ScriptAnswer(results=(-1,)),
        ScriptAnswer(results=(1 << 32,)),
        ScriptAnswer(results=(0,) * 65),
        ScriptAnswer(notices=(sentence(),) * (MAX_SENTENCES + 1)),
        ScriptAnswer(notices=(sentence("x" * (LONGEST_SENTENCE + 1)),)),
        ScriptAnswer(notices=(WireSentence("x" * 61, {}),)),
    ],
)
def test_an_answer_beyond_its_bounds_is_refused(answer: ScriptAnswer) -> None:
    with pytest.raises(WireError):
        unpacked(answer)


@pytest.mark.parametrize("size", [0, LARGEST_FRAME_SIZE + 1])
def test_an_impossible_size_is_refused_before_more_bytes_arrive(size: int) -> None:
    unpacker: FrameUnpacker[object] = FrameUnpacker(ScriptStatement)
    unpacker.feed_bytes(size.to_bytes(4, "little"))
    with pytest.raises(WireError):
        unpacker.next_frame()


def test_messages_arrive_one_by_one_however_their_bytes_are_cut() -> None:
    data = b"".join(pack(ClientGone(number)) for number in (1, 2, 3))
    unpacker: FrameUnpacker[ScriptOrder] = FrameUnpacker(ScriptOrder)
    found: list[object] = []
    for at in range(0, len(data), 5):
        unpacker.feed_bytes(data[at : at + 5])
        while (message := unpacker.next_frame()) is not None:
            found.append(message)
    assert found == [ClientGone(1), ClientGone(2), ClientGone(3)]


def test_the_largest_message_is_waited_for() -> None:
    unpacker: FrameUnpacker[ScriptOrder] = FrameUnpacker(ScriptOrder)
    unpacker.feed_bytes(LARGEST_FRAME_SIZE.to_bytes(4, "little"))
    assert unpacker.next_frame() is None
