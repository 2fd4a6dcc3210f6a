"""The desk: one connection at a time, made and used in a thread of its own, and told of to the screen.

Its event loop is not the screen's, so that what is drawn does not delay a call, and times that are shown are
those of the network. Coroutines here are for that loop; `do` brings one there from the screen's.
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
from bcapscope.client.reach import Reach
from bcapscope.client.session import Session, command_of, open_target
from bcapscope.client.target import Target
from bcapscope.errors import BcapError
from bcapscope.protocol.effects import Effect
from bcapscope.protocol.frame import Frame, Malformed, parse_datagram
from bcapscope.protocol.functions import FUNCTIONS, ID, Function, ObjectClass, function_by_name
from bcapscope.protocol.guard import needs_arming, request_effect
from bcapscope.protocol.hresult import E_NOT_IN_SLAVE_MODE, describe
from bcapscope.protocol.requester import Event, Pace
from bcapscope.protocol.slavemode import mode_value
from bcapscope.protocol.variant import VT, Variant
from bcapscope.traffic.observation import Direction, Observation
from bcapscope.traffic.opened import Book, Opened
from bcapscope.tui.desk.arming import Arming
from bcapscope.tui.desk.halt import HaltLine, HaltNews, HaltState
from bcapscope.tui.desk.news import Lost, News, Status, Trouble
from bcapscope.tui.desk.pulse import Pulse
from bcapscope.tui.desk.record import Ending, Record, Who, cause, why
from bcapscope.tui.desk.recorder import WHO, Recorder
from bcapscope.tui.words import say

R = TypeVar("R")

CLOSING = 8.0
"""Seconds that `close` waits for everything to be let go."""

LEAVING = Pace(300_000_000, 2)
"""Tries of the calls that let go of things: nobody waits long for a controller that is gone."""

_LEVEL_THAT_ENDS_SLAVE_MODE = 3


class NotConnectedError(BcapError):
    """There is no connection that a call could be made on."""


class NotArmedError(BcapError):
    """A call may energise or move the robot, and nobody has armed; it was not made."""


class Desk:
    """A connection and all that is done with it.

    Attributes:
        arming: armed or not.
        log: the action log.
        status: what the screen shows; replaced whole, so that any thread may read it.
        pulse: when the controller was heard last.
        session: the one in use; None while there is no connection.
        resting: nothing is read that nobody asked for, as it might end the slave mode of another client.
    """

    def __init__(
        self,
        tell: Callable[[News], None],
        log_folder: Path,
        tap: Callable[[Observation], None] = lambda seen: None,
    ) -> None:
        """Begin without a connection.

        Args:
            tell: is told of everything that happens, in threads of the desk's.
            log_folder: for the action log.
            tap: sees every packet, in the same threads; returns at once and never raises.
        """
        self.tell = tell
        self._tap = tap
        self.log = ActionLog(log_folder, "tui", self._log_failed)
        self.arming = Arming()
        self.status = Status()
        self.pulse = Pulse(self.now())
        self.session: Session | None = None
        self.resting = False
        self._reach: Reach | None = None
        self._line: HaltLine | None = None
        self._stack = AsyncExitStack()
        self._book = Book()
        self._recorder = Recorder(self._take, self._subject)
        self._loop = asyncio.new_event_loop()
        self._thread = threading.Thread(target=self._loop.run_forever, name="desk", daemon=True)
        self._thread.start()

    async def do(self, step: Coroutine[Any, Any, R]) -> R:
        """Have a coroutine of ours run in our thread, and wait for it; cancelling ends both."""
        return await asyncio.wrap_future(asyncio.run_coroutine_threadsafe(step, self._loop))

    def rest(self, resting: bool) -> None:
        """Read nothing that nobody asked for while another client, such as our player, is in slave mode."""
        self.resting = resting
        if self._line is not None:
            self._line.rest(resting)

    def close(self) -> None:
        """Let go of everything, `CLOSING` seconds at most, and end the thread. From any other thread."""
        done = asyncio.run_coroutine_threadsafe(self._wind_up(), self._loop)
        with suppress(TimeoutError, BcapError, OSError):
            done.result(CLOSING)
        self._loop.call_soon_threadsafe(self._loop.stop)
        self._thread.join(1.0)
        if not self._thread.is_alive():
            self._loop.close()
        self.log.close()

    async def _wind_up(self) -> None:
        """Let go of everything, and wait for whoever is letting go already."""
        await self.disconnect()
        others = asyncio.all_tasks() - {asyncio.current_task()}
        if others:
            await asyncio.wait(others)

    def now(self) -> int:
        """Return ns of a clock that does not go back."""
        return time.monotonic_ns()

    # The connection.

    async def open_link(self, target: Target) -> None:
        """Open the way to a controller; nothing is said yet.

        Raises:
            OSError: there is none.
        """
        await self.disconnect()
        session = open_target(target, observer=self._observe, listener=self._hear)
        self.session = await self._stack.enter_async_context(session)
        self._reach = Reach(self.session, target.service, target.connect, {})
        self.arming = Arming()
        self.pulse = Pulse(self.now())
        self.show(target=target)

    def open_halt_line(self, robot: str) -> None:
        """Open the line for HALT, anew where it is open for another robot."""
        target = self.status.target
        if target is None:
            return
        old = self._line
        if old is not None:
            old.give_way()
        self._line = HaltLine(target, self.tell, self._observe_halt, robot)
        if old is not None:
            threading.Thread(target=old.close, daemon=True).start()

    async def disconnect(self) -> None:
        """Leave slave mode, let go of everything, newest first, and close the connection."""
        line, self._line = self._line, None
        stack, self._stack = self._stack, AsyncExitStack()
        WHO.set(Who.SCREEN)
        if self.session is not None:
            self.session.paces = self.session.paces._replace(others=LEAVING)
        try:
            with suppress(BcapError, OSError):
                await stack.aclose()
            if line is not None:
                await asyncio.to_thread(line.close)
        finally:
            self._recorder.give_up(time.time_ns())
            self.session = self._reach = None
            self._book = Book()
            self.arming.disarm()
            if self.status.is_connected:
                self.status = Status()
                self.tell(self.status)

    async def lose(self, reason: str) -> None:
        """Take notice that the connection is gone."""
        await self.disconnect()
        self.tell(Lost(reason))

    def show(self, **changes: Any) -> None:
        """Change the status and tell it."""
        self.status = replace(self.status, **changes)
        self.tell(self.status)

    # Calls.

    @property
    def reach(self) -> Reach:
        """What opens objects and makes calls.

        Raises:
            NotConnectedError: there is no connection.
        """
        if self._reach is None:
            raise NotConnectedError(say("tester.not_connected"))
        return self._reach

    async def call(self, function: Function, arguments: Sequence[Variant], who: Who = Who.USER) -> Record:
        """Make a call, however it ends; return its record.

        Raises:
            NotConnectedError: there is no connection.
            NotArmedError: it may energise or move the robot, and nobody has armed. Nothing was sent.
            LocalProtocolError: it cannot be sent. Nothing was.
            ConnectionError: the link is gone.
        """
        reach = self.reach
        if self._needs_arming(function.id, arguments):
            self._check_armed()
        WHO.set(who)
        await self._guarded(reach.exchange(function, arguments))
        return self.last

    async def invoke(self, name: str, *values: Variant, who: Who = Who.USER) -> Record:
        """As `call`, with the function's name."""
        function = function_by_name(name)
        assert function is not None, name
        return await self.call(function, values, who)

    async def send_raw(self, raw: bytes) -> Record:
        """Send bytes as they are and wait for what comes; return the record.

        Raises:
            NotArmedError: they may energise or move the robot, or are no sound frame.
            NotConnectedError, ConnectionError: as `call`.
        """
        session = self.reach.session
        caller = session.exchanger
        assert isinstance(caller, Caller)
        if any(self._raw_needs_arming(item) for item in parse_datagram(raw)):
            self._check_armed()
        WHO.set(Who.USER)
        await self._guarded(caller.send_raw(raw, session.paces.others.timeout / 1e9))
        self._recorder.settle(time.time_ns())
        return self.last

    @property
    def controller(self) -> Opened:
        """The controller.

        Raises:
            NotConnectedError: there is no connection to one.
        """
        found = self._book.all(ObjectClass.CONTROLLER)
        if not found:
            raise NotConnectedError(say("tester.not_connected"))
        return found[-1]

    @property
    def last(self) -> Record:
        """The record of the call that ended last; there has been one."""
        assert self._recorder.last is not None
        return self._recorder.last

    def subject_of(self, record: Record) -> Opened | None:
        """Return what a call was asked of; None where that is not open any more."""
        return self._subject(record.function_id, record.arguments)

    def _subject(self, function_id: int, arguments: Sequence[Variant]) -> Opened | None:
        function, first = FUNCTIONS.get(function_id), arguments[:1]
        handle = first[0].value if first else None
        if function is None or not isinstance(handle, int):
            return None
        return self._book.find(function.owner, handle)

    def why(self) -> str:
        """Tell why the last call failed."""
        return why(self.last)

    async def open(
        self, parent: Opened, kind: ObjectClass, name: str, option: str, who: Who = Who.USER
    ) -> Opened | None:
        """Open an object; None where that was refused or not answered, as the last record tells."""
        values = (handle_variant(parent), Variant(VT.BSTR, name), Variant(VT.BSTR, option))
        record = await self.invoke(f"{parent.kind}_Get{kind}", *values, who=who)
        return self._book.find(kind, _handle_in(record)) if record.ending is Ending.ANSWERED else None

    def choose(self, robot: Opened | None) -> None:
        """Have commands of the robot go to this one."""
        self.show(robot=robot)

    def _needs_arming(self, function_id: int, arguments: Sequence[Variant]) -> bool:
        written = self._subject(function_id, arguments)
        is_variable = written is not None and written.kind is ObjectClass.VARIABLE
        return needs_arming(function_id, arguments, written.label if written and is_variable else "")

    def _raw_needs_arming(self, item: Frame | Malformed) -> bool:
        """Return whether raw bytes need arming; bytes that are not an intact frame do."""
        if not isinstance(item, Frame) or item.problems:
            return True
        return self._needs_arming(item.code, item.variants)

    def _check_armed(self) -> None:
        if not self.arming.lets_pass(self.now()):
            raise NotArmedError(say("tester.not_armed"))
        self.arming.used(self.now())

    async def _guarded(self, exchange: Coroutine[Any, Any, object]) -> None:
        """Wait for an exchange; what was given up has its record, and what broke the link ends it."""
        try:
            await exchange
        except asyncio.CancelledError:
            self._recorder.give_up(time.time_ns())
            raise
        except OSError as error:
            self._recorder.give_up(time.time_ns())
            if not isinstance(error, BcapError):
                await self.lose(cause(error))
            raise

    # HALT.

    def halt(self) -> bool:
        """Stop the robot; return whether there is a connection. From any thread, at any time, at once."""
        self.arming.disarm()
        line = self._line
        if line is not None:
            line.press()
        with suppress(RuntimeError):  # our loop has ended
            self._loop.call_soon_threadsafe(self._halt_here)
        return line is not None or self.session is not None

    def _halt_here(self) -> None:
        if self.session is not None and self.status.robot is not None:
            self._loop.create_task(self._halt_on_session(self.status.robot))

    async def _halt_on_session(self, robot: Opened) -> None:
        """Say it on the connection of the other calls, too, as soon as that is free, and leave slave mode."""
        with suppress(BcapError, OSError):
            record = await self.invoke("Robot_Halt", handle_variant(robot), Variant(VT.BSTR, ""))
            if self._line is None:
                done = record.ending is Ending.ANSWERED
                state = HaltState.HALTED if done else HaltState.FAILED
                self.tell(HaltNews(state, record.ending.value, record.took))
            if self.status.slave_mode:
                values = (handle_variant(robot), Variant(VT.BSTR, "slvChangeMode"), Variant(VT.I4, 0))
                await self.invoke("Robot_Execute", *values, who=Who.SCREEN)

    # What comes back.

    def _hear(self, event: Event) -> None:
        self._recorder.hear(event, time.time_ns())

    def _observe(self, seen: Observation) -> None:
        self._note(seen, WHO.get())
        self._recorder.observe(seen)

    def _observe_halt(self, seen: Observation) -> None:
        is_halt = isinstance(seen.item, Frame) and seen.item.code == ID["Robot_Halt"]
        self._note(seen, Who.USER if is_halt else Who.SCREEN)

    def _note(self, seen: Observation, who: Who) -> None:
        is_request = seen.flow.direction is Direction.REQUEST
        (self.pulse.asked if is_request else self.pulse.heard)(self.now())
        self._log(seen, who)
        self._tap(seen)

    def _log(self, seen: Observation, who: Who) -> None:
        """Log a packet, unless it is the screen's own reading."""
        item, connection = seen.item, LoggedConnection.of(seen.flow.conversation)
        if seen.flow.direction is Direction.RESPONSE:
            self.log.received(connection, item, seen.time)
            return
        reads = isinstance(item, Frame) and request_effect(item.code, item.variants) is Effect.READS
        self.log.sent(connection, item, seen.time, who.value, wanted=who is Who.USER or not reads)

    def _log_failed(self, path: Path, error: OSError) -> None:
        self.tell(Trouble(f"{path}: {cause(error)}"))

    def _take(self, record: Record) -> None:
        """Learn from a call that has ended, and hand its record on."""
        changes: dict[str, object] = {}
        function = FUNCTIONS.get(record.function_id)
        if record.ending is Ending.ANSWERED and record.reply is not None and function is not None:
            self._book.note(function, record.arguments, record.reply)
            changes["open"] = self._book.all()
            if self.status.robot not in self._book.all():
                changes["robot"] = None
            command = command_of(record.function_id, record.arguments)
            if command in ("takearm", "givearm"):
                changes["holds_arm"] = command == "takearm"
        if record.reply is not None:
            changes["round_trip"] = record.took
        mode = _mode_after(record)
        if mode is not None and mode != self.status.slave_mode:
            changes["slave_mode"] = mode
            self.rest(mode != 0)
        if self.status.is_connected and changes:
            self.show(**changes)
        self.tell(record)


def _mode_after(record: Record) -> int | None:
    """Tell the slave mode that the robot is in after a call; None where it tells nothing of that."""
    command = command_of(record.function_id, record.arguments)
    if record.ending is Ending.ANSWERED:
        if command == "slvchangemode" and len(record.arguments) > 2:
            return mode_value(record.arguments[2]) or 0
        return None
    if record.ending is Ending.REFUSED and record.reply is not None:
        code = record.reply.code
        level = describe(code).level or 0
        # Each error of that level ends slave mode (DENSO Wave 2009: any result but S_OK does on RC7).
        return 0 if code == E_NOT_IN_SLAVE_MODE or level >= _LEVEL_THAT_ENDS_SLAVE_MODE else None
    return None


def handle_variant(opened: Opened) -> Variant:
    """Make the first argument of a call that is made of an object."""
    return Variant(VT.I4, opened.handle)


def _handle_in(record: Record) -> int | None:
    arguments = record.reply.arguments if record.reply is not None else ()
    value = arguments[0].variant.value if arguments else None
    return value if isinstance(value, int) else None
