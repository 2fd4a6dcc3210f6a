"""Slave mode is on from slvChangeMode until the client leaves it, ends its session, or an error ends it."""

from __future__ import annotations

import pytest

from bcapscope.protocol.codec.variant import VT, Variant
from bcapscope.protocol.tables.command_catalogue import command_parameter
from bcapscope.traffic.call import Call
from bcapscope.traffic.call_kind import MAX_CONVERSATIONS
from bcapscope.traffic.slave_mode_tracker import (
    SlaveModeEffect,
    SlaveModeTracker,
    is_set_point,
    requested_mode,
    slave_mode_effect,
)
from tests.traffic.playbook import (
    EXECUTE,
    MOVE,
    ROBOT_RELEASE,
    SERVICE_STOP,
    START_SERVICE,
    Script,
    calls_of,
    execute,
    i4,
    text,
)

OFF, UNDERFLOW, OVERFLOW, MOTOR_OFF, REFUSED = 0x83500121, 0x84201482, 0x83201483, 0x84400000, 0x80004005
RELEASE = ROBOT_RELEASE, (i4(1),)
STOP = SERVICE_STOP, ()


def mode(value: Variant) -> tuple[int, tuple[Variant, ...]]:
    return EXECUTE, (i4(1), text("SlvChangeMode"), value)


ENTER = mode(i4(0x202))


def calls(*made: tuple[tuple[int, tuple[Variant, ...]], int | None], port: int = 50001) -> list[Call]:
    script = Script()
    client = script.client(port)
    for number, (request, code) in enumerate(made, 1):
        client.ask(10 * number, number, 0, request)
        if code is not None:
            client.reply(10 * number + 1, number, 0, code)
    return calls_of(script.track())


@pytest.mark.parametrize(
    ("request_", "code", "effect"),
    [
        (MOVE, 0, SlaveModeEffect.SET_POINT),
        (MOVE, None, SlaveModeEffect.SET_POINT),
        (MOVE, OVERFLOW, SlaveModeEffect.SET_POINT),
        (MOVE, UNDERFLOW, SlaveModeEffect.SET_POINT_FAILED),
        (MOVE, OFF, SlaveModeEffect.FOUND_OFF),
        (MOVE, 0x83501033, SlaveModeEffect.FOUND_OFF),
        (MOVE, 0x8120184E, SlaveModeEffect.FOUND_OFF),
        (ENTER, 0, SlaveModeEffect.MODE_CHANGED),
        (ENTER, None, SlaveModeEffect.MODE_CHANGED),
        (ENTER, REFUSED, None),
        (START_SERVICE, 0, SlaveModeEffect.SESSION_BOUNDARY),
        (STOP, None, SlaveModeEffect.SESSION_BOUNDARY),
        (STOP, REFUSED, None),
        (RELEASE, 0, SlaveModeEffect.ROBOT_RELEASED),
        (RELEASE, REFUSED, None),
        (START_SERVICE, REFUSED, None),
        ((17, (i4(1), text("slvMove"), i4(0))), 0, None),
        ((17, (i4(1), text("slvMove"), i4(0))), OFF, SlaveModeEffect.ERROR),
        ((EXECUTE, (i4(1),)), 0, None),
        (execute("CurJnt"), 0, None),
        (execute("CurJnt"), UNDERFLOW, SlaveModeEffect.ERROR),
        (execute("CurJnt"), REFUSED, None),
    ],
)
def test_what_a_call_means(
    request_: tuple[int, tuple[Variant, ...]], code: int | None, effect: SlaveModeEffect | None
) -> None:
    (call,) = calls((request_, code))
    assert slave_mode_effect(call) is effect
    assert is_set_point(call.kind) is (request_ is MOVE)


