"""Keeps the state of each direction of a client's traffic, and splits received data into messages."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from typing import NamedTuple, TypeAlias

from bcapscope.faults.wire_message import WireMessage
from bcapscope.protocol.codec.byte_budget import ByteBudget
from bcapscope.protocol.codec.frame import Frame, Malformed, parse_datagram
from bcapscope.protocol.codec.stream_splitter import StreamSplitter
from bcapscope.protocol.guard import always_passes, request_effect
from bcapscope.protocol.tables.call_effect import CallEffect
from bcapscope.protocol.tables.function_table import FUNCTIONS, ID
from bcapscope.proxy.policy import PolicyDecision
from bcapscope.traffic.observation import Direction, Flow, Transport

_SplitRequests: TypeAlias = tuple[list[bytes], list[Frame | bytes]]

_HALTS = frozenset((ID["Robot_Halt"], ID["Robot_Hold"]))


@dataclass(eq=False)
class DirectionState:
    """State of one direction of a client's traffic. Times are in ns.

    Attributes:
        budget: Common limit for the bytes of unfinished frames in all streams.
        splitter: Object that splits a TCP stream into frames; None while no proxy rule needs frames.
        has_begun: True once the proxy has forwarded bytes of this direction.
        piece_count: Number of received datagrams; for a stream, the number of reads.
        overtaken_by: Message number of the latest stop that cancels the client's waiting motions; 0 without
            such a stop. A waiting motion must not start if its message number is below `overtaken_by`.
    """

    client: int
    flow: Flow
    connected_at: int
    budget: ByteBudget
    splitter: StreamSplitter | None = None
    has_begun: bool = False
    has_ended: bool = False
    piece_count: int = 0
    last_piece_at: int = 0
    overtaken_by: int = 0

    @property
    def is_stream(self) -> bool:
        return self.flow.conversation.transport is Transport.TCP

    def cut_messages(self, data: bytes, into_frames: bool) -> Iterator[bytes]:
        """Yield the messages in received data. With `into_frames`, split a stream into frames."""
        if not self.is_stream:
            yield data
            return
        if into_frames:
            if self.splitter is None:
                self.splitter = StreamSplitter(synchronized=not self.has_begun, budget=self.budget)
            for piece in self.splitter.feed(data):
                yield piece.item.raw
            return
        whole = b"".join((*self.take_incomplete(), data))
        if whole:
            yield whole

    def take_incomplete(self) -> list[bytes]:
        """Stop splitting the stream. Return the bytes of an incomplete frame in the splitter."""
        splitter, self.splitter = self.splitter, None
        return [piece.item.raw for piece in splitter.close()] if splitter else []


class UndecidedMessage(NamedTuple):
    """A message that waits for the scripts. `decision` is the decision about all data that arrived together
    with the message.
    """

    message: WireMessage
    state: DirectionState
    decision: PolicyDecision


def split_held_requests(state: DirectionState, held: Iterable[bytes]) -> _SplitRequests:
    """Split the waiting requests of a leaving client into stops to send and other requests to drop.

    A motion is dangerous if it starts after its client has stopped waiting. If the proxy has already sent the
    start of a frame, the rest of that frame precedes the stops. Otherwise, the controller would read the
    first stop as the rest of that frame.
    """
    if not state.is_stream:
        return _split_frames([item for data in held for item in parse_datagram(data)])
    splitter = StreamSplitter(synchronized=False)
    items = [piece.item for piece in (*splitter.feed(b"".join(held)), *splitter.close())]
    going, lost = _split_frames(items)
    begun = items[0].raw if items and items[0].problems else b""
    if going and begun:
        return [begun, *going], lost[1:]
    return going, lost


def _split_frames(items: Iterable[Frame | Malformed]) -> _SplitRequests:
    going: list[bytes] = []
    lost: list[Frame | bytes] = []
    for item in items:
        if not isinstance(item, Frame):
            lost.append(item.raw)
        elif _only_stops(item):
            going.append(item.raw)
        else:
            lost.append(item)
    return going, lost


def may_move(request: Frame) -> bool:
    values = request.variants
    return (
        not always_passes(request.code, values) and request_effect(request.code, values) >= CallEffect.MOVES
    )


def _only_stops(request: Frame) -> bool:
    return not request.problems and always_passes(request.code, request.variants)


def is_stop_request(message: WireMessage) -> bool:
    """Return whether a message consists of requests that only stop the robot or release something."""
    if message.flow.direction is Direction.RESPONSE or not message.frames:
        return False
    return all(map(_only_stops, message.frames))


def mark_overtaken(
    stop: WireMessage, state: DirectionState, request_states: Iterable[DirectionState]
) -> None:
    """When the proxy forwards a stop, cancel the same client's motions that still wait for the scripts.
    Robot_Halt and Robot_Hold cancel the motions of all clients of the controller, because a program may send
    these stops over a separate connection. A call that only releases something cancels no motion.
    """
    codes = {each.code for each in stop.frames}
    if not codes.isdisjoint(_HALTS):
        controller = state.flow.conversation.server
        for each in request_states:
            if each.flow.conversation.server == controller:
                each.overtaken_by = stop.number
    elif any(FUNCTIONS[code].releases is None for code in codes):
        state.overtaken_by = stop.number
