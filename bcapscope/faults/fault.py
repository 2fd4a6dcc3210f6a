"""Base classes of the faults. The names of the faults come from Linux tc-netem(8) and Shopify's toxiproxy.

A message is a datagram. In a TCP stream, a message is a frame, or a sequence of bytes that is not a frame.
"""

from __future__ import annotations

from enum import StrEnum
from typing import TYPE_CHECKING, Annotated, Any, TypeAlias

import msgspec
from msgspec import Meta

from bcapscope.faults.quantities import DurationQuantity, FrameCondition, Share
from bcapscope.messages import Message
from bcapscope.traffic.observation import Direction

if TYPE_CHECKING:
    from bcapscope.faults.fault_injector import ActiveFault
    from bcapscope.faults.wire_message import FaultedMessage, WireMessage

_ON_ANY_BYTES = frozenset(("pass", "delay", "bandwidth", "partition", "half-open"))
"""Actions that do not need whole frames of a stream."""

Count: TypeAlias = Annotated[int, Meta(ge=1, le=1_000_000)]


class JitterDistribution(StrEnum):
    UNIFORM = "uniform"
    """Evenly within ± the jitter."""
    NORMAL = "normal"
    """A normal distribution with the jitter as its standard deviation."""
    PARETO = "pareto"
    """A Pareto distribution, scaled by the jitter: most delays are short, and a few are very long."""


class CloseMode(StrEnum):
    RESET = "reset"  # at once
    FIN = "fin"  # after all bytes were sent


class Fault(
    msgspec.Struct,
    frozen=True,
    kw_only=True,
    forbid_unknown_fields=True,
    omit_defaults=True,
    tag_field="action",
    rename={"when": "if", "lasts": "for", "attempt": "try"},
):
    """The fields that select the messages that a fault hits. None means no limit.

    Attributes:
        name: Name of the fault in reports; "" for a generated name. The name also seeds the random numbers.
        probability: Share of the messages to hit, out of the messages that fulfil all other conditions.
        times: Maximum number of hits.
        after: Time from adding the fault until the fault can hit messages.
        lasts: Time from the start to the end of the fault.
        attempt: Hit only requests and responses of the attempt with this number, counted from 1.
    """

    name: Annotated[str, Meta(pattern=r"^[\w.+-]{0,60}$")] = ""
    when: FrameCondition | None = None
    direction: Direction | None = None
    probability: Share = Share(1)
    times: Count | None = None
    after: DurationQuantity = DurationQuantity(0)
    lasts: DurationQuantity | None = None
    attempt: Count | None = None

    @property
    def action(self) -> str:
        return str(self.__struct_config__.tag)


class MessageFault(Fault, frozen=True, kw_only=True):
    @property
    def needs_frames(self) -> bool:
        """Whether a TCP stream must be split into frames before this fault can be applied."""
        return (
            self.action not in _ON_ANY_BYTES
            or self.when is not None
            or self.attempt is not None
            or self.probability < 1
        )

    def initial_state(self) -> Any:
        """Return a new value for `ActiveFault.state`, in which the fault keeps data for later messages."""
        return {}

    def draw(self, active: ActiveFault, message: WireMessage) -> Any:
        """Return random numbers for `apply`; None if the fault does not hit the message."""
        return ()

    def apply(self, faulted: FaultedMessage, drawn: Any, active: ActiveFault) -> Message | None:
        """Apply the fault, with the random numbers `drawn` by `draw`. Return the effect as text for the user;
        None if nothing changed.
        """
        raise NotImplementedError
