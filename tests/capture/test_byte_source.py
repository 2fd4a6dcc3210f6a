"""Bytes of captures: windows on a stream, and gzip unpacked while it arrives."""

from __future__ import annotations

import gzip
import io
import random
import zlib
from collections.abc import Callable

import pytest

from bcapscope.capture.byte_source import CHUNK_SIZE, ByteSource, GzipReader
from bcapscope.errors import CaptureError

CONTENT = random.Random(1).randbytes(3000) + bytes(2 * CHUNK_SIZE + 7) + b"end"


def in_pieces(data: bytes, size: int) -> Callable[[int], bytes]:
    stream = io.BytesIO(data)
    return lambda wanted: stream.read(min(size, wanted))


def unpack(packed: bytes, size: int = CHUNK_SIZE) -> tuple[bytes, CaptureError | None]:
    gunzip = GzipReader(in_pieces(packed[2:], size), packed[:2])
    content = b""
    try:
        while data := gunzip(CHUNK_SIZE):
            assert len(data) <= CHUNK_SIZE
            content += data
    except CaptureError as error:
        return content, error
    return content, None


def test_a_window_keeps_its_place() -> None:
    source = ByteSource(in_pieces(b"abcdefgh", 3))
    assert source.ensure_bytes(4)
    assert (source.data, source.offset) == (b"abcdef", 0)
    assert source.advance(5)
    assert (source.data, source.offset) == (b"fgh", 5)
    assert not source.ensure_bytes(4)
    assert (source.data, source.offset) == (b"fgh", 5)
    assert not source.advance(3)
    assert (source.data, source.offset) == (b"", 8)


@pytest.mark.parametrize("size", [1, 2, 100, CHUNK_SIZE])
def test_unpacks_members_one_after_another(size: int) -> None:
    packed = gzip.compress(CONTENT) + gzip.compress(b"") + gzip.compress(b"second") + bytes(600)
    assert unpack(packed, size) == (CONTENT + b"second", None)


def test_gives_what_has_arrived() -> None:
    packer = zlib.compressobj(wbits=31)
    arrived = [packer.compress(b"one") + packer.flush(zlib.Z_SYNC_FLUSH)]
    gunzip = GzipReader(lambda _: arrived.pop(), b"")
    assert gunzip(CHUNK_SIZE) == b"one"
    arrived.append(packer.compress(b"two") + packer.flush(zlib.Z_SYNC_FLUSH))
    assert gunzip(CHUNK_SIZE) == b"two"


def test_every_cut_leaves_what_is_before_it() -> None:
    content = random.Random(2).randbytes(300) + b"a" * 100
    packed = gzip.compress(content)
    for cut in range(2, len(packed)):
        found, error = unpack(packed[:cut])
        assert content.startswith(found)
        assert error is not None
        assert (str(error), error.offset) == ("the compressed file ends in the middle", len(found))
    assert unpack(packed) == (content, None)


def test_damage_leaves_what_is_before_it() -> None:
    content = random.Random(3).randbytes(5000)
    packer = zlib.compressobj(wbits=31)
    packed = packer.compress(content[:2500]) + packer.flush(zlib.Z_FULL_FLUSH)
    found, error = unpack(packed + b"\xff" * 100)
    assert found == content[:2500]
    assert error is not None
    assert (str(error), error.offset) == ("the compressed file is damaged", len(found))


def test_a_wrong_check_comes_after_the_content() -> None:
    packed = bytearray(gzip.compress(b"content"))
    packed[-8] ^= 1
    found, error = unpack(bytes(packed))
    assert found == b"content"
    assert str(error) == "the compressed file is damaged"


def test_what_follows_a_member_must_be_one() -> None:
    found, error = unpack(gzip.compress(b"content") + b"garbage")
    assert found == b"content"
    assert str(error) == "the compressed file is damaged"


def test_damage_in_what_unpacks_to_much_is_given_out_piece_by_piece() -> None:
    packer = zlib.compressobj(wbits=31)
    packed = packer.compress(bytes(20 * CHUNK_SIZE)) + packer.flush(zlib.Z_FULL_FLUSH)
    found, error = unpack(packed + b"\xff" * 10)
    assert len(found) == 20 * CHUNK_SIZE
    assert error is not None
