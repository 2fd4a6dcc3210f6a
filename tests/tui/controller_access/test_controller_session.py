"""The session of the Tester with the built-in simulator, and with peers that misbehave."""

from __future__ import annotations

import asyncio
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TypeVar

import orjson
import pytest

from bcapscope.client.controller_target import ControllerTarget
from bcapscope.errors import CallTimeout, LocalProtocolError
from bcapscope.live.controller.controller_session import (
    ControllerSession,
    NotArmedError,
    NotConnectedError,
)
from bcapscope.live.controller.error_recovery import read_current_errors
from bcapscope.live.controller.guided_connect import add_robot, connect
from bcapscope.live.controller.halt_connection import HaltState, HaltUpdate
from bcapscope.live.controller.history_record import HistoryRecord, Initiator, RecordOutcome
from bcapscope.live.controller.session_updates import (
    ConnectionLost,
    ConnectStep,
    ConnectStepUpdate,
    SessionProblem,
    SessionUpdate,
)
from bcapscope.protocol.codec.frame import Frame, encode_frame
from bcapscope.protocol.codec.variant import ARRAY, EMPTY, VT, Variant
from bcapscope.protocol.tables.function_table import ID, ObjectClass, function_name
from bcapscope.protocol.tables.hresult import S_OK
from bcapscope.traffic.observation import Direction, Observation
from bcapscope.tui.controller_access.builtin_simulator import (
    START_JOINTS,
    BuiltInSimulator,
    run_builtin_simulator,
)
from bcapscope.tui.controller_access.call_history import reason_text
from bcapscope.tui.controller_access.option_field import AUTOMATIC_PROVIDERS
from bcapscope.tui.tester.connection_panel import status_pieces
from tests.client.server import answering, udp_server

LIMIT = 10.0
N = TypeVar("N")


class ReceivedUpdates:
    """The updates that a session reported, and what it sent."""

    def __init__(self) -> None:
        self.updates: list[SessionUpdate] = []
        self.sent: list[str] = []
        self._more = threading.Condition()

    def on_update(self, update: SessionUpdate) -> None:
        with self._more:
            self.updates.append(update)
            self._more.notify_all()

    def on_packet(self, packet: Observation) -> None:
        if packet.flow.direction is Direction.REQUEST and isinstance(packet.item, Frame):
            with self._more:
                self.sent.append(function_name(packet.item.code))
                self._more.notify_all()

    def all(self, kind: type[N]) -> list[N]:
        return [each for each in self.updates if isinstance(each, kind)]

    def wait_for(self, true: Callable[[], object]) -> None:
        with self._more:
            assert self._more.wait_for(lambda: bool(true()), LIMIT)

    async def wait_for_request(self, function: str) -> None:
        await asyncio.to_thread(self.wait_for, lambda: function in self.sent)

    @property
    def halt(self) -> HaltState | None:
        found = self.all(HaltUpdate)
        return found[-1].state if found else None


@contextmanager
def open_tester(folder: Path) -> Iterator[tuple[ControllerSession, ReceivedUpdates]]:
    received = ReceivedUpdates()
    session = ControllerSession(received.on_update, folder, received.on_packet)
    try:
        yield session, received
    finally:
        session.close()


def join(
    session: ControllerSession, port: int, robot: str = "Gundam", tcp: bool = False, timeout: float = 300.0
) -> bool:
    """Connect; over UDP the simulator, which all tests share, has room for ten sessions in ten seconds."""
    target = ControllerTarget("127.0.0.1", port, tcp, timeout=timeout)
    return asyncio.run(session.run_in_loop(connect(session, target, AUTOMATIC_PROVIDERS, robot, "")))


def robot_call(session: ControllerSession, command: str, parameter: Variant = EMPTY) -> HistoryRecord:
    assert session.status.robot is not None
    values = (session.status.robot.handle, Variant(VT.BSTR, command), parameter)
    return asyncio.run(session.run_in_loop(session.invoke("Robot_Execute", *values)))


def start_robslave(session: ControllerSession) -> None:
    async def start() -> None:
        task = await session.open_object(session.controller, ObjectClass.TASK, "RobSlave", "")
        assert task is not None
        record = await session.invoke("Task_Start", task.handle, 1, "")
        assert record.outcome is RecordOutcome.ANSWERED

    asyncio.run(session.run_in_loop(start()))


