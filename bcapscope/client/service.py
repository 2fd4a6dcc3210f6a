"""The service session, which every conversation begins with."""

from __future__ import annotations

from collections.abc import AsyncIterator
from contextlib import asynccontextmanager

from bcapscope.client.caller import Listener, Observer
from bcapscope.client.objects import Controller, handle_of
from bcapscope.client.paces import PACES, Paces
from bcapscope.client.session import Opener, Session, open_session
from bcapscope.protocol.convention import Convention


class Service:
    """The b-CAP service of a controller."""

    def __init__(self, session: Session) -> None:
        self.session = session

    async def start(self, option: str = "") -> None:
        """Service_Start: begin, with options such as ``,WDT=400`` for a notice each 400 ms of a long call."""
        await self.session.invoke("Service_Start", option)

    async def stop(self) -> None:
        """Service_Stop: end; done by itself at the end of the session's block."""
        await self.session.invoke("Service_Stop")

    async def connect(
        self, name: str = "", provider: str = "", machine: str = "", option: str = ""
    ) -> Controller:
        """Controller_Connect: RC7 ignores all four, RC8 and later need the provider.

        Args:
            name: any; "" gives an automatic one.
            provider: ``CaoProv.DENSO.VRC``, or ``CaoProv.DENSO.VRC9`` on RC9 and COBOTTA PRO.
            machine: ``localhost``.
            option: such as ``@IfNotMember``.
        """
        reply = await self.session.invoke("Controller_Connect", name, provider, machine, option)
        return Controller(self.session, handle_of(reply))


@asynccontextmanager
async def connect(
    open_link: Opener,
    option: str = "",
    *,
    convention: Convention | None = None,
    paces: Paces = PACES,
    observer: Observer | None = None,
    listener: Listener | None = None,
) -> AsyncIterator[Service]:
    """Open a session, as `open_session`, and start the service in it with `option`."""
    async with open_session(
        open_link, convention=convention, paces=paces, observer=observer, listener=listener
    ) as session:
        service = Service(session)
        await service.start(option)
        yield service
