"""Requests that energise or move a robot, in every disguise that may slip through a guard.

All of them are drawn from a generator of random numbers, so that a test shrinks them and an attack repeats
them.
"""

from __future__ import annotations

import struct
import zlib
from collections.abc import Callable
from random import Random
from typing import NamedTuple

from bcapscope.protocol.codec.frame import Framing, encode_frame
from bcapscope.protocol.codec.variant import EMPTY, VT, Variant
from bcapscope.protocol.tables.call_effect import CallEffect
from bcapscope.protocol.tables.command_catalogue import commands_of
from bcapscope.protocol.tables.function_table import FUNCTIONS, ID, Function

_EXECUTES = (17, 28, 64, 87)
_HEADER = 15
_BODY = 9

_SAMPLES = {
    "VT_I4": (Variant(VT.I4, 1), Variant(VT.I4, 0)),
    "VT_BSTR": (Variant(VT.BSTR, ""), Variant(VT.BSTR, "@E J(0,0,90,0,90,0)")),
    "VARIANT": (
        EMPTY,
        Variant(VT.I4, 0x202),
        Variant.array(VT.R8, (0.0, 0.0, 90.0, 0.0, 90.0, 0.0, 0.0, 0.0)),
    ),
}
_ON = (
    ("Motor", Variant(VT.I4, 1)),
    ("Motor", Variant.array(VT.I4, (1, 0))),
    ("Motor", Variant(VT.BSTR, "1")),
    ("slvChangeMode", Variant(VT.I4, 0x102)),
    ("TakeArm", Variant.array(VT.I4, (0, 0))),
    ("ExtSpeed", Variant.array(VT.R8, (40.0, 40.0, 40.0))),
    ("slvMove", Variant.array(VT.R8, (0.0, 0.0, 90.0, 0.0, 90.0, 0.0, 0.0, 0.0))),
)


class Ends(NamedTuple):
    """Handles that the requests are made of."""

    controller: int
    robot: int
    servo_on: int
    """Of the robot's variable @SERVO_ON."""


class Request(NamedTuple):
    """A request before it is encoded."""

    function_id: int
    arguments: tuple[Variant, ...]

    def encoded(self, reserved: int = 0, framing: Framing = Framing.PLAIN) -> bytes:
        """Encode it with a serial that tells nothing."""
        return encode_frame(5, reserved, self.function_id, self.arguments, framing)


Disguise = Callable[[Random, Ends], bytes]


def dangerous(rng: Random, ends: Ends) -> Request:
    """Draw a request that energises or moves."""
    kind = rng.randrange(4)
    if kind == 0:
        name, parameter = rng.choice(_ON)
        return Request(64, (Variant(VT.I4, ends.robot), Variant(VT.BSTR, name), parameter))
    if kind == 1:
        return Request(ID["Variable_PutValue"], (Variant(VT.I4, ends.servo_on), Variant(VT.BOOL, True)))
    if kind == 2:
        pose = Variant(VT.BSTR, "@E J(10,0,90,0,90,0)")
        return Request(
            ID["Robot_Move"], (Variant(VT.I4, ends.robot), Variant(VT.I4, 1), pose, Variant(VT.BSTR, "NEXT"))
        )
    return _any(rng, ends, lambda effect: effect >= CallEffect.ENERGISES)


def harmless(rng: Random, ends: Ends) -> Request:
    """Draw a request that only reads, with an argument that takes any value."""
    if rng.random() < 0.5:
        return _any(rng, ends, lambda effect: effect is CallEffect.READS)
    handle = Variant(VT.I4, ends.controller)
    return Request(ID["Controller_GetVariable"], (handle, Variant(VT.BSTR, "I1"), Variant(VT.BSTR, "")))


def stop(rng: Random, ends: Ends) -> Request:
    """Draw a request that stops something or releases a handle that nobody has."""
    handle, gone = Variant(VT.I4, ends.robot), Variant(VT.I4, 0x7FFFFFFF)
    none = Variant(VT.BSTR, "")
    return rng.choice(
        (
            Request(ID["Robot_Halt"], (handle, none)),
            Request(ID["Robot_Hold"], (handle, none)),
            Request(ID["Task_Stop"], (gone, Variant(VT.I4, 1), none)),
            Request(ID["Command_Cancel"], (gone,)),
            Request(ID["Variable_Release"], (gone,)),
            Request(17, (Variant(VT.I4, ends.controller), Variant(VT.BSTR, "HandStop"), EMPTY)),
            Request(64, (handle, Variant(VT.BSTR, "slvChangeMode"), Variant(VT.I2, 0))),
        )
    )


