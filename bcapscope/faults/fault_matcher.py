"""Decides whether a fault hits a message."""

from __future__ import annotations

import random
from collections.abc import Callable

from bcapscope.faults.fault import Fault
from bcapscope.faults.wire_message import WireMessage
from bcapscope.traffic.filter.getters import FRAME_GETTERS, AnnotatedFrame


class FaultMatcher:
    """Decides which messages a fault hits. The fault ends at the time `ends_at` in ns; None for never."""

    def __init__(self, fault: Fault, name: str, seed: int, now: int) -> None:
        self.fault = fault
        self.name = name
        self.rng = random.Random(f"{seed} {name}")
        self.enabled = True
        self.hit_count = 0
        self._begins_at = now + fault.after
        self.ends_at = None if fault.lasts is None else self._begins_at + fault.lasts
        self._test: Callable[[AnnotatedFrame], bool] | None = None
        if fault.when is not None:
            self._test = fault.when.filter.bind(FRAME_GETTERS)
        self._hits_left = fault.times
        self.needs_pairing = _needs_pairing(fault)

    def can_hit(self, now: int) -> bool:
        """Return whether the fault can hit a message now or later."""
        return self.enabled and self._hits_left != 0 and (self.ends_at is None or now < self.ends_at)

    def matches(self, message: WireMessage) -> bool:
        """Return whether the message fulfils every condition except the probability."""
        if not self.can_hit(message.now) or message.now < self._begins_at:
            return False
        fault = self.fault
        if fault.direction is not None and message.flow.direction is not fault.direction:
            return False
        if self._test is None and fault.attempt is None:
            return True
        test, frames = self._test, message.annotated_frames
        numbers = message.attempt_numbers or (None,) * len(frames)
        return any(
            (fault.attempt is None or number == fault.attempt) and (test is None or test(frame))
            for frame, number in zip(frames, numbers, strict=True)
        )

    def draw(self) -> bool:
        """Decide at random whether the fault hits. If the fault's probability is 1, draw no random number."""
        share = self.fault.probability
        return share >= 1 or self.rng.random() < share

    def count_hit(self) -> None:
        self.hit_count += 1
        if self._hits_left:
            self._hits_left -= 1


def _needs_pairing(fault: Fault) -> bool:
    """Return whether the fault's conditions need the request of each reply, or the attempt of each frame."""
    when = fault.when
    asks = when is not None and not when.filter.getter_names.isdisjoint(_NEEDS_REQUEST)
    return asks or fault.attempt is not None


_NEEDS_REQUEST = ("function_id", "function", "command")
