"""The interface between the relay and its rules. Without rules, the relay inspects nothing.

This module uses no clock and no socket. Times are in ns of a monotonic clock.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Protocol, TypeAlias

import msgspec

from bcapscope.messages import Message
from bcapscope.traffic.observation import Conversation, Direction


# Each message creates some of these structs. A struct compares by its type, unlike a named tuple, and takes
# 0.1 µs to create (named tuple 0.4, frozen dataclass 0.9).
class SendAction(msgspec.Struct, frozen=True):
    """Bytes to send now.

    Attributes:
        client: Number of the client over whose connection the bytes are sent.
        toward: `Direction.REQUEST` sends the bytes to the controller, `Direction.RESPONSE` to the client.
        data: A datagram, or the next bytes of a stream.
        note: What a rule did to the bytes, for the recording and the screen; None if no rule changed them.
    """

    client: int
    toward: Direction
    data: bytes
    note: Message | None = None


class CloseAction(msgspec.Struct, frozen=True):
    """Both connections of a client must be closed.

    Attributes:
        reset: True to reset a stream, which loses unsent bytes; False to send these bytes first.
        note: Rule that closes the connections, for the screen.
    """

    client: int
    reset: bool
    note: Message


class LateDecision(msgspec.Struct, frozen=True):
    """Decision about data that arrived earlier and has waited since.

    Attributes:
        ticket: `PolicyDecision.ticket` that identifies the data.
        note: As in `PolicyDecision`.
        actions: As in `PolicyDecision`, after the actions returned while the data waited.
    """

    client: int
    ticket: int
    note: Message | None
    actions: Sequence[SendAction | CloseAction]


PolicyAction: TypeAlias = SendAction | CloseAction | LateDecision


class PolicyDecision(msgspec.Struct, frozen=True):
    """Decision about data that the relay has just received.

    Attributes:
        note: What a rule did, such as "loss=5%: dropped"; None if no rule touched the data.
        actions: Actions to do at once, in order. `Policy.pop_due_actions` returns further actions later.
        ticket: Number that identifies data that waits for a `LateDecision`; 0 if everything is decided.
    """

    note: Message | None
    actions: Sequence[SendAction | CloseAction]
    ticket: int = 0


class Policy(Protocol):
    """Decides which messages pass the relay. No method raises an exception, and only `close` may block."""

    def add_client(self, client: int, conversation: Conversation, now: int) -> None:
        """Register a client by its number, which is never used twice, and its conversation."""

    def receive(self, client: int, direction: Direction, data: bytes, now: int) -> PolicyDecision:
        """Decide about a datagram, or about the next bytes of a stream. Data comes in order of arrival."""

    def holds(self, client: int, direction: Direction) -> bool:
        """Return whether rules hold data of this direction. The end of a stream is forwarded after that data.

        The client may be gone by now.
        """

    def is_full(self, client: int) -> bool:
        """Return whether so much data is held that a client's streams must wait for `pop_due_actions`."""

    def on_stream_end(
        self, client: int, direction: Direction, now: int
    ) -> Sequence[SendAction | CloseAction]:
        """Handle the end of a stream in one direction. Return the actions for its incomplete last frame."""

    def hides_end(self, client: int) -> bool:
        """Return whether the FIN or RST of either side must be hidden from the other side."""

    def release_held(self, client: int, now: int) -> Sequence[SendAction | CloseAction]:
        """Return the actions to do before a client's end. The client is still registered."""

    def remove_client(self, client: int, now: int) -> None:
        """Drop the data of a client."""

    def due(self) -> int | None:
        """Return the time at which to call `pop_due_actions`; None while nothing waits."""

    def pop_due_actions(self, now: int) -> Sequence[PolicyAction]:
        """Return the actions that are due by `now`."""

    def close(self, now: int) -> None:
        """End the rules, because no more data arrives."""

    def report(self) -> Sequence[Message]:
        """Return a summary of what the rules did, one message per line."""