def _any(rng: Random, ends: Ends, wanted: Callable[[CallEffect], bool]) -> Request:
    """Draw any command of the catalogue with that effect."""
    listed = [each for function_id in _EXECUTES for each in commands_of(function_id) if wanted(each.effect)]
    each = rng.choice(listed)
    handle = ends.robot if each.function_id == 64 else ends.controller
    parameter = rng.choice((EMPTY, Variant(VT.I4, 1), Variant.array(VT.I4, (1, 0))))
    return Request(each.function_id, (Variant(VT.I4, handle), Variant(VT.BSTR, each.name), parameter))


def _function(rng: Random, ends: Ends) -> bytes:
    """Any function that is neither reading nor a stop, with plausible arguments."""
    named = [each for each in FUNCTIONS.values() if _is_worth_a_try(each)]
    function = rng.choice(named)
    arguments = [rng.choice(_SAMPLES.get(param.type, (EMPTY,))) for param in function.params]
    if arguments and function.takes_handle:
        arguments[0] = Variant(VT.I4, rng.choice(ends))
    return Request(function.id, tuple(arguments)).encoded()


def _is_worth_a_try(function: Function) -> bool:
    ends_all = function.name in (
        "Service_Start",
        "Service_Stop",
        "Controller_Connect",
        "Controller_Disconnect",
    )
    return not ends_all and not function.name.partition("_")[2].startswith("Get") and not function.releases


# Disguises.


def plain(rng: Random, ends: Ends) -> bytes:
    """No disguise, in any framing."""
    framing = rng.choice(list(Framing))
    return dangerous(rng, ends).encoded(1 if "version" in framing.value else rng.choice((0, 1, 2)), framing)


def respelt(rng: Random, ends: Ends) -> bytes:
    """The command's name in another spelling."""
    name, parameter = rng.choice(_ON)
    spellings = (
        name.swapcase(),
        name.upper(),
        f" {name} ",
        f"{name}\0",
        f"{name}\0CurJnt",
        f"CurJnt\0{name}",
        f"\t{name}",
        name.replace("s", "ſ"),
        f"{name};CurJnt",
    )
    handle = Variant(VT.I4, ends.robot)
    return Request(64, (handle, Variant(VT.BSTR, rng.choice(spellings)), parameter)).encoded()


def retyped(rng: Random, ends: Ends) -> bytes:
    """The command's name, or the handle, as another type."""
    name, parameter = rng.choice(_ON)
    names = (
        Variant.array(VT.BSTR, (name,)),
        Variant.array(VT.VARIANT, (Variant(VT.BSTR, name),)),
        Variant.array(VT.UI1, name.encode("utf-16-le")),
    )
    handle = rng.choice((Variant(VT.I4, ends.robot), Variant(VT.I2, ends.robot & 0x7FFF)))
    return Request(64, (handle, rng.choice(names), parameter)).encoded()


def with_more_arguments(rng: Random, ends: Ends) -> bytes:
    """A stop, or a reading, followed by what would move."""
    first = rng.choice((stop, harmless))(rng, ends)
    more = (*dangerous(rng, ends).arguments[1:], Variant(VT.I4, 0x102))
    return Request(first.function_id, (*first.arguments, *more)).encoded()


def by_lengths(rng: Random, ends: Ends) -> bytes:
    """One command by the values of the arguments, another by their lengths."""
    seen, hidden = ["CurJnt", rng.choice(_ON)[0]][:: rng.choice((1, -1))]
    handle = _packed(Variant(VT.I4, ends.robot))
    shown, inner, parameter = (
        _packed(each) for each in (Variant(VT.BSTR, seen), Variant(VT.BSTR, hidden), rng.choice(_ON)[1])
    )
    covering = struct.pack("<I", len(handle) - 4 + len(shown)) + handle[4:]
    return resized(encode_frame(5, 0, 64)[:13] + b"\x03\x00" + covering + shown + inner + parameter + b"\x04")


def left_over(rng: Random, ends: Ends) -> bytes:
    """A whole or broken frame behind the arguments of a harmless one."""
    outer = rng.choice((stop, harmless))(rng, ends).encoded()
    inner = dangerous(rng, ends).encoded()
    inner = inner[: rng.choice((None, -1, -9, 20))]
    raw = outer[:-1] + bytes(rng.randrange(3)) + inner + rng.choice((b"\x04", b"\x01\x04", b""))
    return resized(raw) if rng.random() < 0.7 else raw


