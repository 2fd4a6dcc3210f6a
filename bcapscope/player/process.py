"""The player as others see it: a process of its own, to which a plan goes and from which messages come.

Nothing else that Python does in the program that starts it can hold up a set point, and when that program
ends, however it does, the motion is ended in order.
"""

from __future__ import annotations

import os
import select
import signal
import subprocess
import sys
import time
from contextlib import suppress
from types import TracebackType
from typing import Self

from bcapscope.player.messages import (
    Command,
    Ended,
    Message,
    Order,
    Outcome,
    Plan,
    decode_message,
    encode_message,
)

_LEAVES = 20.0
"""Seconds that the player has for coming to rest and leaving, time-outs of a silent controller included."""


class Player:
    """A running player.

    Messages are read when `fileno` is readable, by `messages`, or waited for, by `wait`. Whoever reads too
    slowly misses progress, and nothing else. The last message is `Ended`, always.
    """

    def __init__(self, plan: Plan) -> None:
        """Start it.

        Raises:
            OSError: that cannot be done.
        """
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
        self._ended: Ended | None = None
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
        if self._ended is not None:
            return []
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
        last = found[-1] if found else None
        if isinstance(last, Ended):
            self._ended = last
        elif over:
            self._ended = self._crashed()
            found.append(self._ended)
        return found

    def wait(self, seconds: float) -> list[Message]:
        """Wait for messages for so long at most, and return those that have come."""
        if self._ended is None:
            select.select((self,), (), (), seconds)
        return self.messages()

    def stop(self) -> None:
        """Let the robot come to rest on its way, then leave in order."""
        self._tell(encode_message(Command(Order.STOP)))

    def halt(self) -> None:
        """Stop the robot at once, then leave in order. By a signal, which no full pipe holds up."""
        with suppress(ProcessLookupError):
            self._process.send_signal(signal.SIGUSR1)

    def answer(self, choice: str) -> None:
        """Answer the question that was asked last."""
        self._tell(encode_message(Command(answer=choice)))

    def close(self) -> Ended:
        """Stop it if it is at work, and wait until it is gone; return how it ended."""
        self.stop()
        give_up = time.monotonic() + _LEAVES
        while self._ended is None and time.monotonic() < give_up:
            self.wait(0.5)
        if self._ended is None:
            self._process.kill()
            self._ended = Ended(Outcome.FAILED, "the player hung and was killed", left=False)
        self._process.wait()
        for pipe in (self._commands, self._messages, self._process.stderr):
            if pipe is not None:
                with suppress(OSError):
                    pipe.close()
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

    def _crashed(self) -> Ended:
        """Make the last message of a player that has left none."""
        assert self._process.stderr is not None
        words = self._process.stderr.read().decode(errors="replace").strip().splitlines()
        code = self._process.wait()
        how = f"signal {-code}" if code < 0 else f"exit code {code}"
        last = f": {words[-1]}" if words else ""
        return Ended(Outcome.FAILED, f"the player ended with {how}{last}", left=False)
