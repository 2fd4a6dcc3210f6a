"""Messages that are held until someone sends them on, edited or not, or drops them."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

from bcapscope.faults.message import Message
from bcapscope.faults.quantities import Condition
from bcapscope.protocol.guard import always_passes
from bcapscope.traffic.getters import FRAME_GETTERS, Told
from bcapscope.traffic.observation import Direction, Flow
from bcapscope.traffic.question import Question

MOST_HELD = 1000
"""Messages; what comes when there are so many passes, and says so."""

PATIENCE = 60_000_000_000
"""ns that a message waits unless told otherwise: long enough to edit one, and a robot is not left hanging."""


class Held(NamedTuple):
    """A message that waits.

    Attributes:
        number: to name it by, never used twice.
        client: its number.
        flow: who speaks to whom.
        data: the message.
        question: what it asks or answers, where that is known.
        since: ns.
        until: ns; then it goes on unchanged.
    """

    number: int
    client: int
    flow: Flow
    data: bytes
    question: Question | None
    since: int
    until: int


class Intercept:
    """Holds the messages that a filter is true for.

    Requests that stop the robot or let go of something are never held.

    Attributes:
        condition: the filter; None while nothing is to be held.
        patience: ns that a message waits.
        count: how many were held so far.
    """

    def __init__(self, condition: Condition | None = None, patience: int = PATIENCE) -> None:
        self.patience = patience
        self.count = 0
        self._held: dict[int, Held] = {}
        self.set(condition)

    def set(self, condition: Condition | None) -> None:
        """Hold other messages from now on; what is held already stays."""
        self.condition = condition
        self._test: Callable[[Told], bool] | None = None
        if condition is not None:
            self._test = condition.filter.bind(FRAME_GETTERS)

    @property
    def held(self) -> list[Held]:
        """All that is held, the oldest first."""
        return list(self._held.values())

    @property
    def is_full(self) -> bool:
        """Whether nothing more can be held."""
        return len(self._held) >= MOST_HELD

    def wants(self, message: Message) -> bool:
        """Tell whether a message is to be held."""
        test = self._test
        if test is None or not any(test(told) for told in message.told):
            return False
        if message.flow.direction is Direction.RESPONSE:
            return True
        return not any(
            always_passes(frame.code, [argument.variant for argument in frame.arguments])
            for frame in message.frames
        )

    def hold(self, client: int, message: Message) -> Held:
        """Hold a message."""
        self.count += 1
        held = Held(
            self.count,
            client,
            message.flow,
            message.data,
            next((told.question for told in message.told if told.question), None),
            message.now,
            message.now + self.patience,
        )
        self._held[held.number] = held
        return held

    def release(self, number: int) -> Held:
        """Let go of a message and return it.

        Raises:
            KeyError: nothing of this number is held.
        """
        return self._held.pop(number)

    def due(self) -> int | None:
        """Tell when the next message has waited too long."""
        return min((held.until for held in self._held.values()), default=None)

    def expired(self, now: int) -> list[Held]:
        """Let go of what has waited too long."""
        return [self._held.pop(held.number) for held in self.held if held.until <= now]

    def holds(self, flow: Flow) -> bool:
        """Tell whether anything of a flow is held."""
        return any(held.flow is flow for held in self._held.values())

    def forget(self, client: int) -> None:
        """Drop what is held of a client that is gone."""
        self._held = {number: held for number, held in self._held.items() if held.client != client}
