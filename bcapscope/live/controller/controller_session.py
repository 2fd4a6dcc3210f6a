"""The Tester's session: one connection at a time, in a separate thread that sends updates to the screen.

The session has its own event loop. Drawing the screen therefore delays no call, and does not lengthen
measured round trips. The screen starts the coroutines of this module with `run_in_loop`.
"""

from __future__ import annotations

import asyncio
import threading
import time
from collections.abc import Callable, Coroutine, Sequence
from contextlib import AsyncExitStack, suppress
from dataclasses import replace
from pathlib import Path
from typing import Any, TypeVar

from bcapscope.client.action_log import ActionLog, LoggedConnection
from bcapscope.client.caller import Caller
from bcapscope.client.controller_target import ControllerTarget
from bcapscope.client.handle_table import ObjectHandle, first_number
from bcapscope.client.object_opener import ObjectOpener
from bcapscope.client.remote_objects import Robot
from bcapscope.client.session import Session, open_target_session
from bcapscope.errors import BcapError, CallTimeout, ControllerError
from bcapscope.live.controller.arming_state import ArmingState
from bcapscope.live.controller.halt_connection import HaltConnection, HaltState, HaltUpdate
from bcapscope.live.controller.history_record import HistoryRecord, Initiator, RecordOutcome, error_reason
from bcapscope.live.controller.history_recorder import INITIATOR, HistoryRecorder
from bcapscope.live.controller.reply_monitor import ReplyMonitor
from bcapscope.live.controller.session_updates import (
    ConnectionLost,
    SessionProblem,
    SessionStatus,
    SessionUpdate,
)
from bcapscope.messages import Message
from bcapscope.protocol.codec.frame import Frame, Malformed, parse_datagram
from bcapscope.protocol.codec.variant import Variant
from bcapscope.protocol.guard import request_effect
from bcapscope.protocol.retry.requester import RetryPolicy
from bcapscope.protocol.tables.call_effect import CallEffect
from bcapscope.protocol.tables.function_table import FUNCTIONS, ID, Function, ObjectClass, function_by_name
from bcapscope.protocol.variant_values import arguments_of
from bcapscope.traffic.observation import Direction, Observation

R = TypeVar("R")

CLOSE_TIMEOUT = 8.0
"""Maximum time in seconds that `close` waits until the session has released all objects."""

_CLEANUP_RETRY_POLICY = RetryPolicy(300_000_000, 2)
"""Timeout in ns, and number of retries, of cleanup calls. Both are small, so that `close` is fast even if the
controller does not reply.
"""


class NotConnectedError(BcapError):
    """The call needs a connection, but no connection is open."""


class NotArmedError(BcapError):
    """The call may energise or move the robot, but the user has not armed. The call was not sent."""


