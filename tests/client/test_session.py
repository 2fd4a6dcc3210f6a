"""Pace, retries, release and what goes wrong, between a client and a peer in memory under virtual time."""

from __future__ import annotations

import asyncio
from collections import Counter
from collections.abc import Iterable

import pytest
from hypothesis import given
from hypothesis import strategies as st

from bcapscope.client import RetryPolicies, Robot, Session, Variable, connect, open_session
from bcapscope.errors import CallTimeout, ControllerError, LocalProtocolError
from bcapscope.protocol.codec.frame import Frame
from bcapscope.protocol.codec.variant import VT, Variant
from bcapscope.protocol.retry.requester import LateReply, RequesterEvent, RetryPolicy
from bcapscope.protocol.retry.reserved_convention import ReservedConvention
from bcapscope.protocol.tables.function_table import function_name
from bcapscope.protocol.tables.hresult import E_HANDLE
from bcapscope.traffic.observation import Direction, Observation, Transport
from tests.client.peer import Peer
from tests.memory_link import NetworkModel, memory_link_pair, over_link, perfect_network
from tests.virtual_time import run_in_virtual_time


def _lost(_: bytes) -> Iterable[float]:
    return ()


def _moment() -> float:
    return asyncio.get_running_loop().time()


@pytest.mark.parametrize(
    ("command", "mode", "tries", "seconds"),
    [
        ("slvMove", 0x002, 8, 0.016),
        ("SLVMOVE", 0x202, 8, 0.016),
        ("slvMove", 0x102, 1, 0.002),
        ("CurJnt", 0x002, 5, 5.0),
        ("CurJnt", 0x202, 5, 5.0),
        ("CurJnt", 0x102, 4, 4.0),
    ],
)
def test_the_pace_is_that_of_the_slides(command: str, mode: int, tries: int, seconds: float) -> None:
    async def play() -> None:
        near, far = memory_link_pair()
        peer = Peer(far)
        async with open_session(over_link(near)) as session:
            robot = Robot(session, 7)
            await robot.slv_change_mode(mode)
            peer.answers["Robot_Execute"] = None
            began = _moment()
            with pytest.raises(CallTimeout, match=f"Robot_Execute {command} got no reply") as caught:
                await robot.execute(command)
            assert len(caught.value.attempts) == tries
            assert _moment() - began == pytest.approx(seconds)

    run_in_virtual_time(play())


def test_tcp_tries_once_and_waits_as_long() -> None:
    async def play() -> None:
        near, far = memory_link_pair(datagrams=False)
        peer = Peer(far)
        peer.answers["Robot_Execute"] = None
        async with open_session(over_link(near)) as session:
            with pytest.raises(CallTimeout) as caught:
                await Robot(session, 7).execute("slvMove")
            assert [attempt.serial for attempt in caught.value.attempts] == [1]
            assert _moment() == pytest.approx(5.0)

    run_in_virtual_time(play())


@pytest.mark.parametrize(
    ("retries", "mode", "tries"),
    [
        pytest.param(4, 0, 5, id="after an Async mode"),
        pytest.param(6, 0x101, 7, id="in an Async mode, by wish"),
        pytest.param(0, 0x101, 1, id="without retries"),
    ],
)
def test_how_often_other_calls_are_tried(retries: int, mode: int, tries: int) -> None:
    async def play() -> None:
        near, far = memory_link_pair()
        peer = Peer(far)
        paces = RetryPolicies(others=RetryPolicy(1_000_000_000, retries))
        async with open_session(over_link(near), retry_policies=paces) as session:
            robot = Robot(session, 7)
            await robot.slv_change_mode(0x101)
            await robot.slv_change_mode(mode)
            peer.answers["Robot_Execute"] = None
            with pytest.raises(CallTimeout) as caught:
                await robot.execute("CurJnt")
            assert len(caught.value.attempts) == tries

    run_in_virtual_time(play())


