"""Frames and arguments beside their bytes, written out by hand from the format's description.

The one table that packing, reading, streams and the fuzzer's corpus all start from. Layouts follow
orin_bcap C/src/bcap_common.c and Python bcapclient.py; version 1 framing follows keioku/bcap-python.
"""

from __future__ import annotations

import math
import zlib
from typing import NamedTuple

from bcapscope.protocol.codec.frame_content import Framing
from bcapscope.protocol.codec.variant import ARRAY, VT, Variant


class ArgumentPair(NamedTuple):
    """A value and the bytes of the argument that carries it, length field included."""

    name: str
    variant: Variant
    data: bytes


class FramePair(NamedTuple):
    """A sound frame's fields and its bytes."""

    name: str
    serial: int
    reserved: int
    code: int
    arguments: tuple[Variant, ...]
    framing: Framing
    data: bytes


class Damaged(NamedTuple):
    """A frame that is not as it should be.

    Attributes:
        problems: offset and code of each problem, in the order of the bytes.
        values: what the arguments still hold.
    """

    name: str
    data: bytes
    problems: tuple[tuple[int, str], ...]
    values: tuple[object, ...]


def _argument(name: str, variant: Variant, data: str) -> ArgumentPair:
    return ArgumentPair(name, variant, bytes.fromhex(data))


def _array(name: str, element: int, values: tuple[object, ...] | bytes, data: str) -> ArgumentPair:
    return _argument(name, Variant.array(element, values), data)  # type: ignore[arg-type]  # a table of literals


I4_256 = Variant(VT.I4, 256)
R8_PAIR = Variant.array(VT.R8, (1.0, 2.0))