class ControllerSession:
    """The Tester's connection to a controller. All calls of the Tester use this class.

    Attributes:
        status: State that the screen shows. Any thread may read `status`, because each change replaces the
            whole object.
        polling_paused: Whether automatic reads are paused. Reads are paused while another client is in slave
            mode, because any call except a set point may end slave mode.
    """

    def __init__(
        self,
        report: Callable[[SessionUpdate], None],
        log_folder: Path,
        tap: Callable[[Observation], None] = lambda seen: None,
    ) -> None:
        """Threads of this session call `report` and `tap`. `tap` must not block or raise exceptions."""
        self.report = report
        self._tap = tap
        self.action_log = ActionLog(log_folder, "tui", self._on_log_error)
        self.arming = ArmingState()
        self.status = SessionStatus()
        self.reply_monitor = ReplyMonitor(self.now())
        self.polling_paused = False
        self._opener: ObjectOpener | None = None
        self._halt_connection: HaltConnection | None = None
        self._stack = AsyncExitStack()
        self._recorder = HistoryRecorder(self._on_record, self._subject_of)
        self._loop = asyncio.new_event_loop()
        self._thread = threading.Thread(target=self._loop.run_forever, name="controller session", daemon=True)
        self._thread.start()

    async def run_in_loop(self, step: Coroutine[Any, Any, R]) -> R:
        """Run a coroutine in this session's loop. If the waiting task is cancelled, the coroutine is too."""
        return await asyncio.wrap_future(asyncio.run_coroutine_threadsafe(step, self._loop))

    def pause_polling(self, paused: bool) -> None:
        """Suspend automatic reads while another client, such as the player, is in slave mode."""
        self.polling_paused = paused
        if self._halt_connection is not None:
            self._halt_connection.pause_heartbeat(paused)

    def close(self) -> None:
        """Release all objects, but wait at most `CLOSE_TIMEOUT`. Then end the session's thread. Call this
        from another thread.
        """
        done = asyncio.run_coroutine_threadsafe(self._shut_down(), self._loop)
        with suppress(TimeoutError, BcapError, OSError):
            done.result(CLOSE_TIMEOUT)
        self._loop.call_soon_threadsafe(self._loop.stop)
        self._thread.join(1.0)
        if not self._thread.is_alive():
            self._loop.close()
        self.action_log.close()

    async def _shut_down(self) -> None:
        await self.disconnect()
        others = asyncio.all_tasks() - {asyncio.current_task()}
        if others:
            await asyncio.wait(others)

    def now(self) -> int:
        return time.monotonic_ns()

    async def open_link(self, target: ControllerTarget) -> None:
        """Open the UDP or TCP link, without sending b-CAP frames. Raises OSError."""
        await self.disconnect()
        opened = open_target_session(target, observer=self._on_packet, listener=self._recorder.on_event)
        session = await self._stack.enter_async_context(opened)
        session.check_armed = self._check_armed
        self._opener = ObjectOpener(session, target)
        self.arming = ArmingState()
        self.reply_monitor = ReplyMonitor(self.now())
        self.update_status(target=target)

    def open_halt_connection(self, robot: str) -> None:
        """Open a connection that only halts a robot, and close the previous one."""
        target = self.status.target
        if target is None:
            return
        old = self._halt_connection
        if old is not None:
            old.report_only_halts()
        self._halt_connection = HaltConnection(target, self.report, self._on_halt_packet, robot)
        if old is not None:
            threading.Thread(target=old.close, daemon=True).start()

    async def disconnect(self) -> None:
        """Leave slave mode, release all objects, newest first, and close the connection."""
        halt_connection, self._halt_connection = self._halt_connection, None
        stack, self._stack = self._stack, AsyncExitStack()
        INITIATOR.set(Initiator.SCREEN)
        if self._opener is not None:
            session = self._opener.session
            session.retry_policies = session.retry_policies._replace(others=_CLEANUP_RETRY_POLICY)
        try:
            with suppress(BcapError, OSError):
                await stack.aclose()
            if halt_connection is not None:
                await asyncio.to_thread(halt_connection.close)
        finally:
            self._recorder.abandon_call()
            self._opener = None
            self.arming.disarm()
            if self.status.is_connected:
                self.status = SessionStatus()
                self.report(self.status)

    def update_status(self, **changes: Any) -> None:
        self.status = replace(self.status, **changes)
        self.report(self.status)

    @property
    def opener(self) -> ObjectOpener:
        """The `ObjectOpener` of the open connection. Raises `NotConnectedError` if no connection is open."""
        if self._opener is None:
            raise NotConnectedError(Message("tester.not_connected"))
        return self._opener

    async def call(
        self, function: Function, arguments: Sequence[Variant], initiator: Initiator = Initiator.USER
    ) -> HistoryRecord:
        """Make a call and return its record, even if the controller refuses it or does not answer.

        Raises:
            NotConnectedError: No connection is open.
            NotArmedError: The call needs arming, and the user has not armed. Nothing was sent.
            LocalProtocolError: The call cannot be encoded. Nothing was sent.
            ConnectionError: The link is lost.
        """
        session = self.opener.session
        return await self.record_calls(session.perform_call(function.id, arguments), initiator)

    async def invoke(
        self, name: str, *values: object, initiator: Initiator = Initiator.USER
    ) -> HistoryRecord:
        """Make a call by the name of its function; `variant_of` converts the Python values to arguments."""
        function = function_by_name(name)
        assert function is not None, name
        return await self.call(function, arguments_of(function, values), initiator)

    async def send_raw(self, raw: bytes) -> HistoryRecord:
        """Send bytes unchanged, wait for the reply, and return a record of both.

        Raises:
            NotArmedError: The bytes need arming, and the user has not armed. Bytes that are not an
                intact frame always need arming.
            NotConnectedError, ConnectionError: See `call`.
        """
        session = self.opener.session
        caller = session.caller
        assert isinstance(caller, Caller)
        if any(_raw_needs_arming(session, item) for item in parse_datagram(raw)):
            self._check_armed()
        timeout = session.retry_policies.others.timeout / 1e9
        await self.run_calls(caller.send_raw(raw, timeout), Initiator.USER)
        self._recorder.complete_raw_call()
        return self.last_record

    @property
    def controller(self) -> ObjectHandle:
        """The open controller object. Raises `NotConnectedError` if no controller is open."""
        found = self.opener.session.handles.latest(ObjectClass.CONTROLLER)
        if found is None:
            raise NotConnectedError(Message("tester.not_connected"))
        return found

    def selected_robot(self) -> Robot:
        """Return the robot that gets robot commands. Raises `NotConnectedError` if no robot is open."""
        if self.status.robot is None:
            raise NotConnectedError(Message("controller.robot.missing"))
        return Robot(self.opener.session, self.status.robot.handle)

    @property
    def last_record(self) -> HistoryRecord:
        """The record of the latest call that has ended. Read this property only after the first call."""
        assert self._recorder.last_record is not None
        return self._recorder.last_record

    def _subject_of(self, function_id: int, arguments: Sequence[Variant]) -> ObjectHandle | None:
        function = FUNCTIONS.get(function_id)
        if function is None or self._opener is None:
            return None
        return self._opener.session.handles.find(function.owner, first_number(arguments))

    async def open_object(
        self, parent: ObjectHandle, kind: ObjectClass, name: str, option: str
    ) -> ObjectHandle | None:
        """Open an object; return None on failure. After a failure, `last_record` shows the reason."""
        record = await self.invoke(f"{parent.kind}_Get{kind}", parent.handle, name, option)
        if record.outcome is not RecordOutcome.ANSWERED or record.reply is None:
            return None
        return self.opener.session.handles.find(kind, first_number(record.reply.variants))

    def _check_armed(self) -> None:
        if not self.arming.allows_armed_calls(self.now()):
            raise NotArmedError(Message("tester.not_armed"))
        self.arming.extend(self.now())

    async def record_calls(
        self, steps: Coroutine[Any, Any, object], initiator: Initiator = Initiator.USER
    ) -> HistoryRecord:
        """Run a coroutine until it ends or a call fails. Return the record of the latest call. Raises
        NotArmedError, LocalProtocolError and ConnectionError as `call` does.
        """
        with suppress(ControllerError, CallTimeout):
            await self.run_calls(steps, initiator)
        return self.last_record

    async def run_calls(self, steps: Coroutine[Any, Any, R], initiator: Initiator) -> R:
        """Run a coroutine that makes calls, and return its result.

        If the coroutine is cancelled, its unfinished call still appears in the history. If the link fails,
        the session closes the connection and reports the loss to the screen.
        """
        INITIATOR.set(initiator)
        try:
            return await steps
        except asyncio.CancelledError:
            self._recorder.abandon_own_call()
            raise
        except OSError as error:
            if not isinstance(error, BcapError):
                self._recorder.abandon_own_call()
                await self.disconnect()
                self.report(ConnectionLost(error_reason(error)))
            raise

    def halt(self) -> bool:
        """Start to halt the robot. Return whether a connection is open. Any thread may call this method."""
        self.arming.disarm()
        halt_connection = self._halt_connection
        if halt_connection is not None:
            halt_connection.press()
        with suppress(RuntimeError):  # the event loop of this session may have ended
            self._loop.call_soon_threadsafe(self._start_halt_call)
        return halt_connection is not None or self._opener is not None

    def _start_halt_call(self) -> None:
        if self._opener is not None and self.status.robot is not None:
            self._loop.create_task(self._halt_on_session(self.status.robot))

    async def _halt_on_session(self, robot: ObjectHandle) -> None:
        """Send a second HALT after the running call of the main connection. Then leave slave mode."""
        with suppress(BcapError, OSError):
            record = await self.invoke("Robot_Halt", robot.handle, "")
            if self._halt_connection is None:
                done = record.outcome is RecordOutcome.ANSWERED
                state = HaltState.HALTED if done else HaltState.FAILED
                self.report(HaltUpdate(state, (record.outcome.value,), record.took))
            if self.status.slave_mode:
                values = (robot.handle, "slvChangeMode", 0)
                await self.invoke("Robot_Execute", *values, initiator=Initiator.SCREEN)

    def _on_packet(self, observation: Observation) -> None:
        self._record_packet(observation, INITIATOR.get())
        self._recorder.on_packet(observation)

    def _on_halt_packet(self, observation: Observation) -> None:
        is_halt = isinstance(observation.item, Frame) and observation.item.code == ID["Robot_Halt"]
        self._record_packet(observation, Initiator.USER if is_halt else Initiator.SCREEN)

    def _record_packet(self, observation: Observation, initiator: Initiator) -> None:
        item, connection = observation.item, LoggedConnection.of_conversation(observation.flow.conversation)
        if observation.flow.direction is Direction.RESPONSE:
            self.reply_monitor.on_received(self.now())
            self.action_log.log_reply(connection, item, observation.time)
        else:
            self.reply_monitor.on_request(self.now())
            reads = isinstance(item, Frame) and request_effect(item.code, item.variants) is CallEffect.READS
            is_logged = initiator is Initiator.USER or not reads  # automatic reads are not logged
            self.action_log.log_request(connection, item, observation.time, initiator.value, is_logged)
        self._tap(observation)

    def _on_log_error(self, path: Path, error: OSError) -> None:
        self.report(SessionProblem(path, error_reason(error)))

    def _on_record(self, record: HistoryRecord) -> None:
        if self._opener is not None and self.status.is_connected:
            session = self._opener.session
            if record.outcome is RecordOutcome.ANSWERED and record.reply is not None:
                # `after_call` needs the new handles now, but `Session` records the reply only later.
                # `Session` never records a reply to raw bytes.
                session.record_call(record.function_id, record.arguments, record.reply)
            before = self.status
            self.status = before.after_call(record, session.handles.open_handles())
            if self.status.slave_mode != before.slave_mode:
                self.pause_polling(self.status.slave_mode != 0)
            if self.status != before:
                self.report(self.status)
        self.report(record)


def _raw_needs_arming(session: Session, item: Frame | Malformed) -> bool:
    """Return whether raw bytes need arming. Bytes that are not an intact frame always need arming."""
    return (
        not isinstance(item, Frame) or bool(item.problems) or session.needs_arming(item.code, item.variants)
    )