def test_what_is_open_is_let_go_newest_first_when_the_block_fails() -> None:
    near, far = memory_link_pair()
    peer = Peer(far)

    async def fail() -> None:
        async with connect(over_link(near)) as service:
            controller = await service.connect()
            robot = await controller.get_robot("Arm")
            await robot.slv_change_mode(1)
            variable = await robot.get_variable("@TYPE")
            await variable.release()
            peer.answers["Robot_Release"] = E_HANDLE, ()
            raise ZeroDivisionError

    with pytest.raises(ZeroDivisionError):
        run_in_virtual_time(fail())
    assert peer.executed[-4:] == [
        ("Robot_Execute", 102, "slvChangeMode", 0),
        ("Robot_Release", 102),
        ("Controller_Disconnect", 101),
        ("Service_Stop",),
    ]


def test_what_is_open_is_let_go_when_the_task_is_cancelled_in_a_call() -> None:
    near, far = memory_link_pair()
    peer = Peer(far)

    async def use() -> None:
        async with connect(over_link(near)) as service:
            controller = await service.connect()
            peer.answers["Controller_GetHelp"] = None
            await controller.get_help()

    async def play() -> None:
        task = asyncio.create_task(use())
        await asyncio.sleep(0.5)
        peer.end()
        task.cancel()
        with pytest.raises(asyncio.CancelledError):
            await task

    run_in_virtual_time(play())
    assert peer.functions[-2:] == ["Controller_Disconnect", "Service_Stop"]


def test_who_never_answered_is_not_waited_for_any_longer() -> None:
    near, far = memory_link_pair(to_server=_lost, to_client=_lost)
    Peer(far)

    async def use() -> None:
        async with connect(
            over_link(near), retry_policies=RetryPolicies(others=RetryPolicy(60_000_000_000, 4))
        ):
            pass

    async def play() -> float:
        task = asyncio.create_task(use())
        await asyncio.sleep(3.0)
        task.cancel()
        with pytest.raises(asyncio.CancelledError):
            await task
        return _moment()

    assert run_in_virtual_time(play()) < 4.5


@pytest.mark.parametrize(
    ("hangs", "expected"),
    [
        ("Service_Start", [("Service_Start", ""), ("Service_Stop",)]),
        (
            "Robot_Execute",
            [("Robot_Execute", 7, "slvChangeMode", 0x102), ("Robot_Execute", 7, "slvChangeMode", 0)],
        ),
    ],
)
def test_what_may_have_begun_when_it_was_given_up_is_ended(
    hangs: str, expected: list[tuple[object, ...]]
) -> None:
    near, far = memory_link_pair()
    peer = Peer(far)
    peer.answers[hangs] = None

    async def use() -> None:
        async with open_session(over_link(near)) as session:
            if hangs == "Service_Start":
                await session.invoke("Service_Start", "")
            await Robot(session, 7).slv_change_mode(0x102)

    async def play() -> None:
        task = asyncio.create_task(use())
        await asyncio.sleep(0.5)
        del peer.answers[hangs]
        peer.end()
        task.cancel()
        with pytest.raises(asyncio.CancelledError):
            await task

    run_in_virtual_time(play())
    assert peer.executed == expected


def test_after_service_stop_nothing_is_released() -> None:
    near, far = memory_link_pair()
    peer = Peer(far)

    async def play() -> None:
        async with connect(over_link(near)) as service:
            await service.connect()
            await service.stop()

    run_in_virtual_time(play())
    assert peer.functions == ["Service_Start", "Controller_Connect", "Service_Stop"]


def test_objects_of_a_disconnected_controller_are_released() -> None:
    near, far = memory_link_pair()
    peer = Peer(far)

    async def play() -> None:
        async with connect(over_link(near)) as service:
            controller = await service.connect()
            await controller.get_robot("Arm")
            await controller.release()

    run_in_virtual_time(play())
    assert peer.executed[-3:] == [("Controller_Disconnect", 101), ("Robot_Release", 102), ("Service_Stop",)]


