"""A short conversation in which everything happens that a renderer has to show."""

from __future__ import annotations

import struct
import zlib
from collections.abc import Iterator

from bcapscope.protocol.codec.frame import Frame, Framing, Malformed, encode_frame, parse_datagram
from bcapscope.protocol.codec.variant import VT, Variant
from bcapscope.traffic.call_kind import CallKind, call_kind_of
from bcapscope.traffic.observation import (
    SERVER_PORT,
    Conversation,
    Direction,
    Endpoint,
    Flow,
    Observation,
    Transport,
)
from tests.samples.problems import problem_of

START = 1_700_000_000_123_456_000
ROBOT = Variant(VT.I4, 1)
JOINTS = Variant.array(VT.R8, (0.0, 45.5, -90.0, 0.1, 1e-9, 180.0, 0.0, 0.0))
HOSTILE = "\x1b[2J\x9b31m\u202egnp\u2028\n\r\t\0\ud800\"'<b>[/foo]=cmd|' /C calc'!A0"
"""What a terminal, a table, a page or a markup language would obey."""

_CONVERSATION = Conversation(
    Endpoint("10.0.0.2", 50001), Endpoint("fe80::1%eth0", 5007), Transport.UDP, SERVER_PORT
)
FLOWS = {direction: Flow(_CONVERSATION, direction) for direction in Direction}


def observe(
    item: Frame | Malformed, direction: Direction = Direction.REQUEST, number: int = 1
) -> Observation:
    """See an item, 8 ms after the one before."""
    time = START + 8_000_000 * (number - 1)
    return Observation(number, time, time, FLOWS[direction], item, number)


def _execute(command: str, parameter: Variant) -> bytes:
    return encode_frame(5, 5, 64, (ROBOT, Variant(VT.BSTR, command), parameter))


def _everything() -> Variant:
    values = (
        Variant(VT.EMPTY, None),
        Variant(VT.NULL, None),
        Variant(VT.I2, -2),
        Variant(VT.R4, 0.1),
        Variant(VT.CY, 125000),
        Variant(VT.DATE, 39965.5),
        Variant(VT.BSTR, "軸 １"),
        Variant(VT.ERROR, -2147467259),
        Variant(VT.BOOL, True),
        Variant(VT.UI8, 2**64 - 1),
        Variant.array(VT.UI1, bytes(range(20))),
        Variant.array(VT.BOOL, (True, False)),
        Variant.array(VT.BSTR, ("a", "")),
        Variant.array(VT.VARIANT, (Variant.array(VT.R4, (1.5,)),)),
        Variant.array(VT.I4, ()),
    )
    return Variant.array(VT.VARIANT, values)


def _broken() -> bytes:
    """A nested array that promises more strings than there are, and an EOT that is none."""
    inner = struct.pack("<HIHII", VT.I4 | 0x2000, 1, 7, 0, 0)[:10] + struct.pack(
        "<HII", VT.BSTR | 0x2000, 9, 2
    )
    value = struct.pack("<HI", VT.VARIANT | 0x2000, 2) + inner + b"a\x00"
    argument = len(value).to_bytes(4, "little") + value
    return struct.pack("<BIHHIH", 1, 99, 6, 0, 102, 1) + argument + b"\x05"


def _compressed() -> bytes:
    """A version 1 frame whose compression is the same with every zlib: none, in the form of one."""
    inner = encode_frame(0, 0, 64, (ROBOT, Variant(VT.BSTR, "slvMove"), JOINTS))[9:-1]
    packed = zlib.compress(inner, 0)
    return struct.pack("<BIHHI", 1, 15 + len(packed), 11, 1, len(inner)) + packed + b"\x01\x04"


def _items() -> Iterator[tuple[Direction, bytes | Malformed]]:
    ask, answer = Direction.REQUEST, Direction.RESPONSE
    yield ask, encode_frame(1, 0, 1, (Variant(VT.BSTR, ",WDT=400"),))
    yield answer, encode_frame(1, 0, 0)
    yield ask, _execute("slvMove", JOINTS)
    yield answer, encode_frame(5, 0, 0, (JOINTS,))
    yield answer, encode_frame(5, 0, 0x83500121)
    yield ask, _execute(HOSTILE, Variant(VT.BSTR, HOSTILE))
    yield ask, encode_frame(9, 0, 102, (ROBOT, _everything()))
    yield ask, encode_frame(10, 0, 102, (ROBOT, Variant.array(VT.I2, tuple(range(100)))))
    yield ask, _compressed()
    yield ask, encode_frame(12, 0, 4, (ROBOT,), Framing.SERIAL_LINE)
    yield ask, _broken()
    yield ask, encode_frame(13, 0, 4, (ROBOT,))[:22]
    yield ask, encode_frame(14, 0, 200)
    yield ask, b"=HELLO\x1b"
    yield ask, Malformed(b"", (problem_of(0, "gap", "120 bytes of the stream are missing"),), 120)


def scenes() -> Iterator[tuple[Observation, CallKind | None]]:
    """Yield all that was seen, each with what it asks or answers."""
    call_kind: CallKind | None = None
    for number, (direction, raw) in enumerate(_items(), 1):
        (item,) = (raw,) if isinstance(raw, Malformed) else parse_datagram(raw)
        if isinstance(item, Malformed):
            call_kind = None
        elif direction is Direction.REQUEST:
            call_kind = call_kind_of(item)
        yield observe(item, direction, number), call_kind
