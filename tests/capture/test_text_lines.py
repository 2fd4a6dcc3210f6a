"""Lines come out of any bytes, however they are cut, and none is waited for without end."""

from __future__ import annotations

import io
from collections.abc import Iterator

import pytest
from hypothesis import given
from hypothesis import strategies as st

from bcapscope.capture.byte_source import ChunkReader
from bcapscope.capture.pasted_text import LONGEST_LINE, text_lines
from bcapscope.errors import CaptureError
from tests.dumps import lines_of


def cut(data: bytes, size: int) -> ChunkReader:
    """Give `data` in pieces of `size` bytes."""
    stream = io.BytesIO(data)
    return lambda _: stream.read(size)


@given(st.text(st.characters(exclude_categories=["Cs"])), st.integers(1, 5))
@pytest.mark.parametrize("encoding", ["utf-8", "utf-8-sig", "utf-16"])
def test_lines_are_those_of_the_text(encoding: str, text: str, size: int) -> None:
    expected = lines_of(text.removeprefix("\ufeff"))
    assert list(text_lines(cut(text.encode(encoding), size))) == expected


@given(st.binary())
def test_any_bytes_are_read(data: bytes) -> None:
    assert list(text_lines(cut(data, 3))) == list(text_lines(cut(data, 1000)))


def test_a_line_without_end_is_refused_where_it_becomes_too_long() -> None:
    given_out = 0

    def zeros(size: int) -> bytes:
        nonlocal given_out
        given_out += size
        return bytes(size) if given_out > size else b"first\n" + bytes(size - 6)

    lines = text_lines(zeros)
    assert next(lines) == "first"
    with pytest.raises(CaptureError, match="line 2 has more than 262144 characters") as caught:
        next(lines)
    assert caught.value.offset
    assert given_out < 4 * LONGEST_LINE


def test_the_longest_line_is_read() -> None:
    text = b"\n" + b"0" * LONGEST_LINE + b"\nlast"
    assert [len(line) for line in text_lines(io.BytesIO(text).read)] == [0, LONGEST_LINE, 4]


def test_lines_are_given_before_the_text_ends() -> None:
    def chunks() -> Iterator[bytes]:
        yield b"one\ntwo"
        raise AssertionError("read too far")

    given_out = chunks()
    assert next(text_lines(lambda _: next(given_out))) == "one"