@pytest.mark.parametrize("tcp", [False, True], ids=["udp", "tcp"])
def test_connecting_walks_its_steps(tmp_path: Path, simulator: BuiltInSimulator, tcp: bool) -> None:
    with open_tester(tmp_path) as (session, received):
        assert join(session, simulator.port, tcp=tcp)
        done = [(each.step, each.done) for each in received.all(ConnectStepUpdate) if each.done is not None]
        assert done == [(step, True) for step in ConnectStep]
        status = session.status
        assert status.identity.is_simulator
        assert status.identity.type_name
        assert status.robot is not None
        assert status.robot.label == "Gundam"
        assert not session.arming.is_required
        received.wait_for(lambda: received.halt is HaltState.READY)
        asyncio.run(session.run_in_loop(session.disconnect()))
        assert not session.status.is_connected
        assert received.halt is HaltState.CLOSED


def test_the_pages_of_the_tester(tmp_path: Path, simulator: BuiltInSimulator) -> None:
    with open_tester(tmp_path) as (session, _):
        assert join(session, simulator.port)
        start_robslave(session)
        record = robot_call(session, "slvChangeMode", Variant(VT.I4, 2))
        assert record.reply is not None
        assert (record.reply.code, record.reply.arguments) == (S_OK, ())
        assert session.status.slave_mode == 2
        joints = (12.42261, 60.36108, 17.63232, 35.81433, 20.42798, 23.94879)
        record = robot_call(session, "slvMove", Variant.array(VT.R4, joints))
        assert record.reply is not None
        value = record.reply.arguments[0].variant
        assert value.vt == ARRAY | VT.R4
        assert isinstance(value.value, tuple)
        assert len(value.value) == len(START_JOINTS)
        assert len(record.sent_packets[0].item.raw) == 92
        asyncio.run(session.run_in_loop(session.disconnect()))


def test_halt_ends_a_motion_while_its_call_is_under_way(tmp_path: Path, simulator: BuiltInSimulator) -> None:
    with open_tester(tmp_path) as (session, received):
        assert join(session, simulator.port)
        received.wait_for(lambda: received.halt is HaltState.READY)
        robot = session.status.robot
        assert robot is not None

        async def move() -> HistoryRecord:
            speed = (robot.handle, Variant(VT.BSTR, "ExtSpeed"), Variant(VT.R4, 1.0))
            await session.invoke("Robot_Execute", *speed)
            pose = Variant(VT.BSTR, "J(-90,0,90,0,0,0)")
            moving = session.invoke("Robot_Move", robot.handle, Variant(VT.I4, 1), pose, "")
            task = asyncio.ensure_future(moving)
            await received.wait_for_request("Robot_Move")
            threading.Thread(target=session.halt).start()
            return await task

        began = time.monotonic()
        record = asyncio.run(session.run_in_loop(move()))
        assert time.monotonic() - began < 5
        assert record.outcome is RecordOutcome.REFUSED
        assert record.reply is not None
        assert record.reply.code == 0x83201404
        received.wait_for(lambda: received.halt in (HaltState.HALTED, HaltState.READY))
        assert HaltState.HALTED in [each.state for each in received.all(HaltUpdate)]


def test_after_halt_slave_mode_is_left_though_the_controller_may_have_left_it(
    tmp_path: Path, simulator: BuiltInSimulator
) -> None:
    with open_tester(tmp_path) as (session, received):
        assert join(session, simulator.port, tcp=True)
        start_robslave(session)
        robot_call(session, "slvChangeMode", Variant(VT.I4, 2))
        session.halt()
        received.wait_for(lambda: session.status.slave_mode == 0)
        last = received.all(HistoryRecord)[-1]
        assert (last.outcome, last.arguments[1:]) == (
            RecordOutcome.ANSWERED,
            (Variant(VT.BSTR, "slvChangeMode"), Variant(VT.I4, 0)),
        )


def test_halt_goes_out_though_both_event_loops_are_stuck(tmp_path: Path, simulator: BuiltInSimulator) -> None:
    with open_tester(tmp_path) as (session, received):
        assert join(session, simulator.port)
        received.wait_for(lambda: received.halt is HaltState.READY)
        hangs, free = threading.Event(), threading.Event()

        async def block() -> None:
            hangs.set()
            free.wait(LIMIT)  # the session's loop hangs here

        async def stuck() -> None:
            task = asyncio.ensure_future(session.run_in_loop(block()))
            await asyncio.to_thread(hangs.wait, LIMIT)
            session.halt()  # and so does this one, which has called it
            received.wait_for(lambda: HaltState.HALTED in [each.state for each in received.all(HaltUpdate)])
            free.set()
            await task

        asyncio.run(stuck())


