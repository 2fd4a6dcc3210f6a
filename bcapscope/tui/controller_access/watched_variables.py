"""Read the watched variables one after the other, and keep their latest readings."""

from __future__ import annotations

import asyncio
import time
from collections import deque
from dataclasses import dataclass, field

from bcapscope.client.handle_table import ObjectHandle
from bcapscope.errors import BcapError
from bcapscope.live.controller.controller_session import ControllerSession
from bcapscope.live.controller.history_record import Initiator, RecordOutcome
from bcapscope.live.controller.session_updates import WatchUpdate
from bcapscope.protocol.codec.variant import ARRAY, EMPTY, VT, Variant
from bcapscope.tui.controller_access.call_history import error_text, failure_text
from bcapscope.tui.reader_language import label

MAX_READINGS = 120  # in the sparkline
_SECOND = 1_000_000_000
_FRACTIONAL_TYPES = frozenset({VT.R4, VT.R8, VT.DATE})


@dataclass(slots=True)
class WatchSeries:
    """Readings of one number over time: the value of a variable, or one element of an array."""

    readings: deque[tuple[int, float]] = field(default_factory=lambda: deque(maxlen=MAX_READINGS))
    minimum: float | None = None
    maximum: float | None = None

    def add(self, time: int, value: float) -> None:
        """Add a reading. `time` is in ns; all readings must use the same clock."""
        self.readings.append((time, value))
        self.minimum = value if self.minimum is None else min(self.minimum, value)
        self.maximum = value if self.maximum is None else max(self.maximum, value)

    @property
    def last(self) -> float | None:
        return self.readings[-1][1] if self.readings else None

    @property
    def rate(self) -> float | None:
        """Change per second between the last two readings; None before the second reading."""
        if len(self.readings) < 2:
            return None
        (before, was), (now, value) = self.readings[-2], self.readings[-1]
        return (value - was) * _SECOND / (now - before) if now > before else None


@dataclass(slots=True)
class WatchedVariable:
    """A variable that the Tester reads again and again, with its latest readings."""

    label: str  # such as `Gundam.@CURRENT_ANGLE`
    handle: int
    value: Variant | None = None
    problem: str = ""  # why the last reading failed; empty if it succeeded
    series: list[WatchSeries] = field(default_factory=list)  # one series for each number in the value

    @property
    def decimals(self) -> int:
        return 5 if self.value is not None and self.value.vt & ~ARRAY in _FRACTIONAL_TYPES else 0

    def add_reading(self, value: Variant, time: int) -> None:
        self.value, self.problem = value, ""
        numbers = _numbers(value)
        if len(numbers) != len(self.series):
            self.series = [WatchSeries() for _ in numbers]
        for series, number in zip(self.series, numbers, strict=True):
            series.add(time, number)

    def reset_extremes(self) -> None:
        self.series = [WatchSeries() for _ in self.series]


def _numbers(variant: Variant) -> list[float]:
    """Return the numbers in a value; [] if the value or an element of the value is not a number."""
    values = variant.value if isinstance(variant.value, tuple) else (variant.value,)
    numbers = [float(each) for each in values if isinstance(each, bool | int | float)]
    return numbers if len(numbers) == len(values) else []


READ_INTERVAL = 0.5  # seconds


class VariableWatcher:
    """Watches variables through a `ControllerSession`; only the session's thread changes `variables`."""

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
        if self._session.polling_paused:  # in slave mode, any call except a set point may end slave mode
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
