"""The desk against the built-in simulator, and against peers that are worse."""

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
from bcapscope.tui.controller_access.controller_session import (
    ControllerSession,
    NotArmedError,
    NotConnectedError,
)
from bcapscope.tui.controller_access.error_recovery import read_current_errors
from bcapscope.tui.controller_access.guided_connect import add_robot, connect
from bcapscope.tui.controller_access.halt_connection import HaltState, HaltUpdate
from bcapscope.tui.controller_access.history_record import HistoryRecord, Initiator, RecordOutcome
from bcapscope.tui.controller_access.option_field import AUTOMATIC_PROVIDERS
from bcapscope.tui.controller_access.session_updates import (
    ConnectionLost,
    ConnectStep,
    ConnectStepUpdate,
    SessionProblem,
    SessionUpdate,
)
from bcapscope.tui.tester.status_line import status_pieces
from tests.client.server import answering, udp_server

LIMIT = 10.0
N = TypeVar("N")


class Heard:
    """What a desk told, and what it sent."""

    def __init__(self) -> None:
        self.news: list[SessionUpdate] = []
        self.sent: list[str] = []
        self._more = threading.Condition()

    def take(self, news: SessionUpdate) -> None:
        with self._more:
            self.news.append(news)
            self._more.notify_all()

    def see(self, seen: Observation) -> None:
        if seen.flow.direction is Direction.REQUEST and isinstance(seen.item, Frame):
            with self._more:
                self.sent.append(function_name(seen.item.code))
                self._more.notify_all()

    def all(self, kind: type[N]) -> list[N]:
        return [each for each in self.news if isinstance(each, kind)]

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
def desk(folder: Path) -> Iterator[tuple[ControllerSession, Heard]]:
    heard = Heard()
    made = ControllerSession(heard.take, folder, heard.see)
    try:
        yield made, heard
    finally:
        made.close()


def join(
    made: ControllerSession, port: int, robot: str = "Gundam", tcp: bool = False, timeout: float = 300.0
) -> bool:
    """Connect; over UDP the simulator, which all tests share, has room for ten desks in ten seconds."""
    target = ControllerTarget("127.0.0.1", port, tcp, timeout=timeout)
    return asyncio.run(made.run_in_loop(connect(made, target, AUTOMATIC_PROVIDERS, robot, "")))


def robot_call(made: ControllerSession, command: str, parameter: Variant = EMPTY) -> HistoryRecord:
    assert made.status.robot is not None
    values = (made.status.robot.handle, Variant(VT.BSTR, command), parameter)
    return asyncio.run(made.run_in_loop(made.invoke("Robot_Execute", *values)))


def start_robslave(made: ControllerSession) -> None:
    async def start() -> None:
        task = await made.open_object(made.controller, ObjectClass.TASK, "RobSlave", "")
        assert task is not None
        record = await made.invoke("Task_Start", task.handle, 1, "")
        assert record.outcome is RecordOutcome.ANSWERED

    asyncio.run(made.run_in_loop(start()))


@pytest.mark.parametrize("tcp", [False, True], ids=["udp", "tcp"])
def test_connecting_walks_its_steps(tmp_path: Path, simulator: BuiltInSimulator, tcp: bool) -> None:
    with desk(tmp_path) as (made, heard):
        assert join(made, simulator.port, tcp=tcp)
        done = [(each.step, each.done) for each in heard.all(ConnectStepUpdate) if each.done is not None]
        assert done == [(step, True) for step in ConnectStep]
        status = made.status
        assert status.identity.is_simulator
        assert status.identity.type_name
        assert status.robot is not None
        assert status.robot.label == "Gundam"
        assert not made.arming.is_required
        heard.wait_for(lambda: heard.halt is HaltState.READY)
        asyncio.run(made.run_in_loop(made.disconnect()))
        assert not made.status.is_connected
        assert heard.halt is HaltState.CLOSED


def test_the_pages_of_the_tester(tmp_path: Path, simulator: BuiltInSimulator) -> None:
    with desk(tmp_path) as (made, _):
        assert join(made, simulator.port)
        start_robslave(made)
        record = robot_call(made, "slvChangeMode", Variant(VT.I4, 2))
        assert record.reply is not None
        assert (record.reply.code, record.reply.arguments) == (S_OK, ())
        assert made.status.slave_mode == 2
        joints = (12.42261, 60.36108, 17.63232, 35.81433, 20.42798, 23.94879)
        record = robot_call(made, "slvMove", Variant.array(VT.R4, joints))
        assert record.reply is not None
        value = record.reply.arguments[0].variant
        assert value.vt == ARRAY | VT.R4
        assert isinstance(value.value, tuple)
        assert len(value.value) == len(START_JOINTS)
        assert len(record.sent_packets[0].item.raw) == 92
        asyncio.run(made.run_in_loop(made.disconnect()))


