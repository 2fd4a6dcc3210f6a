"""The interface between the relay and its rules. Without rules, the relay inspects nothing.

Nothing here reads a clock or a socket. Times are ns of a monotonic clock.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Protocol, TypeAlias

import msgspec

from bcapscope.messages import Message
from bcapscope.traffic.observation import Conversation, Direction


# Every message creates some of these. A struct compares by its type, which a named tuple does not, and takes
# 0.1 µs to create (named tuple 0.4, frozen dataclass 0.9).
class SendAction(msgspec.Struct, frozen=True):
    """Bytes to send now.

    Attributes:
        client: Number of the client whose connection is used.
        toward: REQUEST sends to the controller, RESPONSE to the client.
        data: A datagram, or the next bytes of a stream.
        note: What a rule did to it, for the recording and the screen; None if it is unchanged.
    """

    client: int
    toward: Direction
    data: bytes
    note: Message | None = None


class CloseAction(msgspec.Struct, frozen=True):
    """The end of a client's connection, on both sides.

    Attributes:
        client: Number of the client.
        reset: True to reset a stream, which loses unsent bytes. False to send them first.
        note: The rule, for the screen.
    """

    client: int
    reset: bool
    note: Message


class LateDecision(msgspec.Struct, frozen=True):
    """A decision about data that arrived earlier and waited.

    Attributes:
        client: Number of the client.
        ticket: `PolicyDecision.ticket` of the data.
        note: As in `PolicyDecision`.
        actions: As in `PolicyDecision`, after the actions returned while the data waited.
    """

    client: int
    ticket: int
    note: Message | None
    actions: Sequence[SendAction | CloseAction]


PolicyAction: TypeAlias = SendAction | CloseAction | LateDecision


class PolicyDecision(msgspec.Struct, frozen=True):
    """A decision about received data.

    Attributes:
        note: What a rule did, such as "loss=5%: dropped"; None if no rule touched the data.
        actions: Actions to do at once, in order. `Policy.pop_due_actions` returns later ones.
        ticket: Identifies data that waits for a `LateDecision`; 0 if all is decided.
    """

    note: Message | None
    actions: Sequence[SendAction | CloseAction]
    ticket: int = 0


class Policy(Protocol):
    """Decides which messages pass. No method raises, and only `close` may block."""

    def add_client(self, client: int, conversation: Conversation, now: int) -> None:
        """Register a client: its number, never used twice, and its conversation with the controller."""

    def receive(self, client: int, direction: Direction, data: bytes, now: int) -> PolicyDecision:
        """Decide about a datagram, or the next bytes of a stream, in the order of arrival."""

    def holds(self, client: int, direction: Direction) -> bool:
        """Return whether data of this direction is still to be sent. Its end is forwarded after that.

        The client may be gone by now.
        """

    def is_full(self, client: int) -> bool:
        """Return whether so much is held that a client's streams must wait for `pop_due_actions`."""

    def on_stream_end(
        self, client: int, direction: Direction, now: int
    ) -> Sequence[SendAction | CloseAction]:
        """Handle the end of a stream in one direction. Return the actions for its incomplete rest."""

    def hides_end(self, client: int) -> bool:
        """Return whether each side of a client must not learn of the other's end, by FIN or RST."""

    def release_held(self, client: int, now: int) -> Sequence[SendAction | CloseAction]:
        """Return the actions to do before a client ends. The client is still registered."""

    def remove_client(self, client: int, now: int) -> None:
        """Forget a client."""

    def due(self) -> int | None:
        """Return when to call `pop_due_actions`; None while nothing waits."""

    def pop_due_actions(self, now: int) -> Sequence[PolicyAction]:
        """Return the actions that are due by `now`."""

    def close(self, now: int) -> None:
        """End the rules: no more data arrives."""

    def report(self) -> Sequence[Message]:
        """Return a summary of what the rules did, in a few lines."""
