"""Decisions of the proxy's rules: what the relay sends, and which connections it closes."""

from __future__ import annotations

from typing import TypeAlias

import msgspec

from bcapscope.messages import Message
from bcapscope.messages.places import joined_clauses
from bcapscope.traffic.observation import Direction


# The following classes are structs for speed; see `wire_message`.
class SendAction(msgspec.Struct, frozen=True):
    """A datagram, or the next bytes of a stream, to send now. `Direction.REQUEST` leads toward the
    controller. `note` says what a proxy rule did to the bytes.
    """

    client: int
    toward: Direction
    data: bytes
    note: Message | None = None


class CloseAction(msgspec.Struct, frozen=True):
    """Tells the relay to close both connections of a client. With `reset`, the relay does not send waiting
    bytes. `note` names the proxy rule that closes the connections.
    """

    client: int
    reset: bool
    note: Message


class PolicyDecision(msgspec.Struct, eq=False):
    """Decision about data that the relay has received.

    Attributes:
        notes: What proxy rules did, such as "loss=5%: dropped"; empty if no rule changed the data.
        waiting: Number of messages in the data that wait for the scripts. When `waiting` falls to 0,
            `RulePolicy.pop_due_actions` returns this `PolicyDecision` again, with new actions.
    """

    client: int
    actions: list[SendAction | CloseAction] = []
    notes: list[Message] = []
    waiting: int = 0

    @property
    def note(self) -> Message | None:
        return joined_clauses(self.notes)


PolicyAction: TypeAlias = SendAction | CloseAction | PolicyDecision
