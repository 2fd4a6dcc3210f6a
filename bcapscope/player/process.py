"""The player as others see it: a process of its own, to which a plan goes and from which messages come.

Nothing else that Python does in the program that starts it can hold up a set point, and when that program
ends, however it does, the motion is ended in order. A player that is killed is followed by another process,
which ends what the first had begun.
"""

from __future__ import annotations

import os
import select
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import replace
from types import TracebackType
from typing import Self

from msgspec import structs

from bcapscope.player.messages import (
    Aftermath,
    Command,
    Ended,
    Message,
    Order,
    Outcome,
    Owed,
    Packet,
    Plan,
    Progress,
    Trouble,
    decode_message,
    encode_message,
)
from bcapscope.protocol.frame import Frame

_LEAVES = 20.0
"""Seconds of silence after which a player counts as hung that should come to rest, leave and end; the
time-outs of a controller that does not answer are shorter."""

_BEYOND = 5000
"""Serials that a player may have used since it last told one, and more: it tells twenty times a second."""

_RING = 0xFFFF
"""Serials count 1..65535 and begin again at 1."""


class Player:
    """A running player.

    Messages are read when `fileno` is readable, by `messages`, or waited for, by `wait`, in any thread.
    Whoever reads too slowly misses progress, and nothing else. The last message is `Ended`, always.
    """

    def __init__(self, plan: Plan) -> None:
        """Start it.

        Raises:
            OSError: that cannot be done.
        """
        self._plan = plan
        self._owed = Owed((), "", 0)
        self._serial = 0
        self._crash = ""
        self._ended: Ended | None = None
        self._reading = threading.Lock()
        self._start(plan)

    def _start(self, plan: Plan) -> None:
        with _kept_back(signal.SIGUSR1):  # until the player knows what it means
            self._process = subprocess.Popen(
                [sys.executable, "-m", "bcapscope.player"],
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                stderr=subprocess.PIPE,
                bufsize=0,  # orders may be given by a signal handler, in the middle of another order
                start_new_session=True,  # Ctrl-C in the terminal is for whoever started it, who then stops it
            )
        assert self._process.stdin is not None
        assert self._process.stdout is not None
        self._commands = self._process.stdin
        self._messages = self._process.stdout
        self._read = b""
        os.set_blocking(self._messages.fileno(), False)
        self._tell(encode_message(plan))

    @property
    def pid(self) -> int:
        """Number of the process."""
        return self._process.pid

    @property
    def ended(self) -> Ended | None:
        """How it ended; None while it is at work."""
        return self._ended

    def fileno(self) -> int:
        """Return what is readable when messages have come."""
        return self._messages.fileno()

    def messages(self) -> list[Message]:
        """Return the messages that have come; never waits."""
        with self._reading:
            return [] if self._ended is not None else self._come()

    def _come(self) -> list[Message]:
        found: list[Message] = []
        over = False
        while True:
            try:
                data = os.read(self._messages.fileno(), 1 << 16)
            except BlockingIOError:
                break
            if not data:
                over = True
                break
            *lines, self._read = (self._read + data).split(b"\n")
            found += [decode_message(line) for line in lines]
        for message in found:
            self._note(message)
        if found and isinstance(found[-1], Ended):
            found[-1] = self._ended = self._after(found[-1])
        elif over:
            found.append(self._crashed())
        return found

    def _note(self, message: Message) -> None:
        """Remember what somebody else needs to know who has to go on from here."""
        if isinstance(message, Owed):
            self._owed = message
        sent = message.sent if isinstance(message, Progress) else b""
        if isinstance(message, Packet) and message.sent:
            sent = message.raw
        if sent:
            self._serial = Frame(sent).serial

    def wait(self, seconds: float) -> list[Message]:
        """Wait for messages for so long at most, and return those that have come."""
        if self._ended is None:
            select.select((self,), (), (), seconds)
        return self.messages()

    def stop(self) -> None:
        """Let the robot come to rest on its way, then leave in order."""
        self._tell(encode_message(Command(Order.STOP)))

    def halt(self) -> None:
        """Stop the robot at once, then leave in order. By a signal, which no full pipe holds up.

        The process that follows a player that was killed does nothing else anyway.
        """
        if not self._crash:
            with suppress(ProcessLookupError):
                self._process.send_signal(signal.SIGUSR1)

    def answer(self, choice: str) -> None:
        """Answer the question that was asked last."""
        self._tell(encode_message(Command(answer=choice)))

    def close(self) -> Ended:
        """Stop it if it is at work, and wait until it is gone; return how it ended."""
        self.stop()
        give_up = time.monotonic() + _LEAVES
        while self._ended is None:
            if self.wait(0.5):
                give_up = time.monotonic() + _LEAVES
            elif time.monotonic() > give_up:
                self._process.kill()  # how that ends is told by `wait`
        _let_go(self._process)
        return self._ended

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def _tell(self, data: bytes) -> None:
        rest = memoryview(data + b"\n")
        with suppress(OSError, ValueError):  # it is gone, which its messages tell
            while rest:
                rest = rest[os.write(self._commands.fileno(), rest) :]

    def _crashed(self) -> Message:
        """Have ended what a player had begun that has left no last message; else make that."""
        assert self._process.stderr is not None
        words = self._process.stderr.read().decode(errors="replace").strip().splitlines()
        code = self._process.wait()
        how = f"signal {-code}" if code < 0 else f"exit code {code}"
        crash = f"the player ended with {how}" + (f": {words[-1]}" if words else "")
        crashed = self._process
        is_owing = self._is_owing
        try:
            if is_owing and not self._crash:
                self._crash = crash
                self._start(self._tidying())
                _let_go(crashed)
                return Trouble(f"{crash}: what it had begun is being ended")
        except OSError as error:
            crash = f"{error.strerror or error}".lower()
        self._ended = self._after(Ended(Outcome.FAILED, crash, left=not is_owing))
        return self._ended

    @property
    def _is_owing(self) -> bool:
        """Whether there is anything to end; a connection over TCP has ended with the player."""
        return bool(self._owed.debts) or (self._owed.port > 0 and not self._plan.target.tcp)

    def _tidying(self) -> Plan:
        """Make the plan to end what was begun."""
        owed, target = self._owed, self._plan.target
        serial = (self._serial + _BEYOND - 1) % _RING + 1
        if target.name and not target.connect_option:
            target = replace(target, connect_option="@IfNotMember")  # over UDP it still is one
        aftermath = Aftermath(owed.debts, owed.generation, owed.port, serial)
        return structs.replace(
            self._plan, target=target, points=(), log=None, record=None, realtime=False, aftermath=aftermath
        )

    def _after(self, ended: Ended) -> Ended:
        """Return the last message, in which the end of a player that crashed is not left out."""
        if not self._crash:
            return ended
        told = ": what it had begun was ended in order"
        if ended.outcome is not Outcome.DONE or not ended.left:
            told = f": what it had begun could not be ended ({ended.reason or 'no answer'})"
        return structs.replace(ended, outcome=Outcome.FAILED, reason=self._crash + told)


@contextmanager
def _kept_back(number: signal.Signals) -> Iterator[None]:
    """Let a signal wait that comes to a process started in this block, until that process wants it."""
    before = signal.pthread_sigmask(signal.SIG_BLOCK, (number,))
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


def _let_go(process: subprocess.Popen[bytes]) -> None:
    """Wait for the end of a process and close the pipes to it."""
    process.wait()
    for pipe in (process.stdin, process.stdout, process.stderr):
        if pipe is not None:
            with suppress(OSError):
                pipe.close()
