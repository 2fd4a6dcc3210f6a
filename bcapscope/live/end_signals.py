"""Signals that end programs."""

from __future__ import annotations

import asyncio
import signal
import socket
from collections.abc import Coroutine, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from types import FrameType
from typing import Any, TypeVar

from bcapscope.errors import FileWriteError

T = TypeVar("T")

_END_SIGNALS = [getattr(signal, name) for name in ("SIGTERM", "SIGHUP") if hasattr(signal, name)]


def interrupt_on_end_signals() -> None:
    """Let signals that end programs do as Ctrl-C does, and all is let go of."""
    for number in _END_SIGNALS:
        if signal.getsignal(number) is not signal.SIG_IGN:  # as nohup wants it
            signal.signal(number, _raise_interrupt)


def run_interruptible(work: Coroutine[Any, Any, T]) -> T:
    """Run a coroutine; what ends programs ends it between two steps, as Ctrl-C does, and all is let go of.

    Raises:
        KeyboardInterrupt: it was ended.
    """
    return asyncio.run(_interruptible(work))


async def _interruptible(work: Coroutine[Any, Any, T]) -> T:
    task, loop, ended = asyncio.current_task(), asyncio.get_running_loop(), asyncio.Event()
    assert task is not None

    def end() -> None:
        if not ended.is_set():
            ended.set()
            task.cancel()

    before = {number: signal.getsignal(number) for number in _END_SIGNALS}
    for number, handler in before.items():
        if handler is not signal.SIG_IGN:  # as nohup wants it
            with suppress(NotImplementedError):  # on Windows, where it ends as before
                loop.add_signal_handler(number, end)
    try:
        return await work
    except asyncio.CancelledError:
        if ended.is_set():
            raise KeyboardInterrupt from None
        raise
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


def _raise_interrupt(number: int, frame: FrameType | None) -> None:
    raise KeyboardInterrupt


@contextmanager
def end_signal_socket() -> Iterator[socket.socket]:
    """Let Ctrl-C and signals that end programs come only where they are waited for, in this block.

    Else they would end it between any two steps, such as between writing lines and forgetting them.

    Yields:
        A socket that does not wait, from which the number of each such signal can be read, a byte.

    Raises:
        FileWriteError: there are no file descriptors left.
    """
    try:
        here, there = socket.socketpair()
    except OSError as error:
        raise FileWriteError(Path("waiting for signals"), (error.strerror or str(error)).lower()) from None
    with here, there:
        here.setblocking(False)
        there.setblocking(False)
        before = {number: signal.getsignal(number) for number in (signal.SIGINT, *_END_SIGNALS)}
        wakened = signal.set_wakeup_fd(there.fileno(), warn_on_full_buffer=False)
        for number, handler in before.items():
            if handler is not signal.SIG_IGN:
                signal.signal(number, _do_nothing)
        try:
            yield here
        finally:
            for number, handler in before.items():
                signal.signal(number, handler)
            signal.set_wakeup_fd(wakened)


@contextmanager
def end_signals_blocked() -> Iterator[None]:
    """Start processes in this block that Ctrl-C does not reach while they load what they need.

    A terminal sends it to all that it runs, and who is just being loaded would end with a traceback. They
    are never reached by signals that end programs; here those of this block come after it.
    """
    if not hasattr(signal, "pthread_sigmask"):  # nor does such a process inherit anything on Windows
        yield
        return
    before = signal.pthread_sigmask(signal.SIG_BLOCK, (signal.SIGINT, *_END_SIGNALS))
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


def _do_nothing(number: int, frame: FrameType | None) -> None:
    """Do nothing more: the file descriptor has it already."""
