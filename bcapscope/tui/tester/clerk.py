"""Does at the desk what the widgets want, and tells them what became of it."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable, Coroutine
from typing import Any

from bcapscope.errors import BcapError
from bcapscope.protocol.functions import FUNCTIONS, Function, ObjectClass
from bcapscope.protocol.variant import VT, Variant
from bcapscope.render.escape import printable
from bcapscope.traffic.opened import Opened
from bcapscope.tui.desk.connecting import add_robot, start_robslave
from bcapscope.tui.desk.desk import Desk, NotArmedError, handle_variant
from bcapscope.tui.desk.record import Record, cause
from bcapscope.tui.desk.saved import Saved, takes_handle
from bcapscope.tui.tester.messages import Asker, CallWanted, OpenWanted
from bcapscope.tui.words import say

Step = Callable[[], Coroutine[Any, Any, Record]]

_RELEASES = {function.releases: function for function in FUNCTIONS.values() if function.releases}


class MissingError(BcapError):
    """What a call is to be made of is not open."""


class Clerk:
    """Between the screen and the desk; its coroutines are for the screen's event loop."""

    def __init__(self, desk: Desk, arm: Callable[[], Awaitable[bool]]) -> None:
        """Take the desk, and what asks the user to arm."""
        self._desk = desk
        self._arm = arm

    async def call(self, wish: CallWanted) -> None:
        """Make a call."""
        await self.make(wish.asker, wish.function, wish.values, wish.subject)

    async def make(
        self, asker: Asker, function: Function, values: tuple[Variant, ...], subject: Opened | None = None
    ) -> None:
        """Make a call with arguments that have no handle yet."""

        async def step() -> Record:
            handle = (self._handle(function, subject),) if takes_handle(function) else ()
            return await self._desk.call(function, (*handle, *values))

        await self._told(asker, step)

    async def again(self, asker: Asker, record: Record) -> None:
        """Make a call once more as it was, its handle included."""
        function = FUNCTIONS.get(record.function_id)
        if function is None:
            await self.raw(asker, record.sent[0].item.raw if record.sent else b"")
            return
        await self._told(asker, lambda: self._desk.call(function, record.arguments))

    async def saved(self, asker: Asker, saved: Saved) -> None:
        """Make a saved request."""
        await self.make(asker, saved.function, saved.values)

    async def raw(self, asker: Asker, raw: bytes) -> None:
        """Send bytes as they are."""
        await self._told(asker, lambda: self._desk.send_raw(raw))

    async def open(self, wish: OpenWanted) -> bool:
        """Open an object; a robot is chosen then, and its type read."""
        desk = self._desk

        async def step() -> Record:
            if wish.kind is ObjectClass.ROBOT:
                return await add_robot(desk, wish.name, wish.option)
            parent = self._parent(wish.parent)
            values = (handle_variant(parent), Variant(VT.BSTR, wish.name), Variant(VT.BSTR, wish.option))
            return await desk.invoke(f"{wish.parent}_Get{wish.kind}", *values)

        return await self._told(wish.asker, step)

    async def release(self, wish: OpenWanted) -> None:
        """Release the object of that name."""
        name = wish.name.casefold()
        found = [one for one in self._desk.status.open if one.kind is wish.kind]
        subject = next((one for one in reversed(found) if one.label.casefold() == name), None)
        if subject is None:
            wish.asker.fail(say("tester.release.missing", name=printable(wish.name)))
            return
        await self.make(wish.asker, _RELEASES[wish.kind], (), subject)

    async def robslave(self, asker: Asker) -> None:
        """Open the task RobSlave and start it."""
        await self._told(asker, lambda: start_robslave(self._desk))

    def _handle(self, function: Function, subject: Opened | None) -> Variant:
        """Return the handle of what is chosen, or of the latest of its class."""
        owner, status = function.owner, self._desk.status
        if subject is None and owner is ObjectClass.ROBOT:
            subject = status.robot
        if subject is None:
            subject = next((one for one in reversed(status.open) if one.kind is owner), None)
        if subject is None:
            key = "tester.missing" if status.is_connected else "tester.not_connected"
            raise MissingError(say(key, kind=owner))
        return handle_variant(subject)

    def _parent(self, kind: ObjectClass) -> Opened:
        found = self._desk.status.robot if kind is ObjectClass.ROBOT else None
        found = found or next((one for one in reversed(self._desk.status.open) if one.kind is kind), None)
        if found is None:
            key = "tester.missing" if self._desk.status.is_connected else "tester.not_connected"
            raise MissingError(say(key, kind=kind))
        return found

    async def _told(self, asker: Asker, step: Step) -> bool:
        """Do something and tell whoever wanted it; arm first where that is needed.

        Returns:
            Whether it was done, however it ended.
        """
        asker.begin()
        try:
            asker.take(await self._armed(step))
        except asyncio.CancelledError:
            asker.fail(say("tester.cancelled"))
            raise
        except NotArmedError:
            asker.fail(say("tester.not_armed"))
        except (BcapError, OSError) as error:
            asker.fail(cause(error))
        else:
            return True
        return False

    async def _armed(self, step: Step) -> Record:
        try:
            return await self._desk.do(step())
        except NotArmedError:
            if not await self._arm():
                raise
        return await self._desk.do(step())