def test_halt_ends_a_motion_while_its_call_is_under_way(tmp_path: Path, simulator: BuiltInSimulator) -> None:
    with desk(tmp_path) as (made, heard):
        assert join(made, simulator.port)
        heard.wait_for(lambda: heard.halt is HaltState.READY)
        robot = made.status.robot
        assert robot is not None

        async def move() -> HistoryRecord:
            speed = (robot.handle, Variant(VT.BSTR, "ExtSpeed"), Variant(VT.R4, 1.0))
            await made.invoke("Robot_Execute", *speed)
            pose = Variant(VT.BSTR, "J(-90,0,90,0,0,0)")
            moving = made.invoke("Robot_Move", robot.handle, Variant(VT.I4, 1), pose, "")
            task = asyncio.ensure_future(moving)
            await heard.wait_for_request("Robot_Move")
            threading.Thread(target=made.halt).start()
            return await task

        began = time.monotonic()
        record = asyncio.run(made.run_in_loop(move()))
        assert time.monotonic() - began < 5
        assert record.outcome is RecordOutcome.REFUSED
        assert record.reply is not None
        assert record.reply.code == 0x83201404
        heard.wait_for(lambda: heard.halt in (HaltState.HALTED, HaltState.READY))
        assert HaltState.HALTED in [each.state for each in heard.all(HaltUpdate)]


def test_after_halt_slave_mode_is_left_though_the_controller_may_have_left_it(
    tmp_path: Path, simulator: BuiltInSimulator
) -> None:
    with desk(tmp_path) as (made, heard):
        assert join(made, simulator.port, tcp=True)
        start_robslave(made)
        robot_call(made, "slvChangeMode", Variant(VT.I4, 2))
        made.halt()
        heard.wait_for(lambda: made.status.slave_mode == 0)
        last = heard.all(HistoryRecord)[-1]
        assert (last.outcome, last.arguments[1:]) == (
            RecordOutcome.ANSWERED,
            (Variant(VT.BSTR, "slvChangeMode"), Variant(VT.I4, 0)),
        )


def test_halt_goes_out_though_both_event_loops_are_stuck(tmp_path: Path, simulator: BuiltInSimulator) -> None:
    with desk(tmp_path) as (made, heard):
        assert join(made, simulator.port)
        heard.wait_for(lambda: heard.halt is HaltState.READY)
        hangs, free = threading.Event(), threading.Event()

        async def block() -> None:
            hangs.set()
            free.wait(LIMIT)  # the desk's loop hangs here

        async def stuck() -> None:
            task = asyncio.ensure_future(made.run_in_loop(block()))
            await asyncio.to_thread(hangs.wait, LIMIT)
            made.halt()  # and so does this one, which has called it
            heard.wait_for(lambda: HaltState.HALTED in [each.state for each in heard.all(HaltUpdate)])
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
    with udp_server() as server, desk(tmp_path) as (made, _):
        assert join(made, server.port)
        if needed:
            with pytest.raises(NotArmedError):
                robot_call(made, command, value)
            made.arming.arm(made.now())
        assert robot_call(made, command, value).outcome is RecordOutcome.ANSWERED


def test_the_variable_that_switches_the_motor_needs_arming(tmp_path: Path) -> None:
    with udp_server() as server, desk(tmp_path) as (made, _):
        assert join(made, server.port)
        robot = made.status.robot
        assert robot is not None
        opened = asyncio.run(made.run_in_loop(made.open_object(robot, ObjectClass.VARIABLE, "@servo_on", "")))
        assert opened is not None

        def write(handle: int, value: bool) -> HistoryRecord:
            values = (Variant(VT.I4, handle), Variant(VT.BOOL, value))
            return asyncio.run(made.run_in_loop(made.invoke("Variable_PutValue", *values)))

        assert write(opened.handle, False).outcome is RecordOutcome.ANSWERED
        for handle, value in ((opened.handle, True), (opened.handle + 1, False)):
            with pytest.raises(NotArmedError):
                write(handle, value)