@pytest.mark.parametrize(
    ("command", "value", "needed"),
    [
        ("Motor", Variant(VT.I4, 1), True),
        ("TakeArm", EMPTY, True),
        ("ExtSpeed", Variant(VT.I4, 50), True),
        ("slvChangeMode", Variant(VT.I4, 0x202), True),
        ("Motor", Variant(VT.I4, 0), False),
        ("GiveArm", EMPTY, False),
        ("slvChangeMode", Variant(VT.I4, 0), False),
    ],
)
def test_what_energises_needs_arming(tmp_path: Path, command: str, value: Variant, needed: bool) -> None:
    with udp_server() as server, open_tester(tmp_path) as (session, _):
        assert join(session, server.port)
        if needed:
            with pytest.raises(NotArmedError):
                robot_call(session, command, value)
            session.arming.arm(session.now())
        assert robot_call(session, command, value).outcome is RecordOutcome.ANSWERED


def test_the_variable_that_switches_the_motor_needs_arming(tmp_path: Path) -> None:
    with udp_server() as server, open_tester(tmp_path) as (session, _):
        assert join(session, server.port)
        robot = session.status.robot
        assert robot is not None
        opened = asyncio.run(
            session.run_in_loop(session.open_object(robot, ObjectClass.VARIABLE, "@servo_on", ""))
        )
        assert opened is not None

        def write(handle: int, value: bool) -> HistoryRecord:
            values = (Variant(VT.I4, handle), Variant(VT.BOOL, value))
            return asyncio.run(session.run_in_loop(session.invoke("Variable_PutValue", *values)))

        assert write(opened.handle, False).outcome is RecordOutcome.ANSWERED
        for handle, value in ((opened.handle, True), (opened.handle + 1, False)):
            with pytest.raises(NotArmedError):
                write(handle, value)


def test_nothing_moves_unarmed_but_on_the_simulator(tmp_path: Path) -> None:
    with udp_server() as server, open_tester(tmp_path) as (session, _):
        assert join(session, server.port)
        assert session.arming.is_required
        with pytest.raises(NotArmedError):
            robot_call(session, "slvMove", Variant(VT.I4, 1))
        with pytest.raises(NotArmedError):
            asyncio.run(session.run_in_loop(session.send_raw(b"\x01\x02")))
        assert not any("slvMove" in call for peer in server.peers.values() for call in peer.executed)
        session.arming.arm(session.now())
        assert robot_call(session, "slvMove", Variant(VT.I4, 1)).outcome is RecordOutcome.ANSWERED


def test_a_refused_step_says_why(tmp_path: Path) -> None:
    with (
        answering(Controller_Connect=(0x80000901, ())) as server,
        open_tester(tmp_path) as (session, received),
    ):
        assert not join(session, server.port)
        last = received.all(ConnectStepUpdate)[-1]
        assert (last.step, last.done) == (ConnectStep.CONTROLLER, False)
        assert "E_NO_LICENSE" in reason_text(last.result)
        assert not session.status.is_connected


def test_each_provider_is_tried(tmp_path: Path) -> None:
    with answering(Controller_Connect=(0x80070057, ())) as server, open_tester(tmp_path) as (session, _):
        assert not join(session, server.port)
        calls = [call for peer in server.peers.values() for call in peer.executed]
        assert [call[2] for call in calls if call[0] == "Controller_Connect"] == list(AUTOMATIC_PROVIDERS)


def test_nobody_there(tmp_path: Path) -> None:
    with open_tester(tmp_path) as (session, received):
        assert not join(session, 9, tcp=True)
        last = received.all(ConnectStepUpdate)[-1]
        assert (last.step, last.done) == (ConnectStep.LINK, False)
        assert reason_text(last.result) == "connection refused"
        with pytest.raises(NotConnectedError):
            asyncio.run(session.run_in_loop(session.invoke("Service_Stop")))


