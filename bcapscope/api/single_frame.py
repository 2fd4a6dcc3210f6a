"""Decode and encode single frames."""

from __future__ import annotations

from collections.abc import Sequence

from bcapscope.errors import InputError, RemoteProtocolError
from bcapscope.messages import Message
from bcapscope.protocol.codec.frame import Frame, encode_frame, parse_single_frame
from bcapscope.protocol.tables.function_table import ID, function_by_name
from bcapscope.protocol.tables.hresult import CODE_BY_NAME
from bcapscope.protocol.variant_values import arguments_of, variant_of
from bcapscope.traffic.filter.tokens import with_nearest


def decode(data: bytes | bytearray | memoryview) -> Frame:
    """Decode the bytes of one frame.

    Damage after the header raises no exception: `Frame.problems` lists the damage, and the other attributes
    hold what could be read.

    Raises:
        RemoteProtocolError: The bytes are not a frame: they do not begin with SOH, or hold no whole header.
    """
    raw = bytes(data)
    item = parse_single_frame(raw)
    if isinstance(item, Frame):
        return item
    raise RemoteProtocolError(item.problems[0].reason, raw)


def encode(code: str | int, arguments: Sequence[object] = (), *, serial: int = 1, reserved: int = 0) -> bytes:
    """Return the bytes of a request or a reply.

    Args:
        code: For a request, the name of a function, such as ``"Robot_Execute"``, or its number. For a reply,
            the name of a result code, such as ``"S_OK"``, or its number, signed or unsigned.
        arguments: Python values. If `code` is the name of a function, all arguments of the function are
            required, and the function determines their types. If `code` is a number or a result code, None
            becomes VT_EMPTY, bool VT_BOOL, int VT_I4 (or VT_I8 if it is too large), float VT_R8, str VT_BSTR,
            bytes an array of VT_UI1, and a list an array. A `Variant` keeps its type.
        serial: Serial of the frame, from 0 to 65535.
        reserved: Reserved field; in a retry, the serial of an earlier attempt.

    Raises:
        InputError: No function and no result code has this name.
        LocalProtocolError: An argument does not fit its type, the number of arguments is wrong, or a number
            does not fit the header.
    """
    if isinstance(code, int):
        return encode_frame(serial, reserved, code, tuple(map(variant_of, arguments)))
    function = function_by_name(code)
    if function is not None:
        return encode_frame(serial, reserved, function.id, arguments_of(function, arguments))
    result = CODE_BY_NAME.get(code)
    if result is None:
        unknown = Message("frame.no-such-code", name=repr(code))
        raise InputError(with_nearest(unknown, code, [*ID, *CODE_BY_NAME]))
    return encode_frame(serial, reserved, result, tuple(map(variant_of, arguments)))
