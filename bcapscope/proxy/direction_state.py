"""The state of each direction of a client's traffic, and how its data is split into messages."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from typing import NamedTuple

from msgspec.structs import replace

from bcapscope.messages import Message
from bcapscope.messages.places import joined_clauses
from bcapscope.protocol.codec.byte_budget import ByteBudget
from bcapscope.protocol.codec.frame import Frame, Malformed, parse_datagram
from bcapscope.protocol.codec.stream_splitter import StreamSplitter
from bcapscope.protocol.guard import always_passes
from bcapscope.proxy.policy import CloseAction, SendAction
from bcapscope.traffic.observation import Conversation, Direction, Flow, Transport


class DirectionState:
    """State of one direction of a client's traffic.

    Attributes:
        splitter: Splitter of a TCP stream into frames; None while no rule needs frames.
        has_begun: True after bytes of this direction were forwarded.
        piece_count: Number of datagrams received, or of reads of a stream.
        last_piece_at: Time of the last datagram or read, in ns.
        has_ended: True after the stream has ended.
        overtaken_by: Message number of the latest stop; waiting motions with a lower number must not start. 0
            for no stop.
    """

    __slots__ = (
        "_budget",
        "client",
        "flow",
        "has_begun",
        "has_ended",
        "last_piece_at",
        "overtaken_by",
        "piece_count",
        "splitter",
    )

    def __init__(self, client: int, flow: Flow, budget: ByteBudget | None = None) -> None:
        """Set up the state. `budget` limits the bytes of unfinished frames of all streams together."""
        self._budget = budget
        self.client = client
        self.flow = flow
        self.splitter: StreamSplitter | None = None
        self.has_begun = self.has_ended = False
        self.piece_count = self.last_piece_at = self.overtaken_by = 0

    @property
    def is_stream(self) -> bool:
        """Whether the messages of this direction are a stream, which has no boundaries."""
        return self.flow.conversation.transport is Transport.TCP

    def cut_messages(self, data: bytes, into_frames: bool) -> Iterator[bytes]:
        """Yield the messages in received data. Split a stream into frames only if `into_frames` is True."""
        if not self.is_stream:
            yield data
            return
        if into_frames:
            if self.splitter is None:
                self.splitter = StreamSplitter(synchronized=not self.has_begun, budget=self._budget)
            for piece in self.splitter.feed(data):
                yield piece.item.raw
            return
        whole = b"".join((*self.take_incomplete(), data))
        if whole:
            yield whole

    def take_incomplete(self) -> list[bytes]:
        """Stop splitting the stream. Return the bytes kept of an incomplete frame."""
        splitter, self.splitter = self.splitter, None
        return [piece.item.raw for piece in splitter.close()] if splitter else []


class ClientActivity(NamedTuple):
    """Activity of a connected client; times are in ns.

    Attributes:
        since: Time of the client's first bytes.
        up: Number of datagrams, or of reads of a stream, from the client.
        last_request_at: Time of the last bytes from the client; 0 for never.
        down: Number of datagrams, or of reads of a stream, from the controller.
        last_reply_at: Time of the last bytes from the controller; 0 for never.
    """

    number: int
    conversation: Conversation
    since: int
    up: int
    last_request_at: int
    down: int
    last_reply_at: int


class ClientStates:
    """The connected clients, each with the state of both directions."""

    def __init__(self) -> None:
        self._directions: dict[int, dict[Direction, DirectionState]] = {}
        self._connected_at: dict[int, int] = {}
        self._numbers: dict[Conversation, int] = {}
        self._budget = ByteBudget()

    def add(self, client: int, conversation: Conversation, now: int) -> None:
        self._directions[client] = {
            each: DirectionState(client, Flow(conversation, each), self._budget) for each in Direction
        }
        self._numbers[conversation] = client
        self._connected_at[client] = now

    def remove(self, client: int) -> None:
        del self._numbers[self.directions(client)[Direction.REQUEST].flow.conversation]
        del self._directions[client], self._connected_at[client]

    def directions(self, client: int) -> Mapping[Direction, DirectionState]:
        """Return the states of both directions of a client; {} for a client that is gone."""
        return self._directions.get(client, {})

    def number_of(self, conversation: Conversation) -> int:
        return self._numbers[conversation]

    def requests(self) -> Iterator[DirectionState]:
        """Yield the request direction of each client."""
        return (each[Direction.REQUEST] for each in self._directions.values())

    def split_streams(self) -> list[DirectionState]:
        states = (state for each in self._directions.values() for state in each.values())
        return [state for state in states if state.splitter is not None]

    def activities(self) -> Iterator[ClientActivity]:
        for number, states in self._directions.items():
            up, down = states[Direction.REQUEST], states[Direction.RESPONSE]
            counts = up.piece_count, up.last_piece_at, down.piece_count, down.last_piece_at
            yield ClientActivity(number, up.flow.conversation, self._connected_at[number], *counts)


class DecisionBuilder:
    """Collects the rules' decision about received data: actions in order, and notes.

    Attributes:
        actions: Actions to do, without those already returned.
        waiting: Number of messages in the data that wait for a decision of the scripts.
        ticket: Number that identifies the data while a message in it waits; 0 if none has waited.
    """

    __slots__ = ("actions", "notes", "ticket", "waiting")

    def __init__(self) -> None:
        self.actions: list[SendAction | CloseAction] = []
        self.notes: list[Message] = []
        self.waiting = self.ticket = 0

    @property
    def note(self) -> Message | None:
        """All different notes as one message; None if there are no notes."""
        return joined_clauses(self.notes)


class UndecidedMessage(NamedTuple):
    """A message that the scripts have to decide about.

    Attributes:
        state: State of the message's direction.
        builder: Decision about all data that arrived together with the message.
    """

    state: DirectionState
    builder: DecisionBuilder


class SplitRequests(NamedTuple):
    """Requests that were held when their client or the proxy ended.

    Attributes:
        forwarded: Datagrams or pieces of a stream that are still sent to the controller.
        dropped: Frames that are not sent any more, and bytes that are not a frame.
    """

    forwarded: list[bytes]
    dropped: list[Frame | bytes]


def split_held_requests(state: DirectionState, held: Iterable[bytes]) -> SplitRequests:
    """Choose the held requests that are still sent: those that stop the robot or release something.

    A motion that starts when its client no longer waits does harm. A stop never does harm. On a stream, the
    rest of a partly sent frame is sent first, because the controller would otherwise take the stop for that
    rest.
    """
    if not state.is_stream:
        split = [_split_frames(parse_datagram(data)) for data in held]
        going = [data for each in split for data in each.forwarded]
        return SplitRequests(going, [lost for each in split for lost in each.dropped])
    splitter = StreamSplitter(synchronized=False)
    items = [piece.item for piece in (*splitter.feed(b"".join(held)), *splitter.close())]
    going, lost = _split_frames(items)
    if going and lost and not (isinstance(items[0], Frame) and not items[0].problems):
        going.insert(0, items[0].raw)
        del lost[0]
    return SplitRequests(going, lost)


def _split_frames(items: Iterable[Frame | Malformed]) -> SplitRequests:
    going: list[bytes] = []
    lost: list[Frame | bytes] = []
    for item in items:
        if not isinstance(item, Frame):
            lost.append(item.raw)
        elif not item.problems and always_passes(item.code, [each.variant for each in item.arguments]):
            going.append(item.raw)
        else:
            lost.append(item)
    return SplitRequests(going, lost)


def join_untouched_bytes(
    actions: list[SendAction | CloseAction], state: DirectionState
) -> Sequence[SendAction | CloseAction]:
    """Join consecutive bytes of a stream that no rule touched, so that the relay sends them as one piece."""
    if not state.is_stream or len(actions) < 2:
        return actions
    found: list[SendAction | CloseAction] = []
    for action in actions:
        last = found[-1] if found else None
        if (
            isinstance(action, SendAction)
            and isinstance(last, SendAction)
            and not action.note
            and not last.note
            and action.client == last.client
            and action.toward is last.toward
        ):
            found[-1] = replace(last, data=last.data + action.data)
        else:
            found.append(action)
    return found