@pytest.mark.parametrize("tcp", [False, True], ids=["udp", "tcp"])
def test_the_controller_goes_away(tmp_path: Path, tcp: bool) -> None:
    with open_tester(tmp_path) as (session, received):
        with run_builtin_simulator("rc7") as place:
            target = ControllerTarget("127.0.0.1", place.port, tcp, timeout=100.0, retries=1)
            assert asyncio.run(session.run_in_loop(connect(session, target, AUTOMATIC_PROVIDERS, "Arm", "")))
            assert not session.reply_monitor.is_reply_overdue(session.now())
        if tcp:
            with pytest.raises(OSError, match="closed"):
                robot_call(session, "slvGetMode")
            assert not session.status.is_connected
            assert received.all(ConnectionLost)
        else:
            assert robot_call(session, "slvGetMode").outcome is RecordOutcome.UNANSWERED
            later = session.now() + 4_000_000_000
            line = status_pieces(
                session.status, session.arming, later, HaltUpdate(HaltState.LOST), session.reply_monitor
            )
            assert any(text.startswith("no answer for ") and ink == "bad" for text, ink in line)
        received.wait_for(lambda: received.halt in (HaltState.LOST, HaltState.CLOSED))


def test_a_call_can_be_cancelled(tmp_path: Path) -> None:
    with answering(Robot_Execute=None) as server, open_tester(tmp_path) as (session, received):
        assert join(session, server.port, timeout=1000 * LIMIT)  # so that nothing is sent twice

        async def cancel() -> None:
            assert session.status.robot is not None
            values = (session.status.robot.handle, Variant(VT.BSTR, "slvGetMode"), EMPTY)
            task = asyncio.ensure_future(session.run_in_loop(session.invoke("Robot_Execute", *values)))
            await received.wait_for_request("Robot_Execute")
            task.cancel()
            with pytest.raises(asyncio.CancelledError):
                await task

        asyncio.run(cancel())
        received.wait_for(lambda: received.all(HistoryRecord)[-1].outcome is RecordOutcome.ABANDONED)
        record = received.all(HistoryRecord)[-1]
        assert (record.initiator, len(record.sent_packets)) == (Initiator.USER, 1)


def test_a_waiting_call_can_be_cancelled_without_touching_the_call_under_way(tmp_path: Path) -> None:
    with answering(Robot_Execute=None) as server, open_tester(tmp_path) as (session, received):
        assert join(session, server.port, timeout=1000 * LIMIT)
        gone = threading.Event()

        async def wait_in_line() -> None:
            try:
                await session.invoke("Controller_GetAttribute", session.controller.handle)
            finally:
                gone.set()

        async def cancel() -> None:
            assert session.status.robot is not None
            values = (session.status.robot.handle, Variant(VT.BSTR, "slvGetMode"), EMPTY)
            first = asyncio.ensure_future(session.run_in_loop(session.invoke("Robot_Execute", *values)))
            await received.wait_for_request("Robot_Execute")
            before = received.all(HistoryRecord)
            waiting = asyncio.ensure_future(session.run_in_loop(wait_in_line()))
            await session.run_in_loop(asyncio.sleep(0))
            waiting.cancel()
            assert await asyncio.to_thread(gone.wait, LIMIT)
            assert received.all(HistoryRecord) == before
            first.cancel()
            await asyncio.to_thread(received.wait_for, lambda: len(received.all(HistoryRecord)) > len(before))
            last = received.all(HistoryRecord)[-1]
            assert (last.function_id, last.outcome) == (ID["Robot_Execute"], RecordOutcome.ABANDONED)
            assert "Controller_GetAttribute" not in received.sent

        asyncio.run(cancel())


def test_connecting_can_be_cancelled(tmp_path: Path) -> None:
    with answering(Service_Start=None) as server, open_tester(tmp_path) as (session, received):

        async def cancel() -> None:
            walk = connect(
                session, ControllerTarget("127.0.0.1", server.port), AUTOMATIC_PROVIDERS, "Arm", ""
            )
            task = asyncio.ensure_future(session.run_in_loop(walk))
            await received.wait_for_request("Service_Start")
            task.cancel()
            with pytest.raises(asyncio.CancelledError):
                await task
            await session.run_in_loop(session.disconnect())

        asyncio.run(cancel())
        assert not session.status.is_connected


def test_raw_bytes_go_out_as_they_are(tmp_path: Path, simulator: BuiltInSimulator) -> None:
    with open_tester(tmp_path) as (session, _):
        assert join(session, simulator.port, tcp=False)
        raw = bytes.fromhex("01100000003412000013000000000004")
        record = asyncio.run(session.run_in_loop(session.send_raw(raw)))
        assert record.sent_packets[0].item.raw == raw
        assert record.outcome is RecordOutcome.REFUSED
        assert record.reply is not None
        assert record.received_packets[0].item.raw[5:7] == b"\x34\x12"
        odd = asyncio.run(session.run_in_loop(session.send_raw(b"\x01\x02\x03")))
        assert (odd.sent_packets[0].item.raw, odd.received_packets) == (b"\x01\x02\x03", ())
        assert odd.outcome is RecordOutcome.UNANSWERED
        assert robot_call(session, "slvGetMode").outcome is RecordOutcome.ANSWERED