class _UnarmedError(Exception):
    """Nobody has armed."""


def test_a_call_that_needs_arming_is_not_sent_unarmed() -> None:
    near, far = memory_link_pair()
    peer = Peer(far)

    def refuse() -> None:
        raise _UnarmedError

    async def play() -> None:
        async with open_session(over_link(near)) as session:
            session.check_armed = refuse
            robot = Robot(session, 7)
            for needs_arming in (
                robot.slv_change_mode(2),
                robot.execute("Motor", 1),
                robot.move(1, "J(0)"),
                Variable(session, 8).put_value(1),  # of a variable that is not known
            ):
                with pytest.raises(_UnarmedError):
                    await needs_arming
            number = await robot.get_variable("@SPEED")
            await robot.slv_change_mode(0)
            await robot.halt()
            switch = await robot.get_variable("@SERVO_ON")
            await switch.put_value(False)
            with pytest.raises(_UnarmedError):
                await switch.put_value(True)
            await number.release()

    run_in_virtual_time(play())
    assert [call[0] for call in peer.executed] == [
        *("Robot_GetVariable", "Robot_Execute", "Robot_Halt", "Robot_GetVariable"),
        *("Variable_PutValue", "Variable_Release", "Variable_Release"),
    ]


def test_a_slave_mode_that_is_refused_is_not_left() -> None:
    near, far = memory_link_pair()
    peer = Peer(far)
    peer.answers["Robot_Execute"] = E_HANDLE, ()

    async def play() -> None:
        async with open_session(over_link(near)) as session:
            with pytest.raises(ControllerError):
                await Robot(session, 7).slv_change_mode(0x102)

    run_in_virtual_time(play())
    assert len(peer.executed) == 1


def test_a_peer_that_is_gone_is_not_asked_to_release_everything() -> None:
    async def play() -> float:
        gone = False

        def up(_: bytes) -> Iterable[float]:
            return () if gone else (0.0,)

        near, far = memory_link_pair(to_server=up)
        Peer(far)
        async with connect(over_link(near)) as service:
            await service.connect()
            await service.connect()
            gone = True
        return _moment()

    assert run_in_virtual_time(play()) == pytest.approx(5.0, abs=0.01)


@pytest.mark.parametrize("datagrams", [True, False])
def test_who_is_busy_longer_than_is_waited_for_is_told_of_the_end(datagrams: bool) -> None:
    told: list[object] = []

    async def play() -> None:
        near, far = memory_link_pair(datagrams=datagrams)
        peer = Peer(far)
        async with connect(over_link(near), observer=lambda seen: told.append(seen.item)) as service:
            controller = await service.connect()
            peer.answers["Controller_GetHelp"] = None
            await controller.get_help()

    with pytest.raises(CallTimeout):
        run_in_virtual_time(play())
    last = told[-1]
    assert isinstance(last, Frame)
    assert function_name(last.code) == "Service_Stop"


def test_a_stream_that_ends_fails_the_call_and_all_after_it() -> None:
    async def play() -> None:
        near, far = memory_link_pair(datagrams=False)
        peer = Peer(far)
        peer.answers["Service_Start"] = None
        async with open_session(over_link(near)) as session:
            asyncio.get_running_loop().call_later(1, far.close)
            for _ in range(2):
                with pytest.raises(ConnectionResetError, match="the other end closed"):
                    await session.invoke("Service_Start", "")
            assert _moment() == 1

    run_in_virtual_time(play())


def test_calls_of_several_tasks_wait_for_each_other() -> None:
    async def play() -> None:
        near, far = memory_link_pair(to_server=lambda _: (0.25,), to_client=lambda _: (0.25,))
        peer = Peer(far)
        async with open_session(over_link(near)) as session:
            await asyncio.gather(*(session.invoke("Controller_GetHelp", handle) for handle in range(3)))
            assert _moment() == pytest.approx(1.5)
        assert peer.executed == [("Controller_GetHelp", handle) for handle in range(3)]

    run_in_virtual_time(play())


