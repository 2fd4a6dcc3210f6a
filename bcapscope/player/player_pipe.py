"""The player's end of the pipes to the program that started it: orders in, messages out.

Nothing here ever waits while set points are sent. When the other end is gone, which is how the end of the
program that started us shows, that is an order to stop.
"""

from __future__ import annotations

import os
import select
import signal
import time
from types import FrameType

from bcapscope.player.player_messages import (
    Order,
    PlayerCommand,
    PlayerMessage,
    PlayerQuestion,
    PlayPlan,
    decode_command,
    decode_plan,
    encode_message,
)

_ATOMIC_WRITE_SIZE = 4096
"""Bytes that a pipe takes whole or not at all (PIPE_BUF on Linux)."""

_SEND_TIMEOUT = 2.0
"""Seconds that the last messages wait for a reader."""

_MAX_UNWRITTEN = 1 << 20
"""Bytes that wait for a reader at most; what comes then is lost."""

PARENT_GONE = "the program that started the player is gone"


class PlayerPipe:
    """Takes orders and tells what happens.

    Attributes:
        order: the gravest so far; None while there is none.
        reason: why, in words.
        order_count: how many there were.
    """

    def __init__(self, commands: int, messages: int) -> None:
        """Use these file descriptors, both pipes."""
        self.order: Order | None = None
        self.reason = ""
        self.order_count = 0
        self._commands = commands
        self._messages = messages
        self._partial_line = b""
        self._unwritten = b""
        self._answers: list[str] = []
        self._is_closed = False
        os.set_blocking(messages, False)

    def read_plan(self) -> PlayPlan:
        """Wait for the plan, which comes first.

        Raises:
            EOFError: there was none.
            msgspec.ValidationError: it is none.
        """
        parts = []
        newline = rest = b""
        while not newline:
            data = os.read(self._commands, 1 << 20)
            if not data:
                raise EOFError("no plan came")
            part, newline, rest = data.partition(b"\n")
            parts.append(part)
        os.set_blocking(self._commands, False)
        if rest:
            self._feed_bytes(rest)
        return decode_plan(b"".join(parts))

    def install_signal_handlers(self) -> None:
        """Take SIGINT, SIGTERM and SIGHUP as orders to stop, each further one and SIGUSR1 to halt.

        A SIGUSR1 that came before counts now, if whoever started us let it wait.
        """
        for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
            signal.signal(number, self._on_signal)
        signal.signal(signal.SIGUSR1, self._on_signal)
        signal.pthread_sigmask(signal.SIG_UNBLOCK, (signal.SIGUSR1,))

    def poll_order(self) -> Order | None:
        """Look whether there is an order; never waits."""
        if not self._is_closed:
            try:
                data = os.read(self._commands, _ATOMIC_WRITE_SIZE)
            except BlockingIOError:
                data = None
            except OSError:
                data = b""
            if data is not None:
                self._feed_bytes(data)
        return self.order

    def try_send(self, message: PlayerMessage) -> bool:
        """Tell something that may be left out; return whether it went out."""
        data = encode_message(message) + b"\n"
        if len(data) > _ATOMIC_WRITE_SIZE or not self._flush():
            return False
        self._unwritten = data
        if not self._flush():
            self._unwritten = b""  # nothing of it went out, since a pipe takes so much whole or not at all
            return False
        return True

    def send(self, message: PlayerMessage) -> None:
        """Tell something that must not be left out; it waits for a reader, and nobody waits for it."""
        if len(self._unwritten) < _MAX_UNWRITTEN:
            self._unwritten += encode_message(message) + b"\n"
        self._flush()

    def wait_until_sent(self) -> None:
        """Wait until all is told, or nobody reads any more."""
        give_up = time.monotonic() + _SEND_TIMEOUT
        while not self._flush() and not self._is_closed and time.monotonic() < give_up:
            select.select((), (self._messages,), (), _SEND_TIMEOUT)

    def ask(self, question: PlayerQuestion) -> str:
        """Ask and wait for the answer; the first choice where there is an order instead, or nobody."""
        self._answers.clear()
        self.send(question)
        while self.poll_order() is None and not self._answers:
            told = self._flush()
            select.select((self._commands,), () if told else (self._messages,), (), 0.5)
        answer = self._answers.pop(0) if self._answers else ""
        return answer if answer in question.choices else question.choices[0]

    def set_order(self, order: Order, reason: str) -> None:
        """Take an order; a halt outweighs a stop."""
        self.order_count += 1
        if self.order is not Order.HALT:
            self.reason = self.reason if self.order is order else reason
            self.order = order

    def _feed_bytes(self, data: bytes) -> None:
        if not data:
            self._on_closed()
        *lines, self._partial_line = (self._partial_line + data).split(b"\n")
        for line in lines:
            command: PlayerCommand = decode_command(line)
            if command.order is None:
                self._answers.append(command.answer)
            else:
                self.set_order(command.order, f"{command.order} was asked for")

    def _flush(self) -> bool:
        """Write what is unwritten; return whether that is done."""
        while self._unwritten and not self._is_closed:
            try:
                written = os.write(self._messages, self._unwritten)
            except BlockingIOError:
                return False
            except OSError:
                self._on_closed()
                break
            self._unwritten = self._unwritten[written:]
        return not self._is_closed

    def _on_closed(self) -> None:
        self._is_closed = True
        self._partial_line = self._unwritten = b""
        self.set_order(Order.STOP, PARENT_GONE)

    def _on_signal(self, number: int, frame: FrameType | None) -> None:
        asked = number == signal.SIGUSR1
        reason = f"{Order.HALT} was asked for" if asked else f"{signal.Signals(number).name} came"
        self.set_order(Order.HALT if asked or self.order is not None else Order.STOP, reason)