ARGUMENTS: tuple[ArgumentPair, ...] = (
    _argument("EMPTY", Variant(VT.EMPTY, None), "06000000 0000 01000000"),
    _argument("EMPTY, count 0", Variant(VT.EMPTY, None, 0), "06000000 0000 00000000"),
    _argument("NULL", Variant(VT.NULL, None), "06000000 0100 01000000"),
    _argument("NULL, count 0", Variant(VT.NULL, None, 0), "06000000 0100 00000000"),
    _argument("I2", Variant(VT.I2, -2), "08000000 0200 01000000 FEFF"),
    _argument("I4", Variant(VT.I4, 0x01020304), "0A000000 0300 01000000 04030201"),
    _argument("I4 lowest", Variant(VT.I4, -(2**31)), "0A000000 0300 01000000 00000080"),
    _argument("R4", Variant(VT.R4, 1.5), "0A000000 0400 01000000 0000C03F"),
    _argument("R4 -0.0", Variant(VT.R4, -0.0), "0A000000 0400 01000000 00000080"),
    _argument("R4 NaN", Variant(VT.R4, math.nan), "0A000000 0400 01000000 0000C07F"),
    _argument("R4 infinity", Variant(VT.R4, math.inf), "0A000000 0400 01000000 0000807F"),
    _argument("R8", Variant(VT.R8, 1.0), "0E000000 0500 01000000 000000000000F03F"),
    _argument("R8 -0.0", Variant(VT.R8, -0.0), "0E000000 0500 01000000 0000000000000080"),
    _argument("R8 NaN", Variant(VT.R8, math.nan), "0E000000 0500 01000000 000000000000F87F"),
    _argument("R8 -infinity", Variant(VT.R8, -math.inf), "0E000000 0500 01000000 000000000000F0FF"),
    _argument("CY", Variant(VT.CY, -12345), "0E000000 0600 01000000 C7CFFFFFFFFFFFFF"),
    _argument("DATE 1970-01-01", Variant(VT.DATE, 25569.0), "0E000000 0700 01000000 0000000040F8D840"),
    _argument("BSTR empty", Variant(VT.BSTR, ""), "0A000000 0800 01000000 00000000"),
    _argument(
        "BSTR with a surrogate pair",
        Variant(VT.BSTR, "A\U0001f600B"),
        "12000000 0800 01000000 08000000 4100 3DD8 00DE 4200",
    ),
    _argument("BSTR with NUL", Variant(VT.BSTR, "a\0b"), "10000000 0800 01000000 06000000 6100 0000 6200"),
    _argument(
        "BSTR, a high surrogate alone", Variant(VT.BSTR, "\ud83d"), "0C000000 0800 01000000 02000000 3DD8"
    ),
    _argument(
        "BSTR, a low surrogate first",
        Variant(VT.BSTR, "\ude00x"),
        "0E000000 0800 01000000 04000000 00DE 7800",
    ),
    _argument("BSTR Japanese", Variant(VT.BSTR, "軸"), "0C000000 0800 01000000 02000000 F88E"),
    _argument("ERROR", Variant(VT.ERROR, -2147467259), "0A000000 0A00 01000000 05400080"),
    _argument("BOOL true", Variant(VT.BOOL, True), "08000000 0B00 01000000 FFFF"),
    _argument("BOOL false", Variant(VT.BOOL, False), "08000000 0B00 01000000 0000"),
    _argument("UI1", Variant(VT.UI1, 255), "07000000 1100 01000000 FF"),
    _argument("UI2", Variant(VT.UI2, 65534), "08000000 1200 01000000 FEFF"),
    _argument("UI4", Variant(VT.UI4, 4294967294), "0A000000 1300 01000000 FEFFFFFF"),
    _argument("I8", Variant(VT.I8, -(2**63)), "0E000000 1400 01000000 0000000000000080"),
    _argument("UI8", Variant(VT.UI8, 2**64 - 1), "0E000000 1500 01000000 FFFFFFFFFFFFFFFF"),
    _array("I2 array", VT.I2, (1, -1, 300), "0C000000 0220 03000000 0100 FFFF 2C01"),
    _array("I4 array of one", VT.I4, (7,), "0A000000 0320 01000000 07000000"),
    _array("R4 array", VT.R4, (1.0, -0.0), "0E000000 0420 02000000 0000803F 00000080"),
    _array("R8 array", VT.R8, (1.0, 2.0), "16000000 0520 02000000 000000000000F03F 0000000000000040"),
    _array("R8 array, empty", VT.R8, (), "06000000 0520 00000000"),
    _array("CY array", VT.CY, (1, -1), "16000000 0620 02000000 0100000000000000 FFFFFFFFFFFFFFFF"),
    _array("DATE array", VT.DATE, (0.0, 1.0), "16000000 0720 02000000 0000000000000000 000000000000F03F"),
    _array("BSTR array", VT.BSTR, ("", "xy"), "12000000 0820 02000000 00000000 04000000 7800 7900"),
    _array("BSTR array, empty", VT.BSTR, (), "06000000 0820 00000000"),
    _array("ERROR array", VT.ERROR, (0, -1), "0E000000 0A20 02000000 00000000 FFFFFFFF"),
    _array("BOOL array", VT.BOOL, (True, False, True), "0C000000 0B20 03000000 FFFF 0000 FFFF"),
    _array("BOOL array, empty", VT.BOOL, (), "06000000 0B20 00000000"),
    _array("UI1 array", VT.UI1, b"\x01\x04\x00", "09000000 1120 03000000 010400"),
    _array("UI1 array, empty", VT.UI1, b"", "06000000 1120 00000000"),
    _array("UI2 array", VT.UI2, (0, 65535), "0A000000 1220 02000000 0000 FFFF"),
    _array("UI4 array", VT.UI4, (1,), "0A000000 1320 01000000 01000000"),
    _array("I8 array", VT.I8, (-2,), "0E000000 1420 01000000 FEFFFFFFFFFFFFFF"),
    _array("UI8 array", VT.UI8, (2,), "0E000000 1520 01000000 0200000000000000"),
    _array("VARIANT array, empty", VT.VARIANT, (), "06000000 0C20 00000000"),
    _array(
        "VARIANT array",
        VT.VARIANT,
        (R8_PAIR, I4_256),
        "26000000 0C20 02000000 0520 02000000 000000000000F03F 0000000000000040 0300 01000000 00010000",
    ),
    _array(
        "VARIANT array of everything",
        VT.VARIANT,
        (
            Variant(VT.EMPTY, None, 0),
            Variant(VT.NULL, None),
            Variant(VT.BSTR, "J"),
            Variant(VT.BOOL, True),
            Variant.array(VT.UI1, b"\x09"),
            Variant.array(VT.BSTR, ("a",)),
            Variant.array(VT.VARIANT, (Variant.array(VT.VARIANT, ()), Variant(VT.I2, 1))),
            Variant(VT.UI1, 5),
        ),
        "54000000 0C20 08000000"
        " 0000 00000000"
        " 0100 01000000"
        " 0800 01000000 02000000 4A00"
        " 0B00 01000000 FFFF"
        " 1120 01000000 09"
        " 0820 01000000 02000000 6100"
        " 0C20 02000000 0C20 00000000 0200 01000000 0100"
        " 1100 01000000 05",
    ),
)

