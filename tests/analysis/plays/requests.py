"""Requests whose arguments or command are not what the controller takes."""

from __future__ import annotations

from bcapscope.protocol.codec.variant import Variant
from tests.analysis.plays.scene import Scene
from tests.analysis.scenes import HOME, Play, Story, good
from tests.samples.calls import i4, r4s, r8s, text

_INVALID, _UNKNOWN = 0x80070057, 0x80010005


def _executes(command: str, parameter: Variant, code: int) -> Play:
    def play(story: Story) -> None:
        client = story.client()
        client.open()
        client.execute(30, command, parameter, code=code)
        client.close(40)

    return play


def _one_point(mode: Variant, point: Variant) -> Play:
    def play(story: Story) -> None:
        client = story.client()
        client.open()
        client.ready()
        client.execute(40, "slvChangeMode", mode)
        client.execute(50, "slvMove", point, point)
        client.leave(60)

    return play


def _mode_then(odd: Variant, command: str, parameter: Variant) -> Play:
    """A mode of an odd type, which is refused, and soon after it a command that is refused as well."""

    def play(story: Story) -> None:
        client = story.client()
        client.open()
        client.execute(30, "slvChangeMode", odd, code=_INVALID)
        client.execute(40, command, parameter, code=_INVALID)
        client.close(60)

    return play


_POINT = r8s(*HOME)

SCENES = (
    Scene(
        "format-refused",
        _executes("slvSendFormat", i4(0x120), _INVALID),
        (9, 10),
        ("0x120 requests hand I/O (0x020) and mini I/O (0x100)",),
        _executes("slvSendFormat", i4(0x20), 0),
    ),
    Scene(
        "unknown-command",
        _executes("slvChangeMod", i4(2), _UNKNOWN),
        (9, 10),
        ("slvChangeMod 5 of your client", "perhaps slvChangeMode was meant"),
        _executes("slvChangeMode", i4(0), 0),
    ),
    Scene(
        "argument-refused",
        _executes("TakeArm", i4(0), _INVALID),
        (9, 10),
        (
            "E_INVALIDARG 0x80070057",
            "VT_I4 was sent, but TakeArm takes one of VT_I4|VT_ARRAY, VT_EMPTY, VT_BSTR",
        ),
        _executes("TakeArm", i4(0), 0),
    ),
    Scene(
        "argument-refused",
        _mode_then(text("514"), "TakeArm", i4(0)),
        (11, 12),
        ("TakeArm 6 of your client",),
        _mode_then(text("514"), "slvChangeMode", text("x")),
    ),
    Scene(
        "unusual-argument",
        _one_point(text("514"), _POINT),
        (13, 14),
        ("mode '514' has the type VT_BSTR",),
        good,
    ),
    Scene(
        "unusual-argument",
        _one_point(i4(0x202), r8s(*HOME[:6])),
        (15, 16),
        ("set point has 6 elements",),
        good,
    ),
    Scene(
        "unusual-argument",
        _one_point(i4(0x202), r4s(*HOME)),
        (15, 16),
        ("set point has the type VT_R4|VT_ARRAY",),
        good,
    ),
)
