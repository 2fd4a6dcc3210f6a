"""The HALT connection: a second connection to the controller that only halts a robot. The HALT connection has
its own thread, event loop and session, and is open before HALT is needed.

A b-CAP call blocks its connection until the call ends: DENSO's C server refuses other calls as busy
(orin_bcap C/src/bCAPServer/bcap_server.c). HALT therefore uses a separate connection on which the robot
is already open. HALT does not depend on the event loops of the screen or of other calls.
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
from bcapscope.client.session import Session, halt_robot, open_target_session
from bcapscope.errors import BcapError, ControllerError
from bcapscope.live.controller.history_record import Reason, error_reason
from bcapscope.protocol.tables.function_table import ObjectClass
from bcapscope.protocol.tables.hresult import E_HANDLE, E_NOT_CONNECTED

HEARTBEAT = 2.0
"""Seconds between two heartbeat calls."""

RETRY_WITHIN = 3.0
"""For this many seconds after the user pressed HALT, the thread tries to reopen a lost connection."""

_REOPEN_DELAY = 0.05

_STALE_CONNECTION_CODES = (E_HANDLE, E_NOT_CONNECTED)
"""Codes of a controller that no longer knows the connection, for example after Reset on the pendant."""

CLOSE_TIMEOUT = 3.0
"""Maximum time in seconds that `close` waits for the connection to release its objects."""


class HaltState(StrEnum):
    """State of the HALT connection: whether HALT can be sent, or what the latest HALT achieved."""

    CLOSED = "closed"
    OPENING = "opening"
    READY = "ready"
    LOST = "lost"
    """The controller does not answer on the HALT connection, or refuses a call that opens the connection."""
    HALTING = "halting"
    HALTED = "halted"
    FAILED = "failed"
    """HALT failed: the controller refused the call, or did not answer."""


@dataclass(frozen=True, slots=True)
class HaltUpdate:
    """The state of the HALT connection has changed.

    Attributes:
        reason: Reason why the connection or HALT failed; () after success.
        round_trip: Round trip in ns of the call that showed the new state; 0 if no call showed this state.
    """

    state: HaltState
    reason: Reason = ()
    round_trip: int = 0


class HaltConnection:
    def __init__(
        self,
        target: ControllerTarget,
        report: Callable[[HaltUpdate], None],
        observer: Observer,
        robot: str = DEFAULT_ROBOT,
        heartbeat: float = HEARTBEAT,
    ) -> None:
        """Start to open the connection, and return at once. The thread of the connection calls `report` and
        `observer`. The name for Controller_Connect gets the suffix "-halt", because each connection needs its
        own name.
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
        self._was_refused = False  # whether the controller has refused HALT since the last press of HALT
        self._closing = False
        self._thread = threading.Thread(target=self._run, name="halt", daemon=True)
        self._thread.start()

    def press(self) -> None:
        """Halt the robot. Any thread may call this method at any time; the method returns at once."""

        def press() -> None:
            self._retry_until = self._loop.time() + RETRY_WITHIN
            self._was_refused = False
            self._pressed.set()

        self._call_in_loop(press)

    def pause_heartbeat(self, paused: bool) -> None:
        """While `paused`, send only HALT, because any other call may end another client's slave mode."""
        self._heartbeat_paused = paused

    def report_only_halts(self) -> None:
        """From now on, report only success or failure of HALT: a new `HaltConnection` replaces this one."""
        report = self._report
        halt_results = (HaltState.HALTED, HaltState.FAILED)
        self._report = lambda update: report(update) if update.state in halt_results else None

    def close(self) -> None:
        """Close the connection, and wait until it is closed, but no longer than `CLOSE_TIMEOUT` seconds."""

        def end() -> None:
            self._closing = True
            self._pressed.set()

        self._call_in_loop(end)
        self._thread.join(CLOSE_TIMEOUT)

    def _call_in_loop(self, action: Callable[[], None]) -> None:
        with suppress(RuntimeError):  # the thread and its event loop may have ended
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
        """Wait before the next attempt to open the connection. The wait is short if HALT is pending. After
        `RETRY_WITHIN`, a pending HALT fails, because a later HALT could interrupt another motion.
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
        """Check with a call that the connection works. Cancel the call if the user presses HALT."""
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
        except ControllerError as error:
            # A refusal with a code outside `_STALE_CONNECTION_CODES` proves that the connection works.
            if error.hresult in _STALE_CONNECTION_CODES:
                raise
        took = round((self._loop.time() - began) * 1e9)
        self._report(HaltUpdate(HaltState.READY, round_trip=took))

    async def _halt_robot(self, session: Session, handle: int) -> None:
        """If HALT is refused, repeat HALT once on a new connection: the old connection may be invalid."""
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
