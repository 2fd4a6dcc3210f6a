"""The client's side of a recorded session, played to controllers that are not the recorded one."""

from __future__ import annotations

import asyncio

import pytest

from bcapscope.capture.capture_file import open_capture
from bcapscope.capture.packet_decoder import PacketDecoder
from bcapscope.client import Session
from bcapscope.protocol.codec.variant import VT, Variant
from bcapscope.protocol.retry.requester import CallAnswered
from bcapscope.protocol.tables.hresult import E_HANDLE
from bcapscope.replay.script_player import NotAtStartError, PlayedCall
from bcapscope.simulator.machine import InitialState
from bcapscope.simulator.profile import PROFILES
from bcapscope.simulator.simulator import Simulator
from tests.cli.run import CAPTURES
from tests.replay.sessions import CONNECT, perform, recorded, script_of

HOME = (0.0, 0.0, 90.0, 0.0, 90.0, 0.0, 0.0, 0.0)


async def opened(session: Session) -> tuple[int, int]:
    """Open a controller and its robot; return both handles."""
    await session.invoke("Service_Start", "")
    controller = await session.invoke("Controller_Connect", *CONNECT)
    number = controller.arguments[0].variant.value
    robot = await session.invoke("Controller_GetRobot", number, "Arm", "")
    handle = robot.arguments[0].variant.value
    assert isinstance(number, int)
    assert isinstance(handle, int)
    return number, handle


async def motion(session: Session) -> None:
    """A whole session: a variable, the motor, slave mode and back."""
    controller, robot = await opened(session)
    variable = (await session.invoke("Controller_GetVariable", controller, "I1", "")).arguments[0].variant
    await session.invoke("Variable_PutValue", variable.value, Variant(VT.I2, 5))
    await session.invoke("Variable_GetValue", variable.value)
    await session.invoke("Robot_Execute", robot, "TakeArm", Variant.array(VT.I4, (0, 0)))
    await session.invoke("Robot_Execute", robot, "Motor", Variant.array(VT.I4, (1, 0)))
    await session.invoke("Robot_Execute", robot, "slvChangeMode", Variant(VT.I4, 0x202))
    for _ in range(20):
        await session.invoke("Robot_Execute", robot, "slvMove", Variant.array(VT.R8, HOME))
    await session.invoke("Robot_Execute", robot, "slvChangeMode", Variant(VT.I4, 0))
    await asyncio.sleep(1)
    await session.invoke("Robot_Execute", robot, "CurJnt", Variant(VT.EMPTY, None))


async def busy(session: Session) -> None:
    """What makes the handles of this session differ from those of a recording."""
    await session.invoke("Service_Start", "")
    controller = (await session.invoke("Controller_Connect", *CONNECT)).arguments[0].variant.value
    for name in ("I7", "I8", "I9"):
        await session.invoke("Controller_GetVariable", controller, name, "")


@pytest.mark.parametrize("datagrams", [True, False])
def test_handles_are_those_of_the_new_session(datagrams: bool) -> None:
    script = recorded(motion, datagrams=datagrams)
    played, _ = perform(script, Simulator(PROFILES["rc8"]), before=busy, datagrams=datagrams)
    assert len(played) == len(script.calls)
    assert [each.script_call.number for each in played if each.differs] == []
    moved = next(each for each in played if each.script_call.kind.command == "slvMove")
    assert moved.arguments[0] != moved.script_call.arguments[0]
    assert moved.arguments[1:] == moved.script_call.arguments[1:]


def test_times_are_kept_and_pauses_cut() -> None:
    script = recorded(motion)
    played, wire = perform(script, Simulator(PROFILES["rc8"]))
    asked = {frame.serial: time for time, frame in reversed(wire.sent)}
    firsts = [asked[_answered(each).attempts[0].serial] for each in played]
    assert [first - firsts[0] - each.delay for first, each in zip(firsts, played, strict=True)] == [
        line.offset for line in script.calls
    ]
    # Both run on virtual clocks; conversions to seconds and back cost nanoseconds.
    assert all(each.delay < 10_000 for each in played)
    _, hurried = perform(script, Simulator(PROFILES["rc8"]), longest_pause=100_000_000)
    assert wire.sent[-1][0] - hurried.sent[-1][0] > 800_000_000


def _answered(played: PlayedCall) -> CallAnswered:
    assert isinstance(played.result, CallAnswered)
    return played.result


def test_what_the_recording_does_not_open_is_opened() -> None:
    whole = recorded(motion)
    asked = [line.kind.command for line in whole.calls]
    script = whole._replace(calls=whole.calls[asked.index("TakeArm") :])
    played, wire = perform(script, Simulator(PROFILES["rc8"]))
    assert [each.script_call.number for each in played if each.differs] == []
    assert [frame.code for _, frame in wire.sent][:3] == [1, 3, 7]


def test_an_early_end_leaves_slave_mode_and_lets_go() -> None:
    script = recorded(motion)
    simulator = Simulator(PROFILES["rc8"])
    count = 0

    def told(played: PlayedCall) -> bool:
        nonlocal count
        count += 1
        return count < 12

    played, wire = perform(script, simulator, told)
    assert played[-1].script_call.kind.command == "slvMove"
    commands = [frame.arguments[1].variant.value for _, frame in wire.sent if frame.code == 64]
    assert commands[-1] == "slvChangeMode"
    assert wire.sent[-1][1].code == 2
    assert simulator.machine.slave.mode is None


def test_a_session_of_the_sample_captures_goes_as_recorded() -> None:
    with open_capture(CAPTURES / "slave-session.pcapng") as packets:
        script = script_of(list(PacketDecoder(frozenset({5007})).decode(packets)))
    played, _ = perform(script, Simulator(PROFILES["rc8"]))
    assert len(played) == len(script.calls) == 257
    assert not any(each.differs for each in played)


def test_a_failure_that_was_none_is_one() -> None:
    script = recorded(motion)
    without = tuple(line for line in script.calls if line.kind.command != "slvChangeMode")
    cut = script._replace(calls=without)
    played, _ = perform(cut, Simulator(PROFILES["rc8"]), lambda played: not played.failed)
    refused = played[-1]
    assert refused.script_call.kind.command == "slvMove"
    assert len(played) < len(without)
    assert refused.failed
    assert refused.differs
    assert not refused.values_differ


def test_a_recorded_refusal_is_no_failure() -> None:
    async def wrong(session: Session) -> None:
        await opened(session)
        await session.perform_call(101, [Variant(VT.I4, 999)])

    played, _ = perform(recorded(wrong), Simulator(PROFILES["rc8"]), lambda played: not played.failed)
    refused = [each for each in played if each.script_call.hresult == E_HANDLE]
    assert [each.differs for each in refused] == [False]


@pytest.mark.parametrize("empty", [(), ("@CURRENT_ANGLE",)], ids=["by variable", "by command"])
def test_slave_mode_is_not_entered_far_from_the_first_set_point(empty: tuple[str, ...]) -> None:
    script = recorded(motion)
    simulator = Simulator(PROFILES["rc8"], InitialState(joints=(10.0, *HOME[1:]), empty=empty))
    with pytest.raises(NotAtStartError, match=r"the first set point \(call \d+\) is 10 "):
        perform(script, simulator)
    assert simulator.machine.slave.consumed == 0
