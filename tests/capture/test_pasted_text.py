"""Pasted hex becomes observations, with what is odd about it."""

from __future__ import annotations

from collections.abc import Iterator

from hypothesis import given
from hypothesis import strategies as st

from bcapscope.capture.pasted_text import PastedText
from bcapscope.protocol.codec.frame import Frame, Malformed, encode_frame
from bcapscope.protocol.codec.variant import VT, Variant
from bcapscope.traffic.observation import Direction, Transport
from tests.dumps import lines_of

REQUEST = encode_frame(5, 0, 64, (Variant(VT.I4, 1), Variant(VT.BSTR, "slvMove"), Variant(VT.I4, 2)))


def test_a_captioned_packet() -> None:
    pasted = read(f"RX(Server->Client):\n{encode_frame(5, 0, 0).hex(' ')}\n")
    (seen,) = pasted
    assert seen.item == Frame(encode_frame(5, 0, 0))
    assert seen.flow.direction is Direction.RESPONSE
    assert seen.flow.conversation.transport is Transport.UNKNOWN
    assert (seen.flow.src_text, seen.flow.dst_text) == ("server", "client")
    assert pasted.comments[1][0].startswith("line 2: RX(Server->Client)")


def test_a_direction_that_had_to_be_guessed_is_said() -> None:
    pasted = read(REQUEST.hex(" "))
    assert next(iter(pasted)).flow.direction is Direction.REQUEST
    assert "taken for a request by its bytes" in pasted.comments[1]


def test_damage_is_explained_as_a_guess() -> None:
    damaged = REQUEST[:12] + REQUEST[13:]
    (seen,) = read(f"TX\n{damaged.hex(' ')}")
    assert isinstance(seen.item, Frame)
    assert seen.item.raw == damaged
    guess = seen.item.problems[-1]
    assert guess.code == "guess"
    assert "probably 1 zero byte lost: at offset 12 in the function id" in str(guess.reason)


def test_hex_without_a_frame_is_malformed() -> None:
    (seen,) = read("TX\n08 00 00 00 02 00 01 00 00 00 02 00")
    assert isinstance(seen.item, Malformed)
    assert len(seen.item.problems) == 2


def test_no_hex_is_nothing() -> None:
    assert list(read("Add a face to the facade.\n")) == []


@given(st.text())
def test_any_text_is_read(text: str) -> None:
    pasted = read(text)
    for number, seen in enumerate(pasted, 1):
        assert seen.number == pasted.count == number
        assert list(pasted.comments) == [number]
        assert seen.item.problems is not None


def test_packets_come_before_the_text_ends() -> None:
    def lines() -> Iterator[str]:
        for _ in range(3):
            yield "a request:"
            yield REQUEST.hex(" ")
        raise AssertionError("read too far")

    assert next(iter(PastedText(lines()))).item == Frame(REQUEST)


def read(text: str) -> PastedText:
    return PastedText(lines_of(text))
