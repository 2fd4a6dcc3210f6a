"""The b-CAP service, which the client starts before any other call."""

from __future__ import annotations

from collections.abc import AsyncIterator
from contextlib import asynccontextmanager

from bcapscope.client.caller import EventListener, Observer
from bcapscope.client.remote_object import handle_of
from bcapscope.client.remote_objects import Controller
from bcapscope.client.retry_policies import DEFAULT_RETRY_POLICIES, RetryPolicies
from bcapscope.client.session import LinkOpener, Session, open_session
from bcapscope.protocol.retry.reserved_convention import ReservedConvention


class Service:
    """The b-CAP service of a controller."""

    def __init__(self, session: Session) -> None:
        self.session = session

    async def start(self, option: str = "") -> None:
        """Service_Start: start the service.

        The option ``,WDT=400`` requests a notice every 400 ms during a long call.
        """
        await self.session.invoke("Service_Start", option)

    async def stop(self) -> None:
        """Service_Stop: stop the service.

        Without this call, the session stops the service at the end of its block.
        """
        await self.session.invoke("Service_Stop")

    async def connect(
        self, name: str = "", provider: str = "", machine: str = "", option: str = ""
    ) -> Controller:
        """Controller_Connect: RC7 ignores all four arguments; RC8 and later need the provider.

        The provider is ``CaoProv.DENSO.VRC``, or ``CaoProv.DENSO.VRC9`` on RC9 and COBOTTA PRO; the machine
        is ``localhost``. For an empty name, the controller chooses a name. An option is ``@IfNotMember``.
        """
        reply = await self.session.invoke("Controller_Connect", name, provider, machine, option)
        return Controller(self.session, handle_of(reply))


@asynccontextmanager
async def connect(
    open_link: LinkOpener,
    option: str = "",
    *,
    convention: ReservedConvention | None = None,
    retry_policies: RetryPolicies = DEFAULT_RETRY_POLICIES,
    observer: Observer | None = None,
    listener: EventListener | None = None,
) -> AsyncIterator[Service]:
    """Open a session like `open_session`, and start the service in it with `option`."""
    async with open_session(
        open_link, convention=convention, retry_policies=retry_policies, observer=observer, listener=listener
    ) as session:
        service = Service(session)
        await service.start(option)
        yield service
