"""Signals that end programs."""

from __future__ import annotations

import signal
import socket
from collections.abc import Iterator
from contextlib import contextmanager
from types import FrameType

_ENDS = [getattr(signal, name) for name in ("SIGTERM", "SIGHUP") if hasattr(signal, name)]


def end_in_order() -> None:
    """Let signals that end programs do as Ctrl-C does, so that all is let go of."""
    for number in _ENDS:
        if signal.getsignal(number) is not signal.SIG_IGN:  # as nohup wants it
            signal.signal(number, _terminate)


def _terminate(number: int, frame: FrameType | None) -> None:
    raise KeyboardInterrupt


@contextmanager
def awaited_ends() -> Iterator[int]:
    """Let Ctrl-C and signals that end programs come only where they are waited for, in this block.

    Else they would end it between any two steps, such as between writing lines and forgetting them.

    Yields:
        A file descriptor that can be read once there was such a signal.
    """
    here, there = socket.socketpair()
    with here, there:
        there.setblocking(False)
        before = {number: signal.getsignal(number) for number in (signal.SIGINT, *_ENDS)}
        wakened = signal.set_wakeup_fd(there.fileno(), warn_on_full_buffer=False)
        for number, handler in before.items():
            if handler is not signal.SIG_IGN:
                signal.signal(number, _note)
        try:
            yield here.fileno()
        finally:
            for number, handler in before.items():
                signal.signal(number, handler)
            signal.set_wakeup_fd(wakened)


def _note(number: int, frame: FrameType | None) -> None:
    """Do nothing more: the file descriptor has it already."""
