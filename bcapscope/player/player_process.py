"""Start a player: a separate process, so that no Python code of the parent can delay a set point.

If the parent ends, the player stops the robot and cleans up. A new player cleans up after a killed one.
"""

from __future__ import annotations

import os
import select
import signal
import subprocess
import sys
import threading
import time
from contextlib import suppress
from dataclasses import replace
from typing import Self

from msgspec import structs

from bcapscope.client.action_log import ArmedCallLogger
from bcapscope.messages import Message
from bcapscope.messages.os_errors import os_reason
from bcapscope.player.player_messages import (
    ControllerInfo,
    FrameMessage,
    Order,
    PendingCleanup,
    PlayEnded,
    PlayerCommand,
    PlayerMessage,
    PlayerProblem,
    PlayOutcome,
    PlayPlan,
    PlayProgress,
    decode_message,
    encode_message,
)
from bcapscope.protocol.codec.frame import Frame

_LEAVE_TIMEOUT = 20.0
"""After the order to stop, the parent kills a player that sends no message for this many seconds. A player
that works never pauses so long between two messages, even if the controller is silent.
"""

_SERIAL_MARGIN = 5000
"""Serials to skip after the last known serial: more than a player uses between two progress reports."""

_SERIAL_MAX = 0xFFFF
"""Largest serial; serials run from 1 to 65535 and then start again at 1."""


