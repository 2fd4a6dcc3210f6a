"""Reads the watched variables, one after the other, as long as there are any."""

from __future__ import annotations

import asyncio
import time

from bcapscope.errors import BcapError
from bcapscope.protocol.variant import EMPTY, VT, Variant
from bcapscope.traffic.opened import Opened
from bcapscope.tui.desk.desk import Desk
from bcapscope.tui.desk.news import WatchNews
from bcapscope.tui.desk.record import Ending, Who, cause, why
from bcapscope.tui.desk.watch import Watched
from bcapscope.tui.words import say

INTERVAL = 0.5
"""Seconds from one reading to the next."""


class Watcher:
    """Watches variables of one desk.

    Attributes:
        watched: what is read, in the order in which it was added; the desk's thread changes it.
    """

    def __init__(self, desk: Desk, interval: float = INTERVAL) -> None:
        """Watch nothing yet."""
        self._desk = desk
        self._interval = interval
        self._task: asyncio.Task[None] | None = None
        self.watched: list[Watched] = []

    async def add(self, variable: Opened) -> None:
        """Watch a variable, too."""
        if all(each.handle != variable.handle for each in self.watched):
            parent = variable.parent
            label = f"{parent.label}.{variable.label}" if parent and parent.parent else variable.label
            self.watched.append(Watched(label, variable.handle))
        if self._task is None or self._task.done():
            self._task = asyncio.get_running_loop().create_task(self._run(), name="watch")

    async def remove(self, handle: int) -> None:
        """Watch a variable no more."""
        self.watched[:] = [each for each in self.watched if each.handle != handle]
        self._desk.tell(WatchNews())

    async def reset(self) -> None:
        """Forget extremes and courses."""
        for each in self.watched:
            each.reset()
        self._desk.tell(WatchNews())

    async def _run(self) -> None:
        while self.watched and self._desk.status.is_connected:
            for each in tuple(self.watched):
                await self._read(each)
            self._desk.tell(WatchNews())
            await asyncio.sleep(self._interval)
        self.watched.clear()
        self._desk.tell(WatchNews())

    async def _read(self, each: Watched) -> None:
        """Read one; in slave mode none, as other calls than set points may end it."""
        if self._desk.resting:
            each.fail(say("desk.resting"))
            return
        try:
            record = await self._desk.invoke("Variable_GetValue", Variant(VT.I4, each.handle), who=Who.WATCH)
        except (BcapError, OSError) as error:
            each.fail(cause(error))
            return
        if record.ending is Ending.ANSWERED and record.reply is not None:
            arguments = record.reply.arguments
            each.take(arguments[0].variant if arguments else EMPTY, time.monotonic_ns())
        else:
            each.fail(why(record))
