"""Strict validation of frames, to distinguish a plausible guess from nonsense.

The decoder accepts any bytes and only reports wrong length fields (`bcapscope.protocol.codec.arguments`).
These functions require that all lengths agree, as in all frames from DENSO's libraries. The function or
result code must exist, and the arguments must have the types of the function.
"""

from __future__ import annotations

import struct
from collections.abc import Sequence

from bcapscope.protocol.codec.frame_content import EOT, HEADER_SIZE, SMALLEST_FRAME, SOH
from bcapscope.protocol.codec.variant import ARRAY, MAX_NESTING, NUMBER_WIDTHS, VT
from bcapscope.protocol.tables.function_table import FUNCTIONS, Param
from bcapscope.protocol.tables.hresult import describe_hresult

LARGEST_LIKELY = 64 * 1024
"""Largest plausible value of the length field, in bytes. A larger value is treated as damage, since frames of
real sessions are below 10 KiB."""

_LENGTH_AT = 1
_CODE_AT = 9
_ARGC_AT = 13
_U16 = struct.Struct("<H")
_U32 = struct.Struct("<I")
SENT_TYPES: dict[str, tuple[int, ...]] = {
    "VT_I4": (VT.I4, VT.UI4, VT.I2),
    "VT_R4": (VT.R4, VT.R8),
    "VT_BSTR": (VT.BSTR,),
}
"""VARIANT types that clients send for each argument type of the function table. An argument declared as
VARIANT may have any type."""

_RESULT = (Param("pVal", "VARIANT"),)


class _Implausible(Exception):
    """A field has an implausible value."""

    def __init__(self, offset: int) -> None:
        self.offset = offset


class _BytesEnded(Exception):
    """The bytes end before anything implausible occurred."""


def plausible_length_field(data: bytes) -> int | None:
    if len(data) < _LENGTH_AT + 4:
        return None
    (length,) = _U32.unpack_from(data, _LENGTH_AT)
    return length if SMALLEST_FRAME <= length <= LARGEST_LIKELY else None


def plausible_prefix_length(data: bytes, length: int, is_request: bool | None) -> int:
    """Return how many bytes of `data` could begin a sound frame of `length` bytes.

    The result is `length` for a whole sound frame, `len(data)` for a sound frame that is cut off, otherwise
    the offset of the first implausible field. The function ignores the frame's length field. `is_request` is
    None if the sender is not known.
    """
    found = 0
    if is_request is not False:
        found = _prefix_length(data[:length], length, request=True)
    if is_request is not True:
        found = max(found, _prefix_length(data[:length], length, request=False))
    return found


def plausible_argument_end(data: bytes, start: int = 0) -> int | None:
    """Return the offset after the argument that begins at `start`; None if the argument is not plausible."""
    try:
        return _check_argument(data, start, len(data), "VARIANT")
    except (_Implausible, _BytesEnded):
        return None


def _prefix_length(data: bytes, length: int, request: bool) -> int:
    try:
        _check_frame(data, length, request)
    except _Implausible as trouble:
        return trouble.offset
    except _BytesEnded:
        return min(len(data), length - 1)
    return length


def _check_frame(data: bytes, length: int, request: bool) -> None:
    if data[:1] != bytes((SOH,)):
        raise _Implausible(0)
    code = _read(_U32, data, _CODE_AT)
    params = _request_params(code) if request else _result_params(code)
    argc = _read(_U16, data, _ARGC_AT)
    if argc > len(params) or (request and argc < len(params)):
        raise _Implausible(_ARGC_AT)
    pos = HEADER_SIZE
    for param in params[:argc]:
        pos = _check_argument(data, pos, length - 1, param.type)
    if pos != length - 1:
        raise _Implausible(pos)
    if pos >= len(data):
        raise _BytesEnded
    if data[pos] != EOT:
        raise _Implausible(pos)


def _request_params(code: int) -> Sequence[Param]:
    if code not in FUNCTIONS:
        raise _Implausible(_CODE_AT)
    return FUNCTIONS[code].params


def _result_params(code: int) -> Sequence[Param]:
    if not (code & 0x80000000 or describe_hresult(code).is_listed):
        raise _Implausible(_CODE_AT)
    return _RESULT


def _read(number: struct.Struct, data: bytes, pos: int) -> int:
    if pos + number.size > len(data):
        raise _BytesEnded
    value: int = number.unpack_from(data, pos)[0]
    return value


def _check_argument(data: bytes, pos: int, bound: int, declared: str) -> int:
    """Check the argument at `pos`, which must end at or before `bound`; return the offset after it."""
    stop = pos + 4 + _read(_U32, data, pos)
    if stop > bound:
        raise _Implausible(pos)
    if declared != "VARIANT" and _read(_U16, data, pos + 4) not in SENT_TYPES[declared]:
        raise _Implausible(pos + 4)
    end = _check_variant(data, pos + 4, stop, 0)
    if end != stop:
        raise _Implausible(pos)
    return stop


def _check_variant(data: bytes, pos: int, bound: int, depth: int) -> int:
    vt = _read(_U16, data, pos)
    count = _read(_U32, data, pos + 2)
    base, start = vt & ~ARRAY, pos + 6
    if vt & ARRAY:
        return _check_array(data, start, bound, (base, count, depth))
    if count > 1 or (count == 0 and base > VT.NULL):
        raise _Implausible(pos + 2)
    if base in (VT.EMPTY, VT.NULL):
        return start
    if base == VT.BSTR:
        return _check_string(data, start, bound)
    return _check_data(pos, start + _width(base, pos), bound)


def _check_array(data: bytes, start: int, bound: int, kind: tuple[int, int, int]) -> int:
    base, count, depth = kind
    if base not in (VT.BSTR, VT.VARIANT):
        return _check_data(start - 4, start + count * _width(base, start - 6), bound)
    if depth == MAX_NESTING or count > bound - start:
        raise _Implausible(start - 4)
    for _ in range(count):
        is_text = base == VT.BSTR
        start = (
            _check_string(data, start, bound) if is_text else _check_variant(data, start, bound, depth + 1)
        )
    return start


def _width(base: int, at: int) -> int:
    if base not in NUMBER_WIDTHS:
        raise _Implausible(at)
    return NUMBER_WIDTHS[base]


def _check_string(data: bytes, start: int, bound: int) -> int:
    size = _read(_U32, data, start)
    if size % 2:
        raise _Implausible(start)
    return _check_data(start, start + 4 + size, bound)


def _check_data(at: int, stop: int, bound: int) -> int:
    """Return `stop` if it is at most `bound`; otherwise the field at offset `at` is implausible."""
    if stop > bound:
        raise _Implausible(at)
    return stop