def test_nothing_moves_unarmed_but_on_the_simulator(tmp_path: Path) -> None:
    with udp_server() as server, desk(tmp_path) as (made, _):
        assert join(made, server.port)
        assert made.arming.is_required
        with pytest.raises(NotArmedError):
            robot_call(made, "slvMove", Variant(VT.I4, 1))
        with pytest.raises(NotArmedError):
            asyncio.run(made.run_in_loop(made.send_raw(b"\x01\x02")))
        assert not any("slvMove" in call for peer in server.peers.values() for call in peer.executed)
        made.arming.arm(made.now())
        assert robot_call(made, "slvMove", Variant(VT.I4, 1)).outcome is RecordOutcome.ANSWERED


def test_a_refused_step_says_why(tmp_path: Path) -> None:
    with answering(Controller_Connect=(0x80000901, ())) as server, desk(tmp_path) as (made, heard):
        assert not join(made, server.port)
        last = heard.all(ConnectStepUpdate)[-1]
        assert (last.step, last.done) == (ConnectStep.CONTROLLER, False)
        assert "E_NO_LICENSE" in last.text
        assert not made.status.is_connected


def test_each_provider_is_tried(tmp_path: Path) -> None:
    with answering(Controller_Connect=(0x80070057, ())) as server, desk(tmp_path) as (made, _):
        assert not join(made, server.port)
        calls = [call for peer in server.peers.values() for call in peer.executed]
        assert [call[2] for call in calls if call[0] == "Controller_Connect"] == list(AUTOMATIC_PROVIDERS)


def test_nobody_there(tmp_path: Path) -> None:
    with desk(tmp_path) as (made, heard):
        assert not join(made, 9, tcp=True)
        assert heard.all(ConnectStepUpdate)[-1] == ConnectStepUpdate(
            ConnectStep.LINK, False, "connection refused"
        )
        with pytest.raises(NotConnectedError):
            asyncio.run(made.run_in_loop(made.invoke("Service_Stop")))


@pytest.mark.parametrize("tcp", [False, True], ids=["udp", "tcp"])
def test_the_controller_goes_away(tmp_path: Path, tcp: bool) -> None:
    with desk(tmp_path) as (made, heard):
        with run_builtin_simulator() as place:
            target = ControllerTarget("127.0.0.1", place.port, tcp, timeout=100.0, retries=1)
            assert asyncio.run(made.run_in_loop(connect(made, target, AUTOMATIC_PROVIDERS, "Arm", "")))
            assert not made.reply_monitor.is_reply_overdue(made.now())
        if tcp:
            with pytest.raises(OSError, match="closed"):
                robot_call(made, "slvGetMode")
            assert not made.status.is_connected
            assert heard.all(ConnectionLost)
        else:
            assert robot_call(made, "slvGetMode").outcome is RecordOutcome.UNANSWERED
            later = made.now() + 4_000_000_000
            line = status_pieces(
                made.status, made.arming, later, HaltUpdate(HaltState.LOST), made.reply_monitor
            )
            assert any(text.startswith("no answer for ") and ink == "bad" for text, ink in line)
        heard.wait_for(lambda: heard.halt in (HaltState.LOST, HaltState.CLOSED))


def test_a_call_can_be_cancelled(tmp_path: Path) -> None:
    with answering(Robot_Execute=None) as server, desk(tmp_path) as (made, heard):
        assert join(made, server.port, timeout=1000 * LIMIT)  # so that nothing is sent twice

        async def cancel() -> None:
            assert made.status.robot is not None
            values = (made.status.robot.handle, Variant(VT.BSTR, "slvGetMode"), EMPTY)
            task = asyncio.ensure_future(made.run_in_loop(made.invoke("Robot_Execute", *values)))
            await heard.wait_for_request("Robot_Execute")
            task.cancel()
            with pytest.raises(asyncio.CancelledError):
                await task

        asyncio.run(cancel())
        heard.wait_for(lambda: heard.all(HistoryRecord)[-1].outcome is RecordOutcome.ABANDONED)
        record = heard.all(HistoryRecord)[-1]
        assert (record.initiator, len(record.sent_packets)) == (Initiator.USER, 1)


def test_connecting_can_be_cancelled(tmp_path: Path) -> None:
    with answering(Service_Start=None) as server, desk(tmp_path) as (made, heard):

        async def cancel() -> None:
            walk = connect(made, ControllerTarget("127.0.0.1", server.port), AUTOMATIC_PROVIDERS, "Arm", "")
            task = asyncio.ensure_future(made.run_in_loop(walk))
            await heard.wait_for_request("Service_Start")
            task.cancel()
            with pytest.raises(asyncio.CancelledError):
                await task
            await made.run_in_loop(made.disconnect())

        asyncio.run(cancel())
        assert not made.status.is_connected


