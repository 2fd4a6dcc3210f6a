"""Functions that read the fields of the filter syntax from frames and calls."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from operator import attrgetter
from typing import NamedTuple

from bcapscope.protocol.codec.frame import Frame, Problem
from bcapscope.protocol.tables.function_table import function_name
from bcapscope.protocol.tables.hresult import describe_hresult, hresult_name
from bcapscope.traffic.call import Call
from bcapscope.traffic.call_kind import CallKind
from bcapscope.traffic.observation import Conversation, Direction, Endpoint, Observation


class AnnotatedFrame(NamedTuple):
    """A captured frame, or captured bytes that are no frame, with its function and command.

    Attributes:
        observation: Observation that holds the frame or the bytes, with their time, packet and flow.
        call_kind: Function and command of the request, or of the request that a reply answers; None if
            unknown.
        comments: Comments on the packet in the capture.
    """

    observation: Observation
    call_kind: CallKind | None
    comments: tuple[str, ...] = ()

    @property
    def number(self) -> int:
        """Number of the frame, counted from 1."""
        return self.observation.number

    @property
    def time(self) -> int:
        """Capture time of the frame's last byte, ns since 1970-01-01 UTC."""
        return self.observation.time

    @property
    def conversation(self) -> Conversation:
        """Client, controller and transport."""
        return self.observation.flow.conversation

    @property
    def kind(self) -> str:
        """``request``, ``response`` or, for bytes that are no frame, ``malformed``."""
        observation = self.observation
        return str(observation.flow.direction) if isinstance(observation.item, Frame) else "malformed"

    @property
    def frame(self) -> Frame | None:
        """The frame; None for bytes that are no frame."""
        item = self.observation.item
        return item if isinstance(item, Frame) else None

    @property
    def raw(self) -> bytes:
        """The captured bytes."""
        return self.observation.item.raw

    @property
    def problems(self) -> tuple[Problem, ...]:
        """Deviations of the bytes from b-CAP; empty for a sound frame."""
        return self.observation.item.problems

    @property
    def function(self) -> str | None:
        """Name of the function that is requested or answered; None if unknown."""
        return None if self.call_kind is None else function_name(self.call_kind.function_id)

    @property
    def command(self) -> str | None:
        """Command of an Execute function, such as ``slvMove``. None for other or unknown functions."""
        return None if self.call_kind is None else self.call_kind.command

    @property
    def hresult(self) -> int | None:
        """Result code of a reply, unsigned; None for a request and for bytes that are no frame."""
        item, flow = self.observation.item, self.observation.flow
        return item.code if isinstance(item, Frame) and flow.direction is Direction.RESPONSE else None


def _of_frame(read: Callable[[Frame], object]) -> Callable[[AnnotatedFrame], object]:
    return lambda told: read(told.observation.item) if isinstance(told.observation.item, Frame) else None


def _length(annotated: AnnotatedFrame) -> int:
    item = annotated.observation.item
    return item.length if isinstance(item, Frame) else len(item.raw)


def _of_hresult(read: Callable[[int], object]) -> Callable[[AnnotatedFrame | Call], object]:
    def get(record: AnnotatedFrame | Call) -> object:
        code = record.hresult
        return None if code is None else read(code)

    return get


FRAME_GETTERS: Mapping[str, Callable[[AnnotatedFrame], object]] = {
    "frame": lambda told: told.observation.number,
    "packet": lambda told: told.observation.packet,
    "src": lambda told: told.observation.flow.src,
    "dst": lambda told: told.observation.flow.dst,
    "client": lambda told: told.observation.flow.conversation.client,
    "server": lambda told: told.observation.flow.conversation.server,
    "transport": lambda told: told.observation.flow.conversation.transport,
    "length": _length,
    "serial": _of_frame(lambda frame: frame.serial),
    "reserved": _of_frame(lambda frame: frame.reserved),
    "function_id": lambda told: None if told.call_kind is None else told.call_kind.function_id,
    "arg": _of_frame(lambda frame: frame.arguments),
    "hresult_name": _of_hresult(hresult_name),
    "hresult_text": _of_hresult(lambda code: describe_hresult(code).text),
    "problems": lambda told: [str(problem.reason) for problem in told.problems],
    **{name: attrgetter(name) for name in ("time", "kind", "function", "command", "hresult")},
}


def _of_legs(read: Callable[[Conversation], Endpoint]) -> Callable[[Call], object]:
    """Return a getter for an address of a call, or for the addresses on both legs of a proxy."""

    def get(call: Call) -> object:
        near, far = call.conversation, call.conversation.controller_leg
        return read(near) if far is None else (read(near), read(far))

    return get


_CALL_ATTRIBUTES = (
    "function command hresult serials retries unseen_retries outcome latency rtt convention verdict"
)
CALL_GETTERS: Mapping[str, Callable[[Call], object]] = {
    "call": lambda call: call.number,
    "client": _of_legs(lambda conversation: conversation.client),
    "server": _of_legs(lambda conversation: conversation.server),
    "transport": lambda call: call.conversation.transport,
    "function_id": lambda call: call.kind.function_id,
    "arg": lambda call: call.request.item.arguments,
    "hresult_name": _of_hresult(hresult_name),
    "hresult_text": _of_hresult(lambda code: describe_hresult(code).text),
    "started": lambda call: call.request.time,
    "requests": lambda call: [seen.number for seen in call.attempts],
    "replies": lambda call: [] if call.reply is None else [call.reply.number],
    "late_replies": lambda call: [seen.number for seen in call.late_replies],
    "lost_replies": lambda call: [seen.number for seen in call.lost_replies],
    "executing": lambda call: len(call.notices),
    "duplicates": lambda call: [seen.number for seen in call.duplicates],
    "captured_again": lambda call: [seen.number for seen in call.captured_again],
    **{name: attrgetter(name) for name in _CALL_ATTRIBUTES.split()},
}
