"""Signals that end programs."""

from __future__ import annotations

import asyncio
import signal
import socket
from collections.abc import Coroutine, Iterator
from contextlib import contextmanager, suppress
from typing import Any, TypeVar

from bcapscope.errors import FileWriteError
from bcapscope.messages import Message
from bcapscope.messages.os_errors import os_reason

T = TypeVar("T")

_END_SIGNALS = [getattr(signal, name) for name in ("SIGTERM", "SIGHUP") if hasattr(signal, name)]


def interrupt_on_end_signals() -> None:
    """Treat SIGTERM and SIGHUP like Ctrl-C, so that the program releases its resources."""
    for number in _END_SIGNALS:
        if signal.getsignal(number) is not signal.SIG_IGN:  # SIG_IGN was set by nohup
            signal.signal(number, signal.default_int_handler)


def run_interruptible(work: Coroutine[Any, Any, T]) -> T:
    """Run a coroutine. SIGTERM or SIGHUP cancels the coroutine, then raises KeyboardInterrupt."""
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
        if handler is not signal.SIG_IGN:  # SIG_IGN was set by nohup
            with suppress(NotImplementedError):  # on Windows, an event loop cannot handle signals
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


@contextmanager
def end_signal_socket() -> Iterator[socket.socket]:
    """Yield a non-blocking socket that receives the signal's number, as a byte, for Ctrl-C, SIGTERM and
    SIGHUP.

    A signal therefore cannot end the program between two steps that belong together. Raises FileWriteError.
    """
    try:
        here, there = socket.socketpair()
    except OSError as error:
        raise FileWriteError(Message("proxy.part.signals"), os_reason(error)) from None
    with here, there:
        here.setblocking(False)
        there.setblocking(False)
        before = {number: signal.getsignal(number) for number in (signal.SIGINT, *_END_SIGNALS)}
        wakened = signal.set_wakeup_fd(there.fileno(), warn_on_full_buffer=False)
        for number, handler in before.items():
            if handler is not signal.SIG_IGN:
                # Python writes the signal's number to the socket before it calls this handler.
                signal.signal(number, lambda *_: None)
        try:
            yield here
        finally:
            for number, handler in before.items():
                signal.signal(number, handler)
            signal.set_wakeup_fd(wakened)


@contextmanager
def end_signals_blocked() -> Iterator[None]:
    """Child processes that start in this `with` block never receive Ctrl-C, SIGTERM or SIGHUP.

    Without this protection, Ctrl-C would reach every process of the terminal, and a child process that is
    still loading would end with a traceback. Signals to the parent process take effect when the `with` block
    ends.
    """
    if not hasattr(signal, "pthread_sigmask"):  # on Windows, child processes inherit no signal mask
        yield
        return
    before = signal.pthread_sigmask(signal.SIG_BLOCK, (signal.SIGINT, *_END_SIGNALS))
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)
