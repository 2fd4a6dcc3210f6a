"""One direction of a client: what came, and how it is cut into messages."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from typing import NamedTuple

from msgspec.structs import replace

from bcapscope.protocol.codec.byte_budget import ByteBudget
from bcapscope.protocol.codec.frame import Frame, Malformed, parse_datagram
from bcapscope.protocol.codec.stream_splitter import StreamSplitter
from bcapscope.protocol.guard import always_passes
from bcapscope.proxy.policy import CloseAction, SendAction
from bcapscope.traffic.observation import Conversation, Flow, Transport


class DirectionState:
    """One direction of a client.

    Attributes:
        flow: for filters and faults.
        client: number of the client.
        splitter: of a stream, while something must see its frames.
        has_begun: bytes have passed.
        piece_count: datagrams, or reads of a stream, that came.
        last_piece_at: when the last of them came; ns.
        has_ended: the stream has ended.
        overtaken_by: number of the latest message that stops the motions before it; 0 for none.
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
        """Begin; `budget` counts what is held of unfinished frames of all streams."""
        self._budget = budget
        self.client = client
        self.flow = flow
        self.splitter: StreamSplitter | None = None
        self.has_begun = self.has_ended = False
        self.piece_count = self.last_piece_at = self.overtaken_by = 0

    @property
    def is_stream(self) -> bool:
        """Whether frames must be cut out of it."""
        return self.flow.conversation.transport is Transport.TCP

    def cut_messages(self, data: bytes, into_frames: bool) -> Iterator[bytes]:
        """Cut what came into messages; a stream that nothing must see the frames of passes as it comes."""
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
        """Give back what was kept of a frame that is not complete; nothing more is cut."""
        splitter, self.splitter = self.splitter, None
        return [piece.item.raw for piece in splitter.close()] if splitter else []


class ClientActivity(NamedTuple):
    """A client that is there.

    Attributes:
        number: of the client.
        conversation: between the client and the controller.
        since: ns.
        up: datagrams, or reads of a stream, that came from the client.
        last_request_at: when the last of them came, ns; 0 for never.
        down: those that came from the controller.
        last_reply_at: when the last of them came, ns; 0 for never.
    """

    number: int
    conversation: Conversation
    since: int
    up: int
    last_request_at: int
    down: int
    last_reply_at: int


class DecisionBuilder:
    """What is done about something that came: actions in order, and what is said of it.

    Attributes:
        actions: in order; those that were given out already are not among them.
        notes: what is said.
        waiting: how many messages in it wait for the scripts.
        ticket: names it while any does; 0 for none so far.
    """

    __slots__ = ("actions", "notes", "ticket", "waiting")

    def __init__(self) -> None:
        self.actions: list[SendAction | CloseAction] = []
        self.notes: list[str] = []
        self.waiting = self.ticket = 0

    @property
    def note(self) -> str:
        """All notes on it."""
        return "; ".join(dict.fromkeys(self.notes))


class UndecidedMessage(NamedTuple):
    """A message that the scripts are asked about.

    Attributes:
        state: on which it came.
        builder: what is done about all that came with it.
    """

    state: DirectionState
    builder: DecisionBuilder


class SplitRequests(NamedTuple):
    """Requests that were held when their client, or the proxy, came to its end.

    Attributes:
        forwarded: what goes on all the same, a datagram or piece of a stream each.
        dropped: frames that do not, and bytes that are none.
    """

    forwarded: list[bytes]
    dropped: list[Frame | bytes]


def split_held_requests(state: DirectionState, held: Iterable[bytes]) -> SplitRequests:
    """Choose what goes on of requests that were held too long: what stops the robot or lets go of something.

    A motion that comes when nobody waits for it any more does harm; a stop never does. Of a stream goes on
    before it what is left of a frame that has begun to go, or the stop would be taken for its rest.
    """
    if not state.is_stream:
        parted = [_split_frames(parse_datagram(data)) for data in held]
        going = [data for each in parted for data in each.forwarded]
        return SplitRequests(going, [lost for each in parted for lost in each.dropped])
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
    """Join bytes of a stream that pass untouched into one piece again, as they came."""
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
