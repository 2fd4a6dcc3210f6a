"""Classify the first frame of a client: whether the frame is complete, and whether it is a stop request."""

from __future__ import annotations

from bcapscope.protocol.codec.frame import LARGEST_FRAME, SMALLEST_FRAME, SOH, Frame
from bcapscope.protocol.codec.frame_content import has_compressed_header
from bcapscope.protocol.guard import always_passes

LONGEST_FIRST_FRAME = 4096
"""A longer first frame counts as complete after this number of bytes. Frames that open a session are shorter
than this limit.
"""

_LONGEST_STOP = 1024
_LENGTH_ENDS = 5


def is_first_frame_incomplete(data: bytes | bytearray) -> bool:
    """Return whether the first bytes of a stream begin a frame that is not complete yet."""
    if not data:
        return True
    if data[0] != SOH:
        return False
    if len(data) < _LENGTH_ENDS:
        return True
    length = _length(data)
    return SMALLEST_FRAME <= length < LARGEST_FRAME and len(data) < min(length, LONGEST_FIRST_FRAME)


def first_frame_stops(data: bytes) -> bool:
    """Return whether the first request in a datagram or stream stops something or releases a handle."""
    if len(data) < SMALLEST_FRAME or data[0] != SOH:
        return False
    length = _length(data)
    if not SMALLEST_FRAME <= length <= min(len(data), _LONGEST_STOP) or has_compressed_header(data):
        return False
    frame = Frame(data[:length])
    return not frame.problems and always_passes(frame.code, frame.variants)


def _length(data: bytes | bytearray) -> int:
    return int.from_bytes(data[1:_LENGTH_ENDS], "little")