ARGUMENT_IDS = [pair.name for pair in ARGUMENTS]

HANDLE = Variant(VT.I4, 1)
_HANDLE = "0A000000 0300 01000000 01000000"
_SLV_CHANGE_MODE = (
    "24000000 0800 01000000 1A000000 7300 6C00 7600 4300 6800 6100 6E00 6700 6500 4D00 6F00 6400 6500"
)
_SLV_MOVE = "18000000 0800 01000000 0E000000 7300 6C00 7600 4D00 6F00 7600 6500"
_POSE = (179.0, -0.5, 0.0, 1.0, 2.0, 3.0, 4.0, 5.0)
_POSE_BYTES = (
    "46000000 0520 08000000 0000000000606640 000000000000E0BF 0000000000000000 000000000000F03F"
    " 0000000000000040 0000000000000840 0000000000001040 0000000000001440"
)


def _frame(
    name: str,
    head: tuple[int, int, int],
    arguments: tuple[Variant, ...],
    data: str,
    framing: Framing = Framing.PLAIN,
) -> FramePair:
    return FramePair(name, *head, arguments, framing, bytes.fromhex(data))


def _compressed(serial: int, inner: str) -> bytes:
    """Frame `inner` (function id, argument count, arguments) as version 1 does, compressed."""
    plain = bytes.fromhex(inner)
    packed = zlib.compress(plain)
    head = b"\x01" + (15 + len(packed)).to_bytes(4, "little") + serial.to_bytes(2, "little") + b"\x01\x00"
    return head + len(plain).to_bytes(4, "little") + packed + b"\x01\x04"


FRAMES: tuple[FramePair, ...] = (
    _frame("the smallest", (1, 0, 2), (), "01 10000000 0100 0000 02000000 0000 04"),
    _frame("a reply, E_FAIL", (65535, 65534, 0x80004005), (), "01 10000000 FFFF FEFF 05400080 0000 04"),
    _frame(
        "slvChangeMode of 2009",
        (5, 0, 64),
        (HANDLE, Variant(VT.BSTR, "slvChangeMode"), Variant(VT.I2, 2)),
        f"01 52000000 0500 0000 40000000 0300 {_HANDLE} {_SLV_CHANGE_MODE} 08000000 0200 01000000 0200 04",
    ),
    _frame(
        "slvMove of eight doubles",
        (4711, 4711, 64),
        (HANDLE, Variant(VT.BSTR, "slvMove"), Variant.array(VT.R8, _POSE)),
        f"01 84000000 6712 6712 40000000 0300 {_HANDLE} {_SLV_MOVE} {_POSE_BYTES} 04",
    ),
    _frame(
        "a reply with a pose",
        (4711, 0, 0),
        (Variant.array(VT.R8, _POSE),),
        f"01 5A000000 6712 0000 00000000 0100 {_POSE_BYTES} 04",
    ),
    _frame(
        "a retry of serial 1",
        (2, 1, 4),
        (HANDLE,),
        f"01 1E000000 0200 0100 04000000 0100 {_HANDLE} 04",
    ),
    _frame(
        "serial line, no argument",
        (1, 0, 2),
        (),
        "01 12000000 0100 0000 02000000 0000 5A7D 04",
        Framing.SERIAL_LINE,
    ),
    _frame(
        "serial line, I2",
        (2, 0, 0),
        (Variant(VT.I2, 2),),
        "01 1E000000 0200 0000 00000000 0100 08000000 0200 01000000 0200 81AA 04",
        Framing.SERIAL_LINE,
    ),
    _frame(
        "version 1",
        (3, 1, 4),
        (HANDLE,),
        f"01 1F000000 0300 0100 04000000 0100 {_HANDLE} 00 04",
        Framing.VERSION_1,
    ),
    FramePair(
        "version 1, zlib",
        9,
        1,
        64,
        (HANDLE, Variant(VT.BSTR, "slvMove"), Variant.array(VT.R8, _POSE)),
        Framing.VERSION_1_ZLIB,
        _compressed(9, f"40000000 0300 {_HANDLE} {_SLV_MOVE} {_POSE_BYTES}"),
    ),
)