def test_what_raw_bytes_open_is_listed_and_released(tmp_path: Path) -> None:
    with udp_server() as server:
        with open_tester(tmp_path) as (session, _):
            assert join(session, server.port, robot="")
            name = Variant(VT.BSTR, "Pro1"), Variant(VT.BSTR, "")
            values = (Variant(VT.I4, session.controller.handle), *name)
            raw = encode_frame(0x1234, 0, ID["Controller_GetTask"], values)
            record = asyncio.run(session.run_in_loop(session.send_raw(raw)))
            assert record.outcome is RecordOutcome.ANSWERED
            task = session.status.open_objects[-1]
            assert (task.kind, task.label) == (ObjectClass.TASK, "Pro1")
        calls = [call for peer in server.peers.values() for call in peer.executed]
        assert ("Task_Release", task.handle) in calls


def test_a_controller_that_does_not_answer_is_not_reported_as_free_of_errors(tmp_path: Path) -> None:
    with answering(Controller_Execute=None) as server, open_tester(tmp_path) as (session, _):
        assert join(session, server.port, timeout=50.0)
        with pytest.raises(CallTimeout):
            asyncio.run(session.run_in_loop(read_current_errors(session)))


def test_too_much_for_udp_is_reported_and_not_sent(tmp_path: Path, simulator: BuiltInSimulator) -> None:
    with open_tester(tmp_path) as (session, _):
        assert join(session, simulator.port)
        with pytest.raises(LocalProtocolError, match="TCP"):
            robot_call(session, "slvGetMode", Variant(VT.BSTR, "x" * 300))


def test_everything_sent_is_in_the_action_log(tmp_path: Path, simulator: BuiltInSimulator) -> None:
    with open_tester(tmp_path / "log") as (session, _):
        assert join(session, simulator.port, tcp=True)
        robot_call(session, "Motor", Variant(VT.I4, 1))
    (path,) = (tmp_path / "log").glob("actions-*.jsonl")
    lines = [orjson.loads(line) for line in path.read_bytes().splitlines()]
    sent = [line["sent"] for line in lines if "sent" in line]
    assert sent[:2] == ["Service_Start", "Controller_Connect"]
    assert "Robot_Execute Motor" in sent
    assert sent[-1] == "Service_Stop"
    motor = next(line for line in lines if line.get("sent") == "Robot_Execute Motor")
    assert (motor["program"], motor["who"]) == ("tui", "user")
    results = [line["received"] for line in lines if line.get("call") == "Robot_Execute Motor"]
    assert results == ["S_OK"]
    assert motor["hex"].startswith("01")


def test_a_log_that_cannot_be_written_is_reported_once(tmp_path: Path, simulator: BuiltInSimulator) -> None:
    (tmp_path / "file").write_text("")
    with open_tester(tmp_path / "file") as (session, received):
        assert join(session, simulator.port, tcp=True)
        troubles = [each for each in received.updates if isinstance(each, SessionProblem)]
        assert len(troubles) == 1


def test_a_robot_can_be_added_later(tmp_path: Path, simulator: BuiltInSimulator) -> None:
    with open_tester(tmp_path) as (session, received):
        assert join(session, simulator.port, robot="", tcp=True)
        assert session.status.robot is None
        assert asyncio.run(session.run_in_loop(add_robot(session, "Gundam", "")))
        assert session.status.robot is not None
        assert received.all(ConnectStepUpdate)[-1].step is ConnectStep.ROBOT


def test_a_line_for_halt_gives_way_to_another_without_telling_that_there_is_none(
    tmp_path: Path, simulator: BuiltInSimulator
) -> None:
    with open_tester(tmp_path) as (session, received):
        assert join(session, simulator.port, tcp=True)
        received.wait_for(lambda: received.halt is HaltState.READY)
        old = session._halt_connection
        assert old is not None
        session.open_halt_connection("Gundam")
        old._thread.join(LIMIT)
        received.wait_for(lambda: received.halt is HaltState.READY)
        assert HaltState.CLOSED not in [updates.state for updates in received.all(HaltUpdate)]
