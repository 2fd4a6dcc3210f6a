"""The HALT connection: its own thread, event loop and session, ready before it is needed.

A call blocks its connection until it ends. DENSO's C server answers anything else there with busy (orin_bcap
C/src/bCAPServer/bcap_server.c). HALT therefore uses a connection of its own, with the robot already open. It
does not depend on the event loops of the screen or of the other calls: a key press only sets a flag in this
thread's loop.
"""

from __future__ import annotations

import asyncio
import threading
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass, replace
from enum import StrEnum

from bcapscope.client.caller import Observer
from bcapscope.client.controller_target import DEFAULT_ROBOT, ControllerTarget
from bcapscope.client.object_opener import ObjectOpener
from bcapscope.client.robot_halt import halt_robot
from bcapscope.client.session import Session, open_target_session
from bcapscope.errors import BcapError, ControllerError
from bcapscope.live.controller.history_record import Reason, error_reason
from bcapscope.protocol.tables.function_table import ObjectClass
from bcapscope.protocol.tables.hresult import E_HANDLE, E_NOT_CONNECTED

HEARTBEAT = 2.0
"""Seconds between two heartbeat calls."""

RETRY_WITHIN = 3.0
"""Seconds after a press of HALT in which a lost connection is reopened repeatedly."""

_REOPEN_DELAY = 0.05

_STALE_CONNECTION_CODES = (E_HANDLE, E_NOT_CONNECTED)
"""Result codes of a controller that has forgotten the connection, as over UDP after the pendant's Reset."""

CLOSE_TIMEOUT = 3.0
"""Seconds that `close` waits for the connection to release its objects."""


class HaltState(StrEnum):
    """What pressing HALT would do, or has done."""

    CLOSED = "closed"
    """No controller is connected."""
    OPENING = "opening"
    READY = "ready"
    LOST = "lost"
    """The controller does not answer on this connection, or refused to open it."""
    HALTING = "halting"
    HALTED = "halted"
    FAILED = "failed"
    """HALT was sent, but was refused or not answered."""


@dataclass(frozen=True, slots=True)
class HaltUpdate:
    """The state of the HALT connection has changed.

    Attributes:
        reason: Why it failed; () otherwise.
        round_trip: Round trip of the call that showed it, ns; 0 if none did.
    """

    state: HaltState
    reason: Reason = ()
    round_trip: int = 0


