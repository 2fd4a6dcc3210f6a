"""Handles: used wrongly, and never given back."""

from __future__ import annotations

from tests.analysis.plays.scene import Scene
from tests.analysis.scenes import CONTROLLER, Play, Story, good
from tests.samples.calls import i4, text

_E_HANDLE, _MAX = 0x80070006, 0x80000905


def _gets_variables(count: int, releases: bool, ends: int = 0) -> Play:
    def play(story: Story) -> None:
        client = story.client()
        client.open()
        at = 50.0
        for number in range(count):
            handle = i4(10 + number)
            client.call(at, "Controller_GetVariable", CONTROLLER, text("I1"), text(""), result=handle)
            if releases:
                client.call(at + 2, "Variable_Release", handle)
            at += 5
        if ends:
            client.call(at, "Controller_GetVariable", CONTROLLER, text("I1"), text(""), code=ends)
        client.close(at + 5)

    return play


def _uses_handle(handle: int, releases: bool = False, code: int = _E_HANDLE) -> Play:
    def play(story: Story) -> None:
        client = story.client()
        client.open()
        client.call(50, "Controller_GetVariable", CONTROLLER, text("I1"), text(""), result=i4(10))
        if releases:
            client.call(55, "Variable_Release", i4(10))
        client.call(60, "Variable_GetValue", i4(handle), code=code, result=None if code else i4(5))
        client.close(70)

    return play


def _uses_anothers(story: Story) -> None:
    first = story.client()
    first.open()
    first.call(50, "Controller_GetVariable", CONTROLLER, text("I1"), text(""), result=i4(10))
    first.call(60, "Variable_GetValue", i4(10), result=i4(5))
    second = story.client(50002)
    second.open(100)
    second.call(300, "Variable_GetValue", i4(10), code=_E_HANDLE)
    second.close(400)
    first.close(500)


SCENES = (
    Scene(
        "handle-leak",
        _gets_variables(30, releases=False),
        (47, 48),
        ("held 30 handles of the Variable 'I1' at once",),
        _gets_variables(30, releases=True),
    ),
    Scene(
        "bad-handle",
        _uses_handle(10, releases=True),
        (11, 12, 13, 14),
        ("E_HANDLE 0x80070006", "Variable_Release 6 released handle 10 at 0.055 s"),
        _uses_handle(10, code=0),
    ),
    Scene(
        "bad-handle",
        _uses_handle(2),
        (11, 12),
        ("handle 2 belongs to the Robot 'Arm', not to a Variable",),
        good,
    ),
    Scene("bad-handle", _uses_handle(99), (11, 12), ("no reply that gave handle 99 to this client",), good),
    Scene(
        "bad-handle",
        _uses_anothers,
        (21, 22),
        ("handle 10 was given to client 192.168.0.10:50001 (UDP), and handles belong to one connection",),
        good,
    ),
    Scene(
        "too-many-objects",
        _gets_variables(30, releases=False, ends=_MAX),
        (69, 70),
        ("E_MAX_OBJECT 0x80000905",),
        _gets_variables(30, releases=False),
        "handle-leak",
    ),
)
