"""Whether a fault strikes a message: its time, direction, condition, try and lot."""

from __future__ import annotations

import random
from collections.abc import Callable

from bcapscope.faults.fault import Fault
from bcapscope.faults.message import Message
from bcapscope.traffic.getters import FRAME_GETTERS, Told


class Striker:
    """Decides for one fault; nothing but the messages, the clock and its own random numbers has a say.

    Attributes:
        fault: for which it decides.
        name: of the fault.
        lots: the random numbers of this fault alone.
        on: whether it strikes at all; may be switched.
        struck: how often it has struck.
        ends: when it stops striking, ns; None for never.
    """

    def __init__(self, fault: Fault, name: str, seed: int, now: int) -> None:
        self.fault = fault
        self.name = name
        self.lots = random.Random(f"{seed} {name}")
        self.on = True
        self.struck = 0
        self._begins = now + fault.after
        self.ends = None if fault.lasts is None else self._begins + fault.lasts
        self._test: Callable[[Told], bool] | None = None
        if fault.when is not None:
            self._test = fault.when.filter.bind(FRAME_GETTERS)
        self._left = fault.times

    @property
    def learns(self) -> bool:
        """Whether it must know what was asked before, or which try a frame is."""
        when = self.fault.when
        asks = when is not None and not when.filter.sources.isdisjoint(_ABOUT_QUESTIONS)
        return asks or self.fault.attempt is not None

    def is_over(self, now: int) -> bool:
        """Tell whether it has struck for the last time."""
        return self._left == 0 or (self.ends is not None and now >= self.ends)

    def matches(self, message: Message) -> bool:
        """Tell whether all but the lot is for striking."""
        if not self.on or self._left == 0 or not self._begins <= message.now:
            return False
        fault = self.fault
        if self.ends is not None and message.now >= self.ends:
            return False
        if fault.direction is not None and message.flow.direction is not fault.direction:
            return False
        if self._test is None and fault.attempt is None:
            return True
        return any(self._suits(message, index) for index in range(len(message.told)))

    def wins(self) -> bool:
        """Draw the lot."""
        share = self.fault.probability
        return share >= 1 or self.lots.random() < share

    def count(self) -> None:
        """Take notice that it has struck."""
        self.struck += 1
        if self._left:
            self._left -= 1

    def _suits(self, message: Message, index: int) -> bool:
        attempt = self.fault.attempt
        if attempt is not None and (not message.attempts or message.attempts[index] != attempt):
            return False
        return self._test is None or self._test(message.told[index])


_ABOUT_QUESTIONS = ("function_id", "function", "command")