FRAME_IDS = [pair.name for pair in FRAMES]


def plain_frame(arguments: str, argc: int = 1) -> bytes:
    """Put a frame around the hex bytes of arguments, whatever they are."""
    data = bytes.fromhex(arguments)
    return (
        b"\x01"
        + (16 + len(data)).to_bytes(4, "little")
        + bytes(8)
        + argc.to_bytes(2, "little")
        + data
        + b"\x04"
    )


def values_of(variants: tuple[Variant, ...]) -> tuple[object, ...]:
    """Take the bare values out of variants, at every depth."""
    return tuple(
        values_of(variant.value)  # type: ignore[arg-type]  # a VARIANT array holds variants
        if variant.vt == ARRAY | VT.VARIANT
        else variant.value
        for variant in variants
    )


def bare(variant: Variant) -> Variant:
    """Give the type as a plain number at every depth, as it is read, so that texts of two can be compared.

    Texts, since NaN equals nothing and -0.0 equals 0.0.
    """
    value = variant.value
    if variant.vt == ARRAY | VT.VARIANT:
        value = tuple(bare(item) for item in value)  # type: ignore[arg-type, union-attr]  # it holds variants
    return Variant(int(variant.vt), value, variant.elements)


_SEVEN = "0A000000 0300 01000000 07000000"


def _damaged(
    name: str, arguments: str, problems: tuple[tuple[int, str], ...], *values: object, argc: int = 1
) -> Damaged:
    return Damaged(name, plain_frame(arguments, argc), problems, values)


