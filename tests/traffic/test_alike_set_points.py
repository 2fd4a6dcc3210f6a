"""Only set points that differ in serial, reserved and numbers are alike."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

import pytest

from bcapscope.protocol.codec.frame import Frame, encode_frame
from bcapscope.protocol.codec.variant import VT, Variant
from bcapscope.traffic.alike_set_points import AlikeSetPoints
from bcapscope.traffic.call import Call
from bcapscope.traffic.observation import Direction
from tests.samples.problems import problem_of
from tests.traffic.playbook import (
    EXECUTE,
    MOVE,
    POSE,
    Client,
    Script,
    calls_of,
    execute,
    i4,
    r8s,
    slv_move,
    text,
)


def call(write: Callable[[Client], object]) -> Call:
    script = Script()
    write(script.client())
    (found,) = calls_of(script.track())
    return found


def point(
    request: tuple[int, tuple[Variant, ...]] = MOVE, code: int = 0, result: Variant = POSE, serial: int = 7
) -> Call:
    def write(client: Client) -> None:
        client.ask(0, serial, 0, request)
        client.reply(1, serial, 0, code, result)

    return call(write)


def begun() -> AlikeSetPoints:
    alike = AlikeSetPoints()
    assert not alike.continues(point())
    alike.on_other_call(point())
    return alike


def test_serial_and_numbers_may_differ() -> None:
    assert begun().continues(point(slv_move(-3.5, 1e9), result=r8s(0.0, 5.0), serial=500))


def test_the_replies_may_be_seen_with_other_serials_in_reserved() -> None:
    def write(client: Client) -> None:
        client.ask(0, 9, 9, MOVE)
        client.reply(1, 9, 9, 0, POSE)

    assert begun().continues(call(write))


def retried(client: Client) -> None:
    client.ask(0, 7, 0, MOVE)
    client.ask(2, 8, 7, MOVE)
    client.reply(3, 8, 0, 0, POSE)


def only_a_retry(client: Client) -> None:
    client.ask(2, 8, 7, MOVE)
    client.reply(3, 8, 0, 0, POSE)


def cut(client: Client, direction: Direction) -> None:
    problem = problem_of(0, "cut", "the capture kept less")
    frames = {
        Direction.REQUEST: encode_frame(7, 0, *MOVE),
        Direction.RESPONSE: encode_frame(7, 0, 0, (POSE,)),
    }
    for each, raw in frames.items():
        client.see(1, each, Frame(raw, problem if each is direction else None))


def damaged(client: Client, direction: Direction) -> None:
    """Send frames of which one does not end with EOT."""
    for each, raw in (
        (Direction.REQUEST, encode_frame(7, 0, *MOVE)),
        (Direction.RESPONSE, encode_frame(7, 0, 0, (POSE,))),
    ):
        client.see(1, each, Frame(raw[:-1] + b"\x05" if each is direction else raw))


@pytest.mark.parametrize(
    "other",
    [
        point(slv_move(1.0, 2.0, 3.0)),
        point(result=r8s(1.0)),
        point((EXECUTE, (i4(2), text("slvMove"), r8s(1.0, 2.0)))),
        point((EXECUTE, (i4(1), text("SlvMove"), r8s(1.0, 2.0)))),
        point((EXECUTE, (i4(1), text("slvMove"), Variant.array(VT.R4, (1.0, 2.0, 3.0, 4.0))))),
        point(code=1),
        point(code=0x0F200501),
        call(lambda client: client.ask(0, 7, 0, MOVE)),
        call(retried),
        call(only_a_retry),
        *(call(partial(cut, direction=each)) for each in Direction),
        *(call(partial(damaged, direction=each)) for each in Direction),
    ],
)
def test_what_differs_otherwise_is_not_alike(other: Call) -> None:
    assert not begun().continues(other)


def test_a_run_has_one_form() -> None:
    alike, other = begun(), point((EXECUTE, (i4(2), text("slvMove"), r8s(1.0, 2.0))))
    alike.on_other_call(other)
    assert alike.continues(other)
    assert not alike.continues(point())
    alike.on_other_call(point())
    assert alike.continues(point())
    assert not alike.continues(other)


@pytest.mark.parametrize("end", [point(execute("CurJnt")), point(code=0x83500121)])
def test_another_call_or_a_refusal_ends_the_run_until_a_set_point_is_accepted(end: Call) -> None:
    alike = begun()
    alike.on_other_call(end)
    assert not alike.continues(point())
    alike.on_other_call(point())
    assert alike.continues(point())


def test_an_unanswered_set_point_ends_nothing() -> None:
    alike = begun()
    alike.on_other_call(call(lambda client: client.ask(0, 7, 0, MOVE)))
    assert alike.continues(point())


@pytest.mark.parametrize("direction", list(Direction))
def test_nothing_is_learnt_from_damaged_frames(direction: Direction) -> None:
    alike = AlikeSetPoints()
    odd = call(lambda client: damaged(client, direction))
    alike.on_other_call(odd)
    assert not alike.continues(odd)