def test_the_observer_sees_every_frame() -> None:
    seen: list[Observation] = []

    async def play() -> None:
        near, far = memory_link_pair(to_server=lambda raw: (0.0,) if Frame(raw).reserved else ())
        Peer(far)
        async with open_session(over_link(near), observer=seen.append) as session:
            await session.invoke("Controller_GetHelp", 7)

    run_in_virtual_time(play())
    request, retry, reply = seen
    assert [item.number for item in seen] == [1, 2, 3]
    assert [item.flow.direction for item in seen] == [*[Direction.REQUEST] * 2, Direction.RESPONSE]
    assert str(request.flow.dst) == "memory:5007"
    assert request.flow.conversation.transport is Transport.UDP
    assert retry.time - request.time == pytest.approx(1e9, abs=1000)
    assert isinstance(retry.item, Frame)
    assert (retry.item.serial, retry.item.reserved) == (2, 1)
    assert reply.first_byte_time == reply.time


def test_a_listener_hears_of_late_replies() -> None:
    heard: list[RequesterEvent] = []

    async def play() -> None:
        near, far = memory_link_pair(to_client=lambda raw: (1.5 if Frame(raw).serial == 1 else 0.6,))
        Peer(far)
        async with open_session(over_link(near), listener=heard.append) as session:
            await session.invoke("Controller_GetHelp", 7)

    run_in_virtual_time(play())
    assert [type(event).__name__ for event in heard] == ["LateReply", "CallAnswered"]
    assert isinstance(heard[0], LateReply)


def test_too_large_for_udp_leaves_the_session_usable() -> None:
    async def play() -> None:
        near, far = memory_link_pair()
        Peer(far)
        async with open_session(over_link(near)) as session:
            with pytest.raises(LocalProtocolError, match="Connect over TCP"):
                await session.invoke("Variable_PutValue", 7, bytes(500))
            await session.invoke("Variable_PutValue", 7, b"")

    run_in_virtual_time(play())


_DELAYS = st.lists(st.sampled_from([0.0, 0.0005, 0.0015, 0.003, 0.009]), max_size=2)


@given(
    convention=st.sampled_from([ReservedConvention.SEED, ReservedConvention.OWN, ReservedConvention.CHAIN]),
    up=st.lists(_DELAYS, max_size=40),
    down=st.lists(_DELAYS, max_size=40),
    retries=st.integers(0, 3),
)
def test_each_call_ends_in_one_way_and_none_is_executed_twice(
    convention: ReservedConvention, up: list[list[float]], down: list[list[float]], retries: int
) -> None:
    async def play() -> tuple[Counter[object], list[object]]:
        near, far = memory_link_pair(to_server=_forecast(up), to_client=_forecast(down))
        peer = Peer(far)
        paces = RetryPolicies(others=RetryPolicy(2_000_000, retries))
        answered: list[object] = []
        async with open_session(over_link(near), convention=convention, retry_policies=paces) as session:
            for number in range(8):
                if await _ends(session, number):
                    answered.append(number)
            await asyncio.sleep(0.1)
        return Counter(call[1] for call in peer.executed), answered

    executed, answered = run_in_virtual_time(play())
    assert all(times == 1 for times in executed.values())
    assert set(answered) <= set(executed)


def _forecast(weather: list[list[float]]) -> NetworkModel:
    """Let the packets have these fates in order, and the rest arrive."""
    fates = iter(weather)
    return lambda raw: next(fates, perfect_network(raw))


async def _ends(session: Session, number: int) -> bool:
    try:
        await session.call(23, (Variant(VT.I4, number), Variant(VT.I4, number)))
    except (CallTimeout, ControllerError):
        return False
    return True
