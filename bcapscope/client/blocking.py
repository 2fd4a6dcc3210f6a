"""For code without async: run each step to its end."""

from __future__ import annotations

import asyncio
from collections.abc import Coroutine
from contextlib import AbstractAsyncContextManager, AsyncExitStack
from types import TracebackType
from typing import Any, Self, TypeVar

R = TypeVar("R")


class Blocking:
    """Waits for what is asynchronous; whatever was entered is left at the end of the block.

        with Blocking() as wait:
            service = wait.enter(connect(over_udp("192.168.0.1")))
            controller = wait(service.connect())

    Types are those of the asynchronous methods, since there are no others.
    """

    def __init__(self, runner: asyncio.Runner | None = None) -> None:
        """Run in an event loop of its own, or in that of `runner`."""
        self._runner = runner or asyncio.Runner()
        self._stack = AsyncExitStack()

    def __call__(self, step: Coroutine[Any, Any, R]) -> R:
        """Wait for one step and return what it returns."""
        return self._runner.run(step)

    def enter(self, context: AbstractAsyncContextManager[R]) -> R:
        """Enter a block that is left at the end of ours."""
        return self._runner.run(self._stack.enter_async_context(context))

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> bool:
        try:
            return bool(self._runner.run(self._stack.__aexit__(kind, error, trace)))
        finally:
            self._runner.close()