DAMAGED: tuple[Damaged, ...] = (
    Damaged(
        "length too large", bytes.fromhex("01 11000000 0100 0000 02000000 0000 04"), ((1, "length"),), ()
    ),
    Damaged(
        "length too small", bytes.fromhex("01 0F000000 0100 0000 02000000 0000 04"), ((1, "length"),), ()
    ),
    Damaged("no EOT", bytes.fromhex("01 10000000 0100 0000 02000000 0000 05"), ((15, "eot"),), ()),
    Damaged("a header alone", bytes.fromhex("01 0F000000 0100 0000 02000000 0000"), ((15, "eot"),), ()),
    _damaged("more arguments counted", _SEVEN, ((29, "argc"),), 7, argc=2),
    _damaged("most arguments counted", "", ((15, "argc"),), argc=65535),
    _damaged("bytes left over", _SEVEN + "010203", ((29, "left-over"),), 7),
    _damaged("one byte left over", _SEVEN + "00", ((29, "left-over"),), 7),
    _damaged("two bytes left over that are no CRC", _SEVEN + "1234", ((29, "left-over"),), 7),
    _damaged("an argument not counted", _SEVEN, ((15, "left-over"),), argc=0),
    _damaged("count 3 on a scalar", "0A000000 0300 03000000 07000000", ((21, "count"),), 7),
    _damaged("count 0 on a string", "0C000000 0800 00000000 02000000 4100", ((21, "count"),), "A"),
    _damaged("argument length too small", "09000000 0300 01000000 07000000", ((15, "argument-length"),), 7),
    _damaged(
        "argument length too large",
        f"FFFFFFFF 0300 01000000 07000000 {_SEVEN}",
        ((15, "argument-length"),),
        7,
        7,
        argc=2,
    ),
    _damaged("a number cut short", "08000000 0300 01000000 0100", ((25, "data"),), None),
    _damaged("a string without length", "08000000 0800 01000000 0100", ((25, "data"),), None),
    _damaged("an odd string", "0D000000 0800 01000000 03000000 4100 42", ((25, "string"),), "A"),
    _damaged(
        "a string of 4 GiB", "0C000000 0800 01000000 FFFFFFFF 4100", ((25, "string"), (25, "data")), "A"
    ),
    _damaged("an array of 4 GiB", "08000000 1120 FFFFFFFF 6162", ((27, "data"),), b"ab"),
    _damaged("an array of 32 GiB", "0E000000 0520 FFFFFFFF 000000000000F03F", ((33, "data"),), (1.0,)),
    _damaged(
        "4 billion strings", "10000000 0820 FFFFFFFF 00000000 02000000 4100", ((35, "data"),), ("", "A")
    ),
    _damaged("4 billion VARIANTs", "10000000 0C20 FFFFFFFF 0300 01000000 07000000", ((35, "data"),), (7,)),
    _damaged(
        "a string beyond its argument",
        f"0C000000 0800 01000000 40000000 4100 {_SEVEN}",
        ((25, "data"),),
        "A",
        7,
        argc=2,
    ),
    _damaged(
        "an array beyond its argument",
        f"0E000000 0520 04000000 000000000000F03F {_SEVEN}",
        ((33, "data"),),
        (1.0,),
        7,
        argc=2,
    ),
    _damaged(
        "an array without a byte of its own",
        f"06000000 1120 FFFFFFFF {_SEVEN}",
        ((25, "data"),),
        b"",
        7,
        argc=2,
    ),
    _damaged(
        "two arrays beyond their arguments",
        f"07000000 1120 40000000 61 07000000 1120 04000000 62 {_SEVEN}",
        ((26, "data"), (37, "data")),
        b"a",
        b"b",
        7,
        argc=3,
    ),
    _damaged(
        "an array that takes from the next argument",
        f"0E000000 1420 02000000 0000000000000000 {_SEVEN}",
        ((15, "argument-length"), (41, "argc")),
        (0, 0x000100030000000A),
        argc=2,
    ),
    _damaged(
        "an unknown type",
        f"0A000000 0900 01000000 01020304 {_SEVEN}",
        ((19, "type"),),
        b"\1\2\3\4",
        7,
        argc=2,
    ),
    _damaged(
        "an unknown type without usable length",
        f"FFFFFFFF 0900 01000000 01020304 {_SEVEN}",
        ((19, "type"),),
        bytes.fromhex(f"01020304 {_SEVEN}"),
        argc=2,
    ),
    _damaged("an array of an unknown type", "08000000 0920 02000000 0102", ((19, "type"),), b"\1\2"),
    _damaged("an array of EMPTY", "06000000 0020 02000000", ((19, "type"),), b""),
    _damaged("VARIANT without ARRAY", "06000000 0C00 01000000", ((19, "type"),), b""),
    _damaged(
        "an unknown type inside a VARIANT array",
        "16000000 0C20 03000000 0300 01000000 07000000 0900 01000000",
        ((35, "type"),),
        (7, b""),
    ),
    _damaged(
        "a string inside a VARIANT array that takes all the rest",
        f"16000000 0C20 01000000 0800 01000000 40000000 4200 4300 4400 {_SEVEN}",
        ((31, "data"),),
        ("BCD",),
        7,
        argc=2,
    ),
)

DAMAGED_IDS = [sample.name for sample in DAMAGED]


def nested(depth: int) -> bytes:
    """Make a frame of `depth` VARIANT arrays, each inside the one before, the last one empty."""
    data = b"\x0c\x20\x01\x00\x00\x00" * (depth - 1) + b"\x0c\x20\x00\x00\x00\x00"
    return plain_frame((len(data).to_bytes(4, "little") + data).hex())
