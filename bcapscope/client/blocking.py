"""Use the client from code without asyncio: run each coroutine of the client to its end."""

from __future__ import annotations

import asyncio
from collections.abc import Coroutine
from contextlib import AbstractAsyncContextManager, AsyncExitStack
from types import TracebackType
from typing import Any, Self, TypeVar

R = TypeVar("R")


class Blocking:
    """Runs coroutines to their end. The end of the `with` block also exits every context manager that was
    passed to `enter`.

        with Blocking() as wait:
            service = wait.enter(connect(over_udp("192.168.0.1")))
            controller = wait(service.connect())

    The result of `wait(coroutine)` has the type that the coroutine returns.
    """

    def __init__(self, runner: asyncio.Runner | None = None) -> None:
        """Without `runner`, create an event loop; otherwise use the event loop of `runner`."""
        self._runner = runner or asyncio.Runner()
        self._stack = AsyncExitStack()

    def __call__(self, step: Coroutine[Any, Any, R]) -> R:
        """Run the coroutine `step` to its end and return its result."""
        return self._runner.run(step)

    def enter(self, context: AbstractAsyncContextManager[R]) -> R:
        """Enter an asynchronous context manager, and return the result of its `__aenter__`."""
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
