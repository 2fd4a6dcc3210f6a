"""Context managers that work with `with` and with `async with`."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable
from types import TracebackType
from typing import Self


class ThreadedContext(ABC):
    """A resource that opens and closes with a `with` or an `async with` block.

    With `async with`, a thread opens and closes the resource, so that the event loop continues. If the task
    is cancelled, the resource is closed before the cancellation continues.
    """

    @abstractmethod
    def _open(self) -> None:
        """Acquire the resource. If the resource cannot be acquired, release everything and raise an
        exception.
        """

    @abstractmethod
    def _close(self) -> None:
        """Release everything."""

    def __enter__(self) -> Self:
        self._open()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._close()

    async def __aenter__(self) -> Self:
        if await _was_cancelled_during(self._open):
            await _was_cancelled_during(self._close)
            raise _cancellation()
        return self

    async def __aexit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if await _was_cancelled_during(self._close):
            raise _cancellation()


async def _was_cancelled_during(work: Callable[[], None]) -> bool:
    """Run `work` in a thread to its end; return whether the asyncio task was cancelled meanwhile."""
    import asyncio

    task, is_cancelled = asyncio.ensure_future(asyncio.to_thread(work)), False
    while not task.done():
        try:
            await asyncio.wait([task])
        except asyncio.CancelledError:
            is_cancelled = True
    task.result()
    return is_cancelled


def _cancellation() -> BaseException:
    import asyncio

    return asyncio.CancelledError()
