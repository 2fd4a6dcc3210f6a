"""Pasted hex becomes observations, with what is odd about it."""

from __future__ import annotations

from collections.abc import Iterator

import pytest
from hypothesis import given
from hypothesis import strategies as st

from bcapscope.capture.pasted_text import PastedText
from bcapscope.protocol.codec.frame import Frame, encode_frame
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
    assert "direction unknown, but the bytes look like a request" in pasted.comments[1]


def test_a_damaged_frame_is_shown_as_it_is_with_its_problems() -> None:
    damaged = REQUEST[:12] + REQUEST[13:]
    (seen,) = read(f"TX\n{damaged.hex(' ')}")
    assert seen.item == Frame(damaged)
    assert seen.item.problems


def problems_of(text: str) -> dict[str, str]:
    (seen,) = read(text)
    return {problem.code: str(problem.reason) for problem in seen.item.problems}


def test_an_argument_without_its_frame_is_named() -> None:
    problems = problems_of("TX\n08 00 00 00 02 00 01 00 00 00 02 00")
    assert problems["argument"] == "these bytes are one argument of a frame, of type VT_I2"
    assert list(problems_of("TX\n08 00 00 00 02 00 01 00 00 00 02 00 00")) == ["soh"]


def request_for(command: str) -> bytes:
    return encode_frame(5, 0, 64, (Variant(VT.I4, 1), Variant(VT.BSTR, command), Variant(VT.I4, 2)))


@pytest.mark.parametrize("name", ["slvCha\x8eg\x85Mode", "slvChnageMode"])
def test_a_misread_or_misspelt_command_is_reported(name: str) -> None:
    problems = {"name": "unknown command; perhaps slvChangeMode was meant"}
    assert problems_of(f"TX\n{request_for(name).hex(' ')}") == problems
    assert problems_of(request_for(name).hex(" ")) == problems


@pytest.mark.parametrize("name", ["slvMove", "SLVMOVE", "", "MyOwnThing", "日本", "slvMov" * 1000])
def test_known_commands_and_names_like_no_other_are_no_problem(name: str) -> None:
    assert problems_of(f"TX\n{request_for(name).hex(' ')}") == {}


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
