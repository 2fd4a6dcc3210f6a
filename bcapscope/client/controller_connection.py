"""Connect a Python program to a controller in one step, with or without asyncio."""

from __future__ import annotations

from collections.abc import AsyncIterator
from contextlib import AbstractAsyncContextManager, ExitStack, asynccontextmanager
from types import TracebackType

from bcapscope.client.blocking import Blocking
from bcapscope.client.controller_target import (
    DEFAULT_PORT,
    DEFAULT_RETRIES,
    DEFAULT_TIMEOUT_MS,
    ControllerTarget,
)
from bcapscope.client.remote_objects import Controller, Service
from bcapscope.client.session import open_target_session


class ControllerConnection:
    """A connection to a controller. A `with` or `async with` block opens the connection when the block
    starts, and closes the connection when the block ends.

    `async with` returns the controller, whose methods are coroutines. `with` returns two values: a
    `Blocking`, which runs a coroutine to its end, and the controller. When the block ends, all objects that
    were opened in the block are released, newest first.
    """

    def __init__(self, target: ControllerTarget) -> None:
        self.target = target
        self._opened = ExitStack()

    async def __aenter__(self) -> Controller:
        """Connect.

        Raises:
            CallTimeout: The controller does not answer.
            ControllerError: The controller refused a call.
            OSError: The controller cannot be reached.
        """
        self._connected: AbstractAsyncContextManager[Controller] = _connected(self.target)
        return await self._connected.__aenter__()

    async def __aexit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        await self._connected.__aexit__(kind, error, trace)

    def __enter__(self) -> tuple[Blocking, Controller]:
        """Connect as `async with` does. Do not use `with` in code that an event loop runs."""
        with ExitStack() as opened:
            wait = opened.enter_context(Blocking())
            controller = wait.enter(self)
            self._opened = opened.pop_all()
        return wait, controller

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._opened.__exit__(kind, error, trace)


@asynccontextmanager
async def _connected(target: ControllerTarget) -> AsyncIterator[Controller]:
    async with open_target_session(target) as session:
        service = Service(session)
        await service.start(target.service)
        yield await service.connect(*target.connect)


def connect_controller(
    host: str,
    port: int = DEFAULT_PORT,
    *,
    tcp: bool = False,
    provider: str = "CaoProv.DENSO.VRC",
    name: str = "",
    option: str = "",
    timeout: float = DEFAULT_TIMEOUT_MS,
    retries: int = DEFAULT_RETRIES,
) -> ControllerConnection:
    """Return a connection to a controller, for `with` or `async with`.

        async with bcapscope.connect("192.168.0.1") as controller:
            robot = await controller.get_robot("Arm")

        with bcapscope.connect("192.168.0.1") as (wait, controller):
            robot = wait(controller.get_robot("Arm"))

    Args:
        host: Name or address of the controller.
        port: Port of the controller; 5007 by default.
        tcp: Whether to use TCP instead of UDP.
        provider: Provider name for Controller_Connect; RC9 and COBOTTA PRO need `CaoProv.DENSO.VRC9`.
        name: Name of the connection; if it is "", the controller chooses a name.
        option: Option of Service_Start, such as `,WDT=400`.
        timeout: Time to wait for a reply before each retry, in ms; 1000 by default. Over UDP, this timeout
            does not apply to slvMove, whose timeout is shorter.
        retries: Maximum number of retries over UDP for calls other than slvMove; 4 by default.
    """
    target = ControllerTarget(host, port, tcp, timeout, retries, service=option, name=name, provider=provider)
    return ControllerConnection(target)
