"""The fields that all faults have. The fields select the messages that a fault hits. The classes of the
faults are in `fault_kinds`.

Faults that Linux tc-netem(8) or Shopify's toxiproxy also have are named as there. Each fault has its own
stream of random numbers. A message is a datagram. On TCP, a message is a frame, or a run of bytes that are
not a frame.
"""

from __future__ import annotations

from enum import StrEnum
from typing import TYPE_CHECKING, Annotated, Any, ClassVar, TypeAlias

import msgspec
from msgspec import Meta

from bcapscope.faults.quantities import DurationQuantity, FrameCondition, Share
from bcapscope.messages import Message
from bcapscope.traffic.observation import Direction

if TYPE_CHECKING:
    from bcapscope.faults.fault_injector import ActiveFault
    from bcapscope.faults.wire_message import FaultedMessage, WireMessage

Count: TypeAlias = Annotated[int, Meta(ge=1, le=1_000_000)]


class JitterDistribution(StrEnum):
    """Distribution of the jitter of a delay."""

    UNIFORM = "uniform"
    """Evenly within ± the jitter."""
    NORMAL = "normal"
    """Normal distribution; the jitter is its standard deviation."""
    PARETO = "pareto"
    """Pareto distribution with exponent 3; the jitter is its scale. Most delays are short, and a few are very
    long.
    """


class CloseMode(StrEnum):
    """How a TCP connection is closed."""

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
        name: Name in reports, and part of the seed of the random numbers. A name consists of letters, digits
            and ``_ . + -``. An empty name is replaced by a generated name.
        when: Filter that a message must match. In documents, this field is named ``if``.
        direction: Direction of the messages to hit; None for both directions.
        probability: Share of the messages to hit, among the messages that fulfil all other conditions.
        times: Number of hits after which the fault ends; None for no limit.
        after: Time from the creation of the fault until it starts to hit messages.
        lasts: Time from the start to the end of the fault; None for no end. In documents, this field is named
            ``for``.
        attempt: Number, counted from 1, of the attempt whose request or response to hit; None for any
            attempt. In documents, this field is named ``try``.
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

    needs_whole_frame: ClassVar[bool] = True
    """Whether the fault's action needs whole frames, even if the fault's conditions do not."""

    @property
    def needs_frames(self) -> bool:
        """Whether this fault can be applied to a TCP stream only after the stream was split into frames."""
        return (
            self.needs_whole_frame
            or self.when is not None
            or self.attempt is not None
            or self.probability < 1
        )

    def initial_state(self) -> Any:
        """Return the initial state of the fault, with one value per direction. The fault changes this state
        while it is active.
        """
        return {}

    def draw(self, active: ActiveFault, message: WireMessage) -> Any:
        """Return the random numbers that `apply` needs; None if the fault does not hit the message."""
        return True

    def apply(self, faulted: FaultedMessage, drawn: Any, active: ActiveFault) -> Message | None:
        """Change the message with the random numbers from `draw`. Return what was done; None if nothing
        changed.
        """
        raise NotImplementedError