@pytest.mark.parametrize(
    ("after", "code", "robots", "left_with"),
    [
        (mode(i4(0)), 0, (), 0),
        (mode(Variant.array(VT.I4, (0,))), 0, (), 0),
        (mode(i4(0)), REFUSED, (1,), 0x202),
        (mode(i4(0)), None, (1,), 0x202),
        (STOP, 0, (), 0),
        (STOP, None, (1,), 0x202),
        (RELEASE, 0, (), 0x202),
        (MOVE, UNDERFLOW, (1,), 0),
        (MOVE, OVERFLOW, (1,), 0x202),
        (MOVE, REFUSED, (1,), 0x202),
        (execute("CurJnt"), UNDERFLOW, (1,), 0),
        (execute("CurJnt"), 0, (1,), 0x202),
    ],
)
def test_what_a_client_leaves_behind(
    after: tuple[int, tuple[Variant, ...]], code: int | None, robots: tuple[int, ...], left_with: int
) -> None:
    tracker = SlaveModeTracker()
    entered, later = calls((ENTER, 0), (after, code))
    change = tracker.on_call(entered)
    assert change is not None
    assert (change.call, change.mode) == (entered, 0x202)
    tracker.on_call(later)
    known = tracker.find(later.conversation)
    assert (known.robots, known.mode) == (robots, left_with)
    assert tracker.close_conversation(later.conversation) == known
    assert tracker.find(later.conversation).mode is None


def test_only_changes_are_reported() -> None:
    tracker = SlaveModeTracker()
    made = calls((ENTER, 0), (MOVE, 0), (MOVE, UNDERFLOW), (MOVE, OFF), (RELEASE, 0), (STOP, 0), (ENTER, 0))
    changes = [change for call in made if (change := tracker.on_call(call)) is not None]
    assert [(change.call.number, change.mode) for change in changes] == [(1, 0x202), (3, 0), (7, 0x202)]


def test_a_client_whose_set_points_are_refused_is_not_in_slave_mode() -> None:
    tracker = SlaveModeTracker()
    entered, refused, accepted = calls((ENTER, 0), (MOVE, OVERFLOW), (MOVE, 0))
    in_slave_mode = []
    for call in (entered, refused, accepted):
        tracker.on_call(call)
        in_slave_mode.append(list(tracker.clients_in_slave_mode()) == [call.conversation])
    assert in_slave_mode == [True, False, True]


@pytest.mark.parametrize(
    ("made", "is_in_slave_mode"),
    [
        ([(MOVE, UNDERFLOW)], False),
        ([(MOVE, OFF)], False),
        ([(execute("CurJnt"), UNDERFLOW)], True),
        ([(MOVE, OVERFLOW), (execute("CurJnt"), UNDERFLOW)], False),
        ([(MOVE, UNDERFLOW), (ENTER, 0)], True),
        ([(mode(i4(0)), 0)], False),
        ([(RELEASE, 0)], False),
        ([(mode(text("?")), 0)], True),
    ],
)
def test_a_client_is_in_slave_mode_until_it_leaves_or_its_set_points_fail(
    made: list[tuple[tuple[int, tuple[Variant, ...]], int | None]], is_in_slave_mode: bool
) -> None:
    tracker = SlaveModeTracker()
    for call in calls((ENTER, 0), *made):
        tracker.on_call(call)
    assert list(tracker.clients_in_slave_mode()) == [call.conversation] * is_in_slave_mode


def test_clients_are_bounded() -> None:
    tracker = SlaveModeTracker()
    for port in range(MAX_CONVERSATIONS + 5):
        (call,) = calls((ENTER, 0), port=port + 1)
        tracker.on_call(call)
    assert len(list(tracker.clients_in_slave_mode())) == MAX_CONVERSATIONS


def test_the_parameter_may_be_missing() -> None:
    (call,) = calls(((EXECUTE, (i4(1), text("slvChangeMode"))), 0))
    assert command_parameter(call.request.item.variants) is None
    assert requested_mode(call) is None
    assert requested_mode(calls((MOVE, 0))[0]) is None
