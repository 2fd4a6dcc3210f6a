"""Reads the watched variables in turn, while the user watches any."""

from __future__ import annotations

import asyncio
import time

from bcapscope.client.handle_table import ObjectHandle
from bcapscope.errors import BcapError
from bcapscope.live.controller.controller_session import ControllerSession
from bcapscope.live.controller.history_record import Initiator, RecordOutcome
from bcapscope.live.controller.session_updates import WatchUpdate
from bcapscope.protocol.codec.variant import EMPTY
from bcapscope.tui.controller_access.reason_text import error_text, failure_text
from bcapscope.tui.controller_access.watched_variable import WatchedVariable
from bcapscope.tui.reader_language import label

READ_INTERVAL = 0.5
"""Seconds between two reads."""


class VariableWatcher:
    """Watches variables through one session; only the session's thread changes `variables`."""

    def __init__(self, session: ControllerSession) -> None:
        self._session = session
        self._task: asyncio.Task[None] | None = None
        self.variables: list[WatchedVariable] = []

    async def add(self, variable: ObjectHandle) -> None:
        if all(each.handle != variable.handle for each in self.variables):
            parent = variable.parent
            label = f"{parent.label}.{variable.label}" if parent and parent.parent else variable.label
            self.variables.append(WatchedVariable(label, variable.handle))
        if self._task is None or self._task.done():
            self._task = asyncio.get_running_loop().create_task(self._run(), name="watch")

    async def remove(self, handle: int) -> None:
        self.variables[:] = [each for each in self.variables if each.handle != handle]
        self._session.report(WatchUpdate())

    async def reset(self) -> None:
        for each in self.variables:
            each.reset_extremes()
        self._session.report(WatchUpdate())

    async def _run(self) -> None:
        while self.variables and self._session.status.is_connected:
            for each in tuple(self.variables):
                await self._read_variable(each)
            self._session.report(WatchUpdate())
            await asyncio.sleep(READ_INTERVAL)
        self.variables.clear()
        self._session.report(WatchUpdate())

    async def _read_variable(self, variable: WatchedVariable) -> None:
        """Read one variable, but not in slave mode, which any call except a set point may end."""
        if self._session.polling_paused:
            variable.problem = label("controller.not-read")
            return
        try:
            record = await self._session.invoke(
                "Variable_GetValue", variable.handle, initiator=Initiator.WATCH
            )
        except (BcapError, OSError) as error:
            variable.problem = error_text(error)
            return
        if record.outcome is RecordOutcome.ANSWERED and record.reply is not None:
            arguments = record.reply.arguments
            variable.add_reading(arguments[0].variant if arguments else EMPTY, time.monotonic_ns())
        else:
            variable.problem = failure_text(record)
