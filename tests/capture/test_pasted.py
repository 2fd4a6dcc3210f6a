"""Pasted hex becomes observations, with what is odd about it."""

from __future__ import annotations

from hypothesis import given
from hypothesis import strategies as st

from bcapscope.capture.pasted import observe_text
from bcapscope.protocol.frame import Frame, Malformed, encode
from bcapscope.protocol.variant import VT, Variant
from bcapscope.traffic.observation import Direction, Transport

REQUEST = encode(5, 0, 64, (Variant(VT.I4, 1), Variant(VT.BSTR, "slvMove"), Variant(VT.I4, 2)))


def test_a_captioned_packet() -> None:
    pasted = observe_text(f"RX(Server->Client):\n{encode(5, 0, 0).hex(' ')}\n")
    (seen,) = pasted.observations
    assert seen.item == Frame(encode(5, 0, 0))
    assert seen.flow.direction is Direction.RESPONSE
    assert seen.flow.conversation.transport is Transport.UNKNOWN
    assert (seen.flow.src_text, seen.flow.dst_text) == ("server", "client")
    assert pasted.comments[1][0].startswith("line 2: RX(Server->Client)")


def test_a_direction_that_had_to_be_guessed_is_said() -> None:
    pasted = observe_text(REQUEST.hex(" "))
    assert pasted.observations[0].flow.direction is Direction.REQUEST
    assert "taken for a request by its bytes" in pasted.comments[1]


def test_damage_is_explained_as_a_guess() -> None:
    damaged = REQUEST[:12] + REQUEST[13:]
    (seen,) = observe_text(f"TX\n{damaged.hex(' ')}").observations
    assert isinstance(seen.item, Frame)
    assert seen.item.raw == damaged
    guess = seen.item.problems[-1]
    assert guess.code == "guess"
    assert "probably 1 zero byte lost: at offset 12 in the function id" in guess.reason


def test_hex_without_a_frame_is_malformed() -> None:
    (seen,) = observe_text("TX\n08 00 00 00 02 00 01 00 00 00 02 00").observations
    assert isinstance(seen.item, Malformed)
    assert len(seen.item.problems) == 2


def test_no_hex_is_nothing() -> None:
    assert observe_text("Add a face to the facade.\n").observations == []


@given(st.text())
def test_any_text_is_read(text: str) -> None:
    pasted = observe_text(text)
    assert [seen.number for seen in pasted.observations] == list(range(1, len(pasted.observations) + 1))
    for seen in pasted.observations:
        assert seen.item.problems is not None
