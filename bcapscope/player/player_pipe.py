"""The player's end of the two pipes to its parent: the player reads orders and sends messages.

No method blocks while the player sends set points. If the parent's end of a pipe closes, the parent is gone,
and the player behaves as after an order to stop.
"""

from __future__ import annotations

import os
import select
import signal
import time
from types import FrameType

from bcapscope.messages import Message
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
"""Size, in bytes, of the largest write that a pipe never splits (PIPE_BUF on Linux)."""

_SEND_TIMEOUT = 2.0
"""Maximum time in seconds that `wait_until_sent` waits for the parent to read messages."""

_MAX_UNWRITTEN = 1 << 20
"""Number of bytes above which the player drops further messages until the parent reads."""

PARENT_GONE = Message("play.parent-gone")


class PlayerPipe:
    """Receives orders and sends messages through two pipes.

    `order` is the most serious order so far: HALT is more serious than STOP. `reason` says why this order was
    given.
    """

    def __init__(self, commands: int, messages: int) -> None:
        self.order: Order | None = None
        self.reason: Message | None = None
        self.order_count = 0
        self._commands = commands
        self._messages = messages
        self._partial_line = b""
        self._unwritten = b""
        self._answers: list[str] = []
        self._is_closed = False
        os.set_blocking(messages, False)

    def read_plan(self) -> PlayPlan:
        """Wait for the `PlayPlan` in the first line. Raise EOFError if the pipe closes during the wait."""
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
        """Treat signals as orders: SIGINT, SIGTERM and SIGHUP mean stop; after an earlier order, they mean
        halt. SIGUSR1 always means halt. If the parent blocked SIGUSR1 in the player, a SIGUSR1 that has
        already arrived takes effect now.
        """
        for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
            signal.signal(number, self._on_signal)
        signal.signal(signal.SIGUSR1, self._on_signal)
        signal.pthread_sigmask(signal.SIG_UNBLOCK, (signal.SIGUSR1,))

    def poll_order(self) -> Order | None:
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
        """Send a message if the pipe has room for it, else drop the message; return whether it was sent."""
        data = encode_message(message) + b"\n"
        if len(data) > _ATOMIC_WRITE_SIZE or not self._flush():
            return False
        self._unwritten = data
        if not self._flush():
            # the full pipe contains no part of the message, because a pipe never splits a short message
            self._unwritten = b""
            return False
        return True

    def send(self, message: PlayerMessage) -> None:
        """Send a message that must not be lost; a full pipe does not block the caller."""
        if len(self._unwritten) < _MAX_UNWRITTEN:
            self._unwritten += encode_message(message) + b"\n"
        self._flush()

    def wait_until_sent(self) -> None:
        """Wait up to `_SEND_TIMEOUT` seconds until all messages are sent or the parent is gone."""
        give_up = time.monotonic() + _SEND_TIMEOUT
        while not self._flush() and not self._is_closed and time.monotonic() < give_up:
            select.select((), (self._messages,), (), _SEND_TIMEOUT)

    def ask(self, question: PlayerQuestion) -> str:
        """Send a question and return the user's answer. Return the first of `question.choices` if the user
        sends an `Order` instead of an answer, or if the answer is not among the choices.
        """
        self._answers.clear()
        self.send(question)
        while self.poll_order() is None and not self._answers:
            is_sent = self._flush()
            select.select((self._commands,), () if is_sent else (self._messages,), (), 0.5)
        answer = self._answers.pop(0) if self._answers else ""
        return answer if answer in question.choices else question.choices[0]

    def set_order(self, order: Order, reason: Message) -> None:
        """Store an order, but never replace an order to halt with an order to stop."""
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
                self.set_order(command.order, Message("play.order", order=str(command.order)))

    def _flush(self) -> bool:
        """Write the pending bytes; return whether all are written."""
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
        reason = Message("play.signal", signal=signal.Signals(number).name)
        if asked:
            reason = Message("play.order", order=str(Order.HALT))
        self.set_order(Order.HALT if asked or self.order is not None else Order.STOP, reason)
