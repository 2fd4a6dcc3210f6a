"""Frames, and the damage that documents and mails do to them."""

from __future__ import annotations

from bcapscope.protocol.codec.frame import encode_frame
from bcapscope.protocol.codec.variant import VT, Variant, encode_argument

HANDLE = Variant(VT.I4, 1)
POSE = Variant.array(VT.R4, (-57.5, 25.25, 178.0, 34.0, 0.0, 0.0, 0.0, 0.0))
CHANGE_MODE = encode_frame(5, 0, 64, (HANDLE, Variant(VT.BSTR, "slvChangeMode"), Variant(VT.I2, 2)))
GET_MODE = encode_frame(5, 0, 64, (HANDLE, Variant(VT.BSTR, "slvGetMode"), Variant(VT.BSTR, "")))
MOVE = encode_frame(1233, 1232, 64, (HANDLE, Variant(VT.BSTR, "slvMove"), POSE))
MOVED = encode_frame(1233, 1232, 0, (POSE,))
DONE = encode_frame(5, 0, 0)
SOUND = (CHANGE_MODE, GET_MODE, MOVE, MOVED, DONE)


def without(data: bytes, *offsets: int) -> bytes:
    """Take zero bytes out."""
    assert all(data[offset] == 0 for offset in offsets)
    return bytes(byte for offset, byte in enumerate(data) if offset not in offsets)


NUMBER = encode_argument(HANDLE)
TEXT = encode_argument(Variant(VT.BSTR, "slvChangeMode"))
