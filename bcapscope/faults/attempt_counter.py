"""Counts the attempts of calls."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

from bcapscope.protocol.codec.frame import Frame
from bcapscope.traffic.call_kind import MAX_CONVERSATIONS
from bcapscope.traffic.observation import Conversation, Direction, Flow, Transport
from bcapscope.traffic.recent_serials import RecentSerials

MAX_ATTEMPTS = 16
"""Largest attempt number that bcapscope infers from serials: twice what clients make per call."""


@dataclass(eq=False, slots=True)
class AttemptedCall:
    """A call. `content` is a hash of the request from the function id to the end."""

    content: int
    attempts: int


class CallAttempt(NamedTuple):
    """One attempt of a call. The first attempt has the number 1."""

    call: AttemptedCall
    number: int


def _content_hash(request: Frame) -> int:
    return hash(request.raw[9:])


class AttemptCounter:
    """Uses the serials in the reserved fields of retries to find the attempts of each call. Supports all
    conventions for the reserved field.
    """

    def __init__(self) -> None:
        self._conversations: dict[Conversation, _AttemptsBySerial] = {}

    def attempt_number(self, flow: Flow, frame: Frame) -> int | None:
        """Like `add_frame`, but return only the number of the attempt: always 1 on TCP, where clients do not
        retry.
        """
        if flow.conversation.transport is Transport.TCP:
            return 1
        found = self.add_frame(flow, frame)
        return None if found is None else found.number

    def add_frame(self, flow: Flow, frame: Frame) -> CallAttempt | None:
        """Add the next frame of a UDP conversation. Return the attempt to which the frame belongs; None for a
        reply to an unknown request.
        """
        # `_conversations` is a `dict`, because an assignment to a `BoundedDict` takes 200 ns longer than to a
        # `dict`.
        serials = self._conversations.pop(flow.conversation, None) or _AttemptsBySerial()
        while len(self._conversations) >= MAX_CONVERSATIONS:
            del self._conversations[next(iter(self._conversations))]
        self._conversations[flow.conversation] = serials
        if flow.direction is Direction.RESPONSE:
            return serials.get(frame.serial)
        return serials.add_request(frame)

    def find_same_request(self, flow: Flow, request: Frame) -> AttemptedCall | None:
        """Return the call of an earlier attempt with the same serial and content as `request`, if any. Do not
        count `request` as an attempt.
        """
        serials = self._conversations.get(flow.conversation)
        known = serials.get(request.serial) if serials else None
        return known.call if known and known.call.content == _content_hash(request) else None

    def close_conversation(self, conversation: Conversation) -> None:
        self._conversations.pop(conversation, None)


class _AttemptsBySerial(RecentSerials[CallAttempt]):
    """The latest attempts of one conversation, by serial."""

    def add_request(self, frame: Frame) -> CallAttempt:
        serial, reserved, content = frame.serial, frame.reserved, _content_hash(frame)
        known = self.get(serial)
        if known and known.call.content == content and reserved not in (0, serial):
            return known  # the network has duplicated this request
        found = self._new_attempt(serial, reserved, content)
        found.call.attempts = max(found.call.attempts, found.number)
        self.put(serial, found)
        return found

    def _new_attempt(self, serial: int, reserved: int, content: int) -> CallAttempt:
        if reserved in (0, serial):
            return CallAttempt(AttemptedCall(content, 1), 1)
        origin = self.get(reserved)
        if origin and origin.call.content == content:
            return CallAttempt(origin.call, origin.call.attempts + 1)
        # The first attempt was lost on its way to this program. Each retry has the next serial, so the
        # difference of the serials gives the number of the attempt.
        behind = (serial - reserved) & 0xFFFF
        number = behind + 1 if behind < MAX_ATTEMPTS else 2
        call = AttemptedCall(content, number)
        self.put(reserved, CallAttempt(call, 1))
        return CallAttempt(call, number)