class PlayerProcess:
    """A running player. `ended` is the player's last message, a `PlayEnded`; None while the player works.

    Call `read_messages` when `fileno` is readable, or call `wait_for_messages`. Any thread may call both
    methods. If the parent reads too slowly, the player drops only progress reports.
    """

    def __init__(self, plan: PlayPlan) -> None:
        """Start the player, or raise OSError."""
        self._plan = plan
        self._pending_cleanup = PendingCleanup((), "", 0)
        self._serial = 0
        self._crash: Message | None = None
        self.ended: PlayEnded | None = None
        self._read_lock = threading.Lock()
        self._start(plan)

    def _start(self, plan: PlayPlan) -> None:
        # The player inherits the blocked SIGUSR1, and unblocks it after installing its signal handler.
        before = signal.pthread_sigmask(signal.SIG_BLOCK, (signal.SIGUSR1,))
        try:
            self._process = subprocess.Popen(
                [sys.executable, "-m", "bcapscope.player"],
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                stderr=subprocess.PIPE,
                # The pipe has no buffer, because a signal handler may interrupt `_send` and write to the
                # pipe.
                bufsize=0,
                start_new_session=True,  # Ctrl-C reaches only the parent, which then stops the player
            )
        finally:
            signal.pthread_sigmask(signal.SIG_SETMASK, before)
        assert self._process.stdin is not None
        assert self._process.stdout is not None
        self._commands = self._process.stdin
        self._messages = self._process.stdout
        self._partial_line = b""
        os.set_blocking(self._messages.fileno(), False)
        self._send(encode_message(plan))

    @property
    def pid(self) -> int:
        return self._process.pid

    def fileno(self) -> int:
        return self._messages.fileno()

    def read_messages(self) -> list[PlayerMessage]:
        """Return the messages that have arrived, without waiting."""
        with self._read_lock:
            return [] if self.ended is not None else self._read_available()

    def _read_available(self) -> list[PlayerMessage]:
        found: list[PlayerMessage] = []
        over = False
        with suppress(BlockingIOError):
            while data := os.read(self._messages.fileno(), 1 << 16):
                *lines, self._partial_line = (self._partial_line + data).split(b"\n")
                found += [decode_message(line) for line in lines]
            over = True
        for message in found:
            self._remember_state(message)
        if found and isinstance(found[-1], PlayEnded):
            found[-1] = self.ended = self._with_crash(found[-1])
        elif over:
            found.append(self._on_crash())
        return found

    def _remember_state(self, message: PlayerMessage) -> None:
        if isinstance(message, PendingCleanup):
            self._pending_cleanup = message
        sent = message.sent if isinstance(message, PlayProgress) else b""
        if isinstance(message, FrameMessage) and message.sent:
            sent = message.raw
        if sent:
            self._serial = Frame(sent).serial

    def wait_for_messages(self, seconds: float) -> list[PlayerMessage]:
        if self.ended is None:
            select.select((self,), (), (), seconds)
        return self.read_messages()

    def stop(self) -> None:
        self._send(encode_message(PlayerCommand(Order.STOP)))

    def halt(self) -> None:
        """Order the player to halt the robot at once and then to clean up.

        The parent sends the order to halt as a signal: a full pipe can delay a message, but not a signal. If
        the player has crashed, this method does nothing, because another process already cleans up.
        """
        if not self._crash:
            with suppress(ProcessLookupError):
                self._process.send_signal(signal.SIGUSR1)

    def answer(self, choice: str) -> None:
        self._send(encode_message(PlayerCommand(answer=choice)))

    def close(self) -> PlayEnded:
        """Order the player to stop, wait until it has ended, and return its last message."""
        self.stop()
        give_up = time.monotonic() + _LEAVE_TIMEOUT
        while self.ended is None:
            if self.wait_for_messages(0.5):
                give_up = time.monotonic() + _LEAVE_TIMEOUT
            elif time.monotonic() > give_up:
                self._process.kill()  # `wait_for_messages` reports how that ends
        _reap(self._process)
        return self.ended

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def _send(self, data: bytes) -> None:
        rest = memoryview(data + b"\n")
        with suppress(OSError, ValueError):  # the player has ended; `read_messages` will report this
            while rest:
                rest = rest[os.write(self._commands.fileno(), rest) :]

    def _on_crash(self) -> PlayerMessage:
        """Start a cleanup process, and return a `PlayerProblem` that reports the crash.

        Return a `PlayEnded` if no cleanup is needed, if the cleanup process cannot start, or if the process
        that crashed is the cleanup process.
        """
        assert self._process.stderr is not None
        words = self._process.stderr.read().decode(errors="replace").strip().splitlines()
        code = self._process.wait()
        how = Message("play.crash.code", code=code)
        if code < 0:
            how = Message("play.crash.signal", number=-code)
        crash = Message("play.crash.why", how=how, why=words[-1]) if words else Message("play.crash", how=how)
        crashed = self._process
        owed = self._pending_cleanup
        # Over TCP, the controller noticed the crash, because the connection closed.
        is_owing = bool(owed.debts) or (owed.port > 0 and not self._plan.target.tcp)
        try:
            if is_owing and not self._crash:
                self._crash = crash
                self._start(self._cleanup_plan())
                _reap(crashed)
                return PlayerProblem(Message("play.cleaning-up", crash=crash))
        except OSError as error:
            crash = os_reason(error)
        self.ended = self._with_crash(PlayEnded(PlayOutcome.FAILED, crash, left=not is_owing))
        return self.ended

    def _cleanup_plan(self) -> PlayPlan:
        owed, target = self._pending_cleanup, self._plan.target
        serial = (self._serial + _SERIAL_MARGIN - 1) % _SERIAL_MAX + 1
        if target.name and not target.connect_option:
            # over UDP, the controller still holds the crashed player's connection
            target = replace(target, connect_option="@IfNotMember")
        return structs.replace(
            self._plan,
            target=target,
            points=(),
            log=None,
            record=None,
            realtime=False,
            aftermath=owed,
            first_serial=serial,
        )

    def _with_crash(self, ended: PlayEnded) -> PlayEnded:
        if not self._crash:
            return ended
        reason = Message("play.cleaned-up", crash=self._crash)
        if ended.outcome is not PlayOutcome.DONE or not ended.left:
            why = ended.reason or Message("os.no-answer")
            reason = Message("play.not-cleaned-up", crash=self._crash, why=why)
        return structs.replace(ended, outcome=PlayOutcome.FAILED, reason=reason)


def _reap(process: subprocess.Popen[bytes]) -> None:
    process.wait()
    for pipe in (process.stdin, process.stdout, process.stderr):
        if pipe is not None:
            with suppress(OSError):
                pipe.close()


class ArmedMessageLogger:
    """Logs a player's calls that need arming, but no calls to bcapscope's simulator."""

    def __init__(self, logger: ArmedCallLogger) -> None:
        self._logger = logger
        self._is_simulator = False

    def on_message(self, message: PlayerMessage) -> None:
        if isinstance(message, ControllerInfo):
            self._is_simulator = message.simulator
        elif self._is_simulator:
            return
        elif isinstance(message, FrameMessage):
            self._logger.add_frame(message.sent, message.raw, message.time)
        elif isinstance(message, PlayEnded):
            self._logger.add_set_points(message.counts.sent)
            self._logger.end_set_points()
