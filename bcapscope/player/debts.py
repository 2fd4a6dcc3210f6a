"""What a visit has begun and has to end, however it ends."""

from __future__ import annotations

from collections.abc import Awaitable, Callable

from bcapscope.errors import BcapError, ControllerError, ExchangeTimeout
from bcapscope.player.channel import Channel
from bcapscope.player.desk import Desk
from bcapscope.player.messages import Debt, Owed, Trouble
from bcapscope.player.station import Station
from bcapscope.protocol.hresult import E_BUSY

_BUSY_FOR = 5_000_000_000
"""ns that a controller may be at work on a call that was given up; it takes no other meanwhile."""

_AGAIN = 20_000_000


class Debts:
    """Ends what was begun, the newest first, and tells of it, so that somebody else can.

    Attributes:
        gone: the controller does not answer any more, so that the rest is left to it.
    """

    def __init__(self, station: Station, desk: Desk, channel: Channel) -> None:
        """Begin with none."""
        self.gone = False
        self._station = station
        self._desk = desk
        self._channel = channel
        self._owed: list[Debt] = []

    async def begin(self, debt: Debt, step: Callable[[], Awaitable[None]]) -> None:
        """Begin what has to be ended.

        It has to be from before the call on, whose reply may be lost, unless the controller refuses it.
        """
        self.owe(debt)
        try:
            await step()
        except ControllerError:
            self.paid(debt)
            raise

    def owe(self, *debts: Debt) -> None:
        """Note what has to be ended, the oldest first."""
        self._owed += debts
        self._tell()

    async def settle(self) -> None:
        """End all of it; what the controller refuses is told, and the rest goes on."""
        while self._owed and not self.gone:
            debt = self._owed[-1]
            await self._end(debt)
            if not self.gone:
                self.paid(debt)

    async def _end(self, debt: Debt) -> None:
        give_up = self._channel.now() + _BUSY_FOR
        while True:
            try:
                return await self._station.end(debt)
            except (ExchangeTimeout, OSError):
                self.gone = True
                return
            except BcapError as error:
                busy = isinstance(error, ControllerError) and error.hresult == E_BUSY
                if not busy or self._channel.now() >= give_up:
                    self._desk.deliver(Trouble(f"while leaving: {error}"))
                    return
            self._channel.wait(self._channel.now() + _AGAIN)

    def paid(self, debt: Debt) -> None:
        """Note that something has ended."""
        self._owed.remove(debt)
        self._tell()

    def _tell(self) -> None:
        self._desk.deliver(Owed(tuple(self._owed), self._station.generation, self._channel.local[1]))
