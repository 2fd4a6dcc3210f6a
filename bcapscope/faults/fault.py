"""The fields that all faults have. The fields select the messages that a fault hits. The classes of the
faults are in `fault_kinds`.

If Linux tc-netem(8) or Shopify's toxiproxy has the same fault, the fault has the same name here. Each fault
has its own generator of random numbers. A message is a datagram. In a TCP stream, a message is a frame, or a
sequence of bytes that is not a frame.
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
    """Distribution of the jitter of a delay."""

    UNIFORM = "uniform"
    """Evenly within ± the jitter."""
    NORMAL = "normal"
    """Normal distribution; the jitter is its standard deviation."""
    PARETO = "pareto"
    """Pareto distribution with exponent 3; the jitter scales the distribution. Most delays are short, and a
    few are very long.
    """


class CloseMode(StrEnum):
    RESET = "reset"
    """Close with RST, at once."""
    FIN = "fin"
    """Close with FIN, after all bytes were sent."""


class Fault(
    msgspec.Struct,
    frozen=True,
    kw_only=True,
    forbid_unknown_fields=True,
    omit_defaults=True,
    tag_field="action",
    rename={"when": "if", "lasts": "for", "attempt": "try"},
):
    """The fields that all faults have. The fields select the messages that the fault hits.

    Attributes:
        name: Name of the fault in reports. The random numbers of the fault depend on the name. A name
            consists of letters, digits and ``_ . + -``. An empty name is replaced by a generated name.
        when: Filter that a message must match. In documents, this field is named ``if``.
        direction: Direction of the messages to hit; None for both directions.
        probability: Share of the messages to hit, out of the messages that fulfil all other conditions.
        times: Maximum number of hits; None for no limit.
        after: Time from adding the fault until the fault can hit messages.
        lasts: Time from the start to the end of the fault; None for no end. In documents, this field is named
            ``for``.
        attempt: Hit only requests and responses of the attempt with this number, counted from 1; None for all
            attempts. In documents, this field is named ``try``.
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
    """A fault that affects messages."""

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
        """Return a new value for `ActiveFault.state`. `draw` and `apply` may store data in
        `ActiveFault.state` for later messages.
        """
        return {}

    def draw(self, active: ActiveFault, message: WireMessage) -> Any:
        """Draw random numbers for `apply`. Return None if the fault does not hit the message."""
        return True

    def apply(self, faulted: FaultedMessage, drawn: Any, active: ActiveFault) -> Message | None:
        """Apply the fault to the b-CAP message. `drawn` holds the random numbers that `draw` returned. Return
        a message to the user about the effect of the fault; None if nothing changed.
        """
        raise NotImplementedError