def test_raw_bytes_go_out_as_they_are(tmp_path: Path, simulator: BuiltInSimulator) -> None:
    with desk(tmp_path) as (made, _):
        assert join(made, simulator.port, tcp=False)
        raw = bytes.fromhex("01100000003412000013000000000004")
        record = asyncio.run(made.run_in_loop(made.send_raw(raw)))
        assert record.sent_packets[0].item.raw == raw
        assert record.outcome is RecordOutcome.REFUSED
        assert record.reply is not None
        assert record.received_packets[0].item.raw[5:7] == b"\x34\x12"
        odd = asyncio.run(made.run_in_loop(made.send_raw(b"\x01\x02\x03")))
        assert (odd.sent_packets[0].item.raw, odd.received_packets) == (b"\x01\x02\x03", ())
        assert odd.outcome is RecordOutcome.UNANSWERED
        assert robot_call(made, "slvGetMode").outcome is RecordOutcome.ANSWERED


def test_what_raw_bytes_open_is_listed_and_released(tmp_path: Path) -> None:
    with udp_server() as server:
        with desk(tmp_path) as (made, _):
            assert join(made, server.port, robot="")
            name = Variant(VT.BSTR, "Pro1"), Variant(VT.BSTR, "")
            values = (Variant(VT.I4, made.controller.handle), *name)
            raw = encode_frame(0x1234, 0, ID["Controller_GetTask"], values)
            record = asyncio.run(made.run_in_loop(made.send_raw(raw)))
            assert record.outcome is RecordOutcome.ANSWERED
            task = made.status.open_objects[-1]
            assert (task.kind, task.label) == (ObjectClass.TASK, "Pro1")
        calls = [call for peer in server.peers.values() for call in peer.executed]
        assert ("Task_Release", task.handle) in calls


def test_a_controller_that_does_not_answer_is_not_reported_as_free_of_errors(tmp_path: Path) -> None:
    with answering(Controller_Execute=None) as server, desk(tmp_path) as (made, _):
        assert join(made, server.port, timeout=50.0)
        with pytest.raises(CallTimeout):
            asyncio.run(made.run_in_loop(read_current_errors(made)))


def test_too_much_for_udp_is_told_and_not_sent(tmp_path: Path, simulator: BuiltInSimulator) -> None:
    with desk(tmp_path) as (made, _):
        assert join(made, simulator.port)
        with pytest.raises(LocalProtocolError, match="TCP"):
            robot_call(made, "slvGetMode", Variant(VT.BSTR, "x" * 300))


def test_everything_sent_is_in_the_action_log(tmp_path: Path, simulator: BuiltInSimulator) -> None:
    with desk(tmp_path / "log") as (made, _):
        assert join(made, simulator.port, tcp=True)
        robot_call(made, "Motor", Variant(VT.I4, 1))
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


def test_a_log_that_cannot_be_written_is_told_once(tmp_path: Path, simulator: BuiltInSimulator) -> None:
    (tmp_path / "file").write_text("")
    with desk(tmp_path / "file") as (made, heard):
        assert join(made, simulator.port, tcp=True)
        troubles = [each for each in heard.news if isinstance(each, SessionProblem)]
        assert len(troubles) == 1


def test_a_robot_can_be_added_later(tmp_path: Path, simulator: BuiltInSimulator) -> None:
    with desk(tmp_path) as (made, heard):
        assert join(made, simulator.port, robot="", tcp=True)
        assert made.status.robot is None
        assert asyncio.run(made.run_in_loop(add_robot(made, "Gundam", "")))
        assert made.status.robot is not None
        assert heard.all(ConnectStepUpdate)[-1].step is ConnectStep.ROBOT


def test_a_line_for_halt_gives_way_to_another_without_telling_that_there_is_none(
    tmp_path: Path, simulator: BuiltInSimulator
) -> None:
    with desk(tmp_path) as (made, heard):
        assert join(made, simulator.port, tcp=True)
        heard.wait_for(lambda: heard.halt is HaltState.READY)
        old = made._halt_connection
        assert old is not None
        made.open_halt_connection("Gundam")
        old._thread.join(LIMIT)
        heard.wait_for(lambda: heard.halt is HaltState.READY)
        assert HaltState.CLOSED not in [news.state for news in heard.all(HaltUpdate)]
