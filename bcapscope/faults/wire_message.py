"""A message that the proxy or simulator is about to send, and the changes that faults make to it."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from typing import TypeAlias

import msgspec

from bcapscope.faults.attempt_counter import AttemptCounter
from bcapscope.faults.fault import CloseMode
from bcapscope.faults.reply_factory import ReplyFactory
from bcapscope.messages import Message
from bcapscope.protocol.codec.frame import Frame, Malformed, parse_datagram
from bcapscope.protocol.codec.frame_template import FrameTemplates
from bcapscope.traffic.call_kind import CallKind, RecentRequests
from bcapscope.traffic.filter.getters import AnnotatedFrame
from bcapscope.traffic.observation import Conversation, Flow, Observation, Transport


# The following classes are msgspec structs for speed, because each message creates several objects. Measured
# times to create an object: struct 0.1 µs, named tuple 0.4 µs, frozen dataclass 0.9 µs. Unlike a named tuple,
# a struct never equals a struct of another class.
class SendBytes(msgspec.Struct, frozen=True):
    """A datagram, or the next bytes of a stream, to send now. `fault_notes` names the effects of faults."""

    flow: Flow
    data: bytes
    fault_notes: tuple[Message, ...] = ()

    @property
    def conversation(self) -> Conversation:
        return self.flow.conversation


class CloseConnection(msgspec.Struct, frozen=True):
    """Tells the proxy or simulator to close the TCP connections to client and controller now."""

    conversation: Conversation
    how: CloseMode
    fault_notes: tuple[Message, ...] = ()


FaultOutput: TypeAlias = SendBytes | CloseConnection


class FaultResult(msgspec.Struct, frozen=True):
    """Result of applying the faults to a message. `outputs` holds the actions to do now, in order, beginning
    with held messages that are due. `fault_notes` says what each fault did, such as ``loss: dropped``.
    """

    outputs: list[FaultOutput]
    fault_notes: tuple[Message, ...] = ()


class WireMessage:
    """A datagram, or a piece of a stream. The data is decoded only when its frames are needed.

    Attributes:
        number: Number of the message, counted from 1 over all messages.
        now: Time of receipt in ns, on a monotonic clock.
        time: Time of receipt in ns since 1970-01-01 UTC.
        attempt_numbers: Number of each frame's attempt, or of the attempt that a reply or notice answers.
            Empty before `annotate_with_attempts`.
    """

    __slots__ = ("_annotated", "_templates", "attempt_numbers", "data", "flow", "now", "number", "time")

    def __init__(
        self,
        number: int,
        flow: Flow,
        data: bytes,
        now: int,
        time: int,
        *,
        templates: FrameTemplates | None = None,
    ) -> None:
        self.number = number
        self.flow = flow
        self.data = data
        self.now = now
        self.attempt_numbers: tuple[int | None, ...] = ()
        self.time = time
        self._annotated: tuple[AnnotatedFrame, ...] | None = None
        self._templates = templates

    @property
    def is_datagram(self) -> bool:
        return self.flow.conversation.transport is not Transport.TCP

    @property
    def annotated_frames(self) -> tuple[AnnotatedFrame, ...]:
        """Frames of the message, and bytes that are not a frame."""
        if self._annotated is None:
            self._annotated = tuple(AnnotatedFrame(seen, None) for seen in self._observations())
        return self._annotated

    @property
    def frames(self) -> tuple[Frame, ...]:
        """Frames of the message; () if the message also contains bytes that are not a frame."""
        return _only_frames([each.observation.item for each in self.annotated_frames])

    @property
    def call_kind(self) -> CallKind | None:
        """Function and command that the message calls or answers; None if unknown."""
        return next((each.call_kind for each in self.annotated_frames if each.call_kind), None)

    def annotate_with_attempts(self, requests: RecentRequests, counter: AttemptCounter) -> None:
        """Like `annotate`, but also find the attempt of each frame."""
        self.annotate(requests)
        self.attempt_numbers = tuple(
            counter.attempt_number(self.flow, each.observation.item)
            if isinstance(each.observation.item, Frame)
            else None
            for each in self.annotated_frames
        )

    def annotate(self, requests: RecentRequests) -> None:
        """Find the function and command of each frame. Call this method for all messages, in their order."""
        self._annotated = tuple(AnnotatedFrame(seen, requests.kind_of(seen)) for seen in self._observations())

    def _observations(self) -> Iterator[Observation]:
        for item in parse_datagram(self.data, self._templates):
            yield Observation(self.number, self.time, self.time, self.flow, item, 0)


@dataclass(slots=True)
class FaultedMessage:
    """A message, and the effects of faults on the message so far. Times are in ns.

    Attributes:
        is_final: True if the injector must not apply further faults to the message.
        copy_delays: Delay of each copy, counted from the sending of the message.
        held_behind: For a reordered message: how many later messages to send first, and the maximum wait.
        replies: Replies that faults made for the client, each with its delay.
        half_open: True if the conversation is blocked from now on.
    """

    original: WireMessage
    reply_factory: ReplyFactory
    data: bytes
    delay: int = 0
    is_lost: bool = False
    is_final: bool = False
    copy_delays: list[int] = field(default_factory=list)
    held_behind: tuple[int, int] | None = None
    replies: list[tuple[int, bytes]] = field(default_factory=list)
    close_mode: CloseMode | None = None
    half_open: bool = False

    @property
    def frames(self) -> tuple[Frame, ...]:
        if self.data is self.original.data:
            return self.original.frames
        return _only_frames(parse_datagram(self.data))

    def drop(self) -> None:
        self.is_lost = self.is_final = True


def _only_frames(items: Sequence[Frame | Malformed]) -> tuple[Frame, ...]:
    frames = tuple(item for item in items if isinstance(item, Frame))
    return frames if len(frames) == len(items) else ()