class HaltConnection:
    """One HALT connection to one controller, open from construction to `close`."""

    def __init__(
        self,
        target: ControllerTarget,
        report: Callable[[HaltUpdate], None],
        observer: Observer,
        robot: str = DEFAULT_ROBOT,
        heartbeat: float = HEARTBEAT,
    ) -> None:
        """Start to open the connection, and return at once.

        Args:
            target: The controller. The same name of Controller_Connect is not used twice.
            report: Called for every change, in this connection's thread.
            observer: Called for every packet, in the same thread.
        """
        self._target = replace(target, name=f"{target.name}-halt" if target.name else "")
        self._report = report
        self._observer = observer
        self._robot = robot
        self._heartbeat = heartbeat
        self._heartbeat_paused = False
        self._loop = asyncio.new_event_loop()
        self._pressed = asyncio.Event()
        self._retry_until = 0.0
        self._was_refused = False  # once since HALT was pressed
        self._closing = False
        self._thread = threading.Thread(target=self._run, name="halt", daemon=True)
        self._thread.start()

    def press(self) -> None:
        """Halt the robot. Any thread may call this at any time; it returns at once."""

        def press() -> None:
            self._retry_until = self._loop.time() + RETRY_WITHIN
            self._was_refused = False
            self._pressed.set()

        self._call_in_loop(press)

    def pause_heartbeat(self, paused: bool) -> None:
        """While `paused`, send only HALT: other calls may end another client's slave mode."""
        self._heartbeat_paused = paused

    def report_only_halts(self) -> None:
        """Report only results of HALT from now on. The replacement connection reports its own state."""
        report = self._report
        halt_results = (HaltState.HALTED, HaltState.FAILED)
        self._report = lambda update: report(update) if update.state in halt_results else None

    def close(self) -> None:
        """Close the connection; wait at most `CLOSE_TIMEOUT` seconds."""

        def end() -> None:
            self._closing = True
            self._pressed.set()

        self._call_in_loop(end)
        self._thread.join(CLOSE_TIMEOUT)

    def _call_in_loop(self, action: Callable[[], None]) -> None:
        with suppress(RuntimeError):  # the thread has ended, and its loop with it
            self._loop.call_soon_threadsafe(action)

    def _run(self) -> None:
        try:
            with asyncio.Runner(loop_factory=lambda: self._loop) as runner:
                runner.run(self._run_until_closed())
        finally:
            self._report(HaltUpdate(HaltState.CLOSED))

    async def _run_until_closed(self) -> None:
        while not self._closing:
            try:
                async with open_target_session(self._target, observer=self._observer) as session:
                    await self._serve_session(session)
            except (BcapError, OSError) as error:
                await self._handle_loss(error_reason(error))

    async def _handle_loss(self, reason: Reason) -> None:
        """Wait before the connection is reopened: only briefly while a HALT is pending.

        A pending HALT fails after `RETRY_WITHIN` seconds. Sent minutes later, it could interrupt another
        motion.
        """
        if self._pressed.is_set() and self._loop.time() < self._retry_until:
            await asyncio.sleep(_REOPEN_DELAY)
            return
        if self._pressed.is_set() and not self._closing:
            self._pressed.clear()
            self._report(HaltUpdate(HaltState.FAILED, reason))
        self._report(HaltUpdate(HaltState.LOST, reason))
        await self._wait_for_press(self._heartbeat)

    async def _serve_session(self, session: Session) -> None:
        """Open the robot, then wait for HALT."""
        self._report(HaltUpdate(HaltState.OPENING))
        opener = ObjectOpener(session, self._target, {ObjectClass.ROBOT: self._robot})
        handle = await opener.handle_for(ObjectClass.ROBOT)
        await self._send_heartbeat(session, handle)
        while not self._closing:
            await self._wait_for_press(self._heartbeat)
            if self._closing:
                return
            if self._pressed.is_set():
                self._pressed.clear()
                await self._halt_robot(session, handle)
            elif not self._heartbeat_paused:
                await self._send_heartbeat(session, handle)

    async def _wait_for_press(self, seconds: float) -> None:
        with suppress(TimeoutError):
            async with asyncio.timeout(seconds):
                await self._pressed.wait()

    async def _send_heartbeat(self, session: Session, handle: int) -> None:
        """Check that the connection works; a press of HALT cancels the check."""
        began = self._loop.time()
        call = asyncio.ensure_future(session.invoke("Robot_GetAttribute", handle))
        pressed = asyncio.ensure_future(self._pressed.wait())
        await asyncio.wait((call, pressed), return_when=asyncio.FIRST_COMPLETED)
        pressed.cancel()
        if not call.done():
            call.cancel()
            await asyncio.wait((call,))
            return
        try:
            call.result()
        except ControllerError as error:  # also proves the connection, unless the robot's handle is unknown
            if error.hresult in _STALE_CONNECTION_CODES:
                raise
        took = round((self._loop.time() - began) * 1e9)
        self._report(HaltUpdate(HaltState.READY, round_trip=took))

    async def _halt_robot(self, session: Session, handle: int) -> None:
        """Halt the robot. After a first refusal reopen the connection: the controller may not know it."""
        self._report(HaltUpdate(HaltState.HALTING))
        began = self._loop.time()
        try:
            await halt_robot(session, handle, _sleep_ns)
        except ControllerError as error:
            if not self._was_refused:
                self._was_refused = True
                self._pressed.set()
                raise
            self._report(HaltUpdate(HaltState.FAILED, error_reason(error)))
        except (BcapError, OSError) as error:
            self._report(HaltUpdate(HaltState.FAILED, error_reason(error)))
            raise
        else:
            self._report(HaltUpdate(HaltState.HALTED, round_trip=round((self._loop.time() - began) * 1e9)))


async def _sleep_ns(length: int) -> None:
    await asyncio.sleep(length / 1e9)