def recounted(rng: Random, ends: Ends) -> bytes:
    """Another count of arguments, another length, another first or last byte."""
    raw = bytearray(rng.choice((stop, harmless, dangerous))(rng, ends).encoded())
    change = rng.randrange(4)
    if change == 0:
        raw[13:_HEADER] = struct.pack("<H", rng.choice((0, 1, 2, 4, 376, 0xFFFF)))
    elif change == 1:
        raw[1:5] = struct.pack("<I", max(0, len(raw) + rng.choice((-9, -1, 1, 16, 1 << 20))))
    elif change == 2:
        raw[0] = rng.choice((0, 2, 4))
    else:
        raw[-1] = rng.choice((0, 1, 5))
    return bytes(raw)


def in_a_row(rng: Random, ends: Ends) -> bytes:
    """Several frames at once, with garbage between them."""
    pieces = []
    for _ in range(rng.randrange(2, 5)):
        pieces.append(rng.choice((stop, harmless, dangerous))(rng, ends).encoded())
        pieces.append(rng.choice((b"", b"\x00", b"\x01", b"\x04", b"\x01\x10\x00\x00\x00", rng.randbytes(6))))
    return b"".join(pieces)


def compressed(rng: Random, ends: Ends) -> bytes:
    """A stop or a reading by its number, around compressed bytes that move."""
    inner = dangerous(rng, ends).encoded()[_BODY:-1]
    number = rng.choice((stop, harmless))(rng, ends).function_id
    packed = zlib.compress(inner, rng.choice((0, 1, 6, 9)))
    packed += bytes(rng.choice((0, 0, 4)))
    mode = rng.choice((b"\x01", b"\x01", b"\x00", b""))
    head = b"\x01" + bytes(4) + struct.pack("<HHI", 5, rng.choice((0, 1, 1, 2, 0xFFFF)), number)
    return resized(head + packed + mode + b"\x04")


def both_ways(rng: Random, ends: Ends) -> bytes:
    """A reading when it is unpacked, with room for the 376 arguments of a plain frame."""
    inner = rng.choice((stop, harmless))(rng, ends).encoded()[_BODY:-1]
    stored = zlib.compress(inner, 0)
    body = stored[:2] + b"\x00\x00\x00\xff\xff" * 800 + stored[2:]
    number = rng.choice((len(inner), dangerous(rng, ends).function_id))
    return resized(b"\x01" + bytes(4) + struct.pack("<HHI", 5, 1, number) + body + b"\x01\x04")


def as_data(rng: Random, ends: Ends) -> bytes:
    """A whole frame inside the value of an argument."""
    outer, inner = harmless(rng, ends), dangerous(rng, ends).encoded()
    padded = inner + bytes(len(inner) % 2)
    text = padded.decode("utf-16-le", "surrogatepass")
    value = rng.choice((Variant.array(VT.UI1, inner), Variant(VT.BSTR, text)))
    return Request(outer.function_id, (*outer.arguments[:-1], value)).encoded()


def creating(rng: Random, ends: Ends) -> bytes:
    """A file that is created by asking for its handle."""
    option = rng.choice(("@Create=1", "@IFNOTMEMBER,@create=1", "x @CREATE"))
    values = (Variant(VT.I4, ends.controller), Variant(VT.BSTR, "a.pcs"), Variant(VT.BSTR, option))
    return Request(ID["Controller_GetFile"], values).encoded()


DISGUISES: tuple[Disguise, ...] = (
    *(plain, respelt, retyped, with_more_arguments, by_lengths, left_over, recounted, in_a_row, compressed),
    *(both_ways, as_data, creating, _function),
)


def evasion(rng: Random, ends: Ends) -> tuple[str, bytes]:
    """Draw a disguised request and the name of its disguise; one in four has a few bytes changed."""
    disguise = rng.choice(DISGUISES)
    raw = bytearray(disguise(rng, ends))
    if rng.random() < 0.25:
        for _ in range(rng.randrange(1, 4)):
            raw[rng.randrange(len(raw))] = rng.choice((0, 1, 4, 0x78, 0xFF, rng.randrange(256)))
    return disguise.__name__.strip("_"), bytes(raw)


def resized(raw: bytes) -> bytes:
    """Give a frame the length that it has."""
    return raw[:1] + struct.pack("<I", len(raw)) + raw[5:]


def _packed(value: Variant) -> bytes:
    """Encode one argument, its length first."""
    return encode_frame(5, 0, 64, (value,))[_HEADER:-1]
