"""The line that HALT goes out on: thread, event loop and session of its own, ready before it is needed.

A call under way blocks the connection that it was made on until it ends, and DENSO's C server answers
whatever else comes there with busy (orin_bcap C/src/bCAPServer/bcap_server.c). So HALT has a connection that
nothing else uses, with the robot open on it, and needs neither the screen's event loop nor that of the other
calls: whoever presses the key only sets a flag of this thread's loop.
"""

from __future__ import annotations

import asyncio
import threading
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass, replace
from enum import StrEnum

from bcapscope.client.caller import Observer
from bcapscope.client.controller_target import ControllerTarget
from bcapscope.client.object_opener import ObjectOpener
from bcapscope.client.robot_halt import halt_robot
from bcapscope.client.session import Session, open_target_session
from bcapscope.errors import BcapError, ControllerError
from bcapscope.protocol.tables.function_table import ObjectClass
from bcapscope.protocol.tables.hresult import E_HANDLE, E_NOT_CONNECTED
from bcapscope.tui.controller_access.history_record import error_text

HEARTBEAT = 2.0
"""Seconds between two calls that prove the line alive."""

RETRY_WITHIN = 3.0
"""Seconds for which a line that is lost is opened again and again once HALT is pressed."""

_REOPEN_DELAY = 0.05

_STALE_CONNECTION_CODES = (E_HANDLE, E_NOT_CONNECTED)
"""What a controller answers that knows the line no more, as over UDP after the pendant's Reset."""

CLOSE_TIMEOUT = 3.0
"""Seconds that `close` waits for the line to let go of what it has open."""

DEFAULT_ROBOT = "Arm"
"""Name of the robot that is opened where none was given: most controllers have one."""


class HaltState(StrEnum):
    """What pressing HALT would do, or has done."""

    CLOSED = "closed"
    """There is no controller to halt."""
    OPENING = "opening"
    READY = "ready"
    LOST = "lost"
    """The controller does not answer on this line, or did not let it be opened."""
    HALTING = "halting"
    HALTED = "halted"
    FAILED = "failed"
    """HALT was sent, and no answer came, or a refusal."""


@dataclass(frozen=True, slots=True)
class HaltUpdate:
    """The line has changed.

    Attributes:
        state: of the line from now on.
        reason: why, where that is no success; else empty.
        round_trip: ns of the call that told; 0 where none did.
    """

    state: HaltState
    reason: str = ""
    round_trip: int = 0


class HaltConnection:
    """One line to one controller, from its construction to `close`."""

    def __init__(
        self,
        target: ControllerTarget,
        report: Callable[[HaltUpdate], None],
        observer: Observer,
        robot: str = DEFAULT_ROBOT,
        heartbeat: float = HEARTBEAT,
    ) -> None:
        """Open the line; nothing is waited for.

        Args:
            target: the controller; a name of Controller_Connect is not used twice.
            report: is told of every change, in the line's own thread.
            observer: sees every packet, likewise.
            robot: name of the robot to halt.
            heartbeat: seconds between two proofs that the line is alive.
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
        """Halt the robot. From any thread, at any time; returns at once."""

        def press() -> None:
            self._retry_until = self._loop.time() + RETRY_WITHIN
            self._was_refused = False
            self._pressed.set()

        self._call_in_loop(press)

    def pause_heartbeat(self, paused: bool) -> None:
        """Send nothing but HALT while `paused`: what other clients send may end slave mode."""
        self._heartbeat_paused = paused

    def report_only_halts(self) -> None:
        """Tell of nothing but HALT from now on: how the line does is told by the one that takes its place."""
        tell = self._report
        told = (HaltState.HALTED, HaltState.FAILED)
        self._report = lambda news: tell(news) if news.state in told else None

    def close(self) -> None:
        """Let go of the line and wait for that, `CLOSE_TIMEOUT` seconds at most."""

        def end() -> None:
            self._closing = True
            self._pressed.set()

        self._call_in_loop(end)
        self._thread.join(CLOSE_TIMEOUT)

    def _call_in_loop(self, action: Callable[[], None]) -> None:
        with suppress(RuntimeError):  # the line has ended, and its loop with it
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
                await self._handle_loss(error_text(error))

    async def _handle_loss(self, reason: str) -> None:
        """Wait before the line is opened again: not long while HALT waits for it.

        Nobody wants a HALT minutes later, in the midst of another motion: it has failed then.
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
        """Open what HALT needs, then wait for it."""
        self._report(HaltUpdate(HaltState.OPENING))
        reach = ObjectOpener(
            session, self._target.service, self._target.connect, {ObjectClass.ROBOT: self._robot}
        )
        handle = await reach.handle_for(ObjectClass.ROBOT)
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
        """Prove the line alive; HALT does not wait for the answer."""
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
        except ControllerError as error:  # an answer, too, unless nobody knows the robot
            if error.hresult in _STALE_CONNECTION_CODES:
                raise
        took = round((self._loop.time() - began) * 1e9)
        self._report(HaltUpdate(HaltState.READY, round_trip=took))

    async def _halt_robot(self, session: Session, handle: int) -> None:
        """Halt; a line that it is refused on may have been forgotten, and is opened anew for it."""
        self._report(HaltUpdate(HaltState.HALTING))
        began = self._loop.time()
        try:
            await halt_robot(session, handle, _sleep_ns)
        except ControllerError as error:
            if not self._was_refused:
                self._was_refused = True
                self._pressed.set()
                raise
            self._report(HaltUpdate(HaltState.FAILED, error_text(error)))
        except (BcapError, OSError) as error:
            self._report(HaltUpdate(HaltState.FAILED, error_text(error)))
            raise
        else:
            self._report(HaltUpdate(HaltState.HALTED, round_trip=round((self._loop.time() - began) * 1e9)))


async def _sleep_ns(length: int) -> None:
    await asyncio.sleep(length / 1e9)
