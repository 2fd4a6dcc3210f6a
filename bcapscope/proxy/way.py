"""One direction of a client: what came, and how it is cut into messages."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from typing import NamedTuple

from msgspec.structs import replace

from bcapscope.protocol.budget import Budget
from bcapscope.protocol.frame import Frame, Malformed, parse_datagram
from bcapscope.protocol.guard import always_passes
from bcapscope.protocol.stream import Splitter
from bcapscope.proxy.hook import Close, Send
from bcapscope.traffic.observation import Conversation, Flow, Transport


class Way:
    """One direction of a client.

    Attributes:
        flow: for filters and faults.
        client: number of the client.
        splitter: of a stream, while something must see its frames.
        begun: bytes have passed.
        pieces: datagrams, or reads of a stream, that came.
        last: when the last of them came; ns.
        ended: the stream has ended.
        overtaken: number of the latest message that stops the motions before it; 0 for none.
    """

    __slots__ = ("_budget", "begun", "client", "ended", "flow", "last", "overtaken", "pieces", "splitter")

    def __init__(self, client: int, flow: Flow, budget: Budget | None = None) -> None:
        """Begin; `budget` counts what is held of unfinished frames of all streams."""
        self._budget = budget
        self.client = client
        self.flow = flow
        self.splitter: Splitter | None = None
        self.begun = self.ended = False
        self.pieces = self.last = self.overtaken = 0

    @property
    def is_stream(self) -> bool:
        """Whether frames must be cut out of it."""
        return self.flow.conversation.transport is Transport.TCP

    def cut(self, data: bytes, into_frames: bool) -> Iterator[bytes]:
        """Cut what came into messages; a stream that nothing must see the frames of passes as it comes."""
        if not self.is_stream:
            yield data
            return
        if into_frames:
            if self.splitter is None:
                self.splitter = Splitter(in_step=not self.begun, budget=self._budget)
            for piece in self.splitter.feed(data):
                yield piece.item.raw
            return
        whole = b"".join((*self.rest(), data))
        if whole:
            yield whole

    def rest(self) -> list[bytes]:
        """Give back what was kept of a frame that is not complete; nothing more is cut."""
        splitter, self.splitter = self.splitter, None
        return [piece.item.raw for piece in splitter.close()] if splitter else []


class Attendance(NamedTuple):
    """A client that is there.

    Attributes:
        number: of the client.
        conversation: between the client and the controller.
        since: ns.
        up: datagrams, or reads of a stream, that came from the client.
        heard: when the last of them came, ns; 0 for never.
        down: those that came from the controller.
        answered: when the last of them came, ns; 0 for never.
    """

    number: int
    conversation: Conversation
    since: int
    up: int
    heard: int
    down: int
    answered: int


class Work:
    """What is done about something that came: actions in order, and what is said of it.

    Attributes:
        actions: in order; those that were given out already are not among them.
        notes: what is said.
        waiting: how many messages in it wait for the scripts.
        ticket: names it while any does; 0 for none so far.
    """

    __slots__ = ("actions", "notes", "ticket", "waiting")

    def __init__(self) -> None:
        self.actions: list[Send | Close] = []
        self.notes: list[str] = []
        self.waiting = self.ticket = 0

    @property
    def note(self) -> str:
        """All notes on it."""
        return "; ".join(dict.fromkeys(self.notes))


class Asked(NamedTuple):
    """A message that the scripts are asked about.

    Attributes:
        way: on which it came.
        came: what is done about all that came with it.
    """

    way: Way
    came: Work


class Parted(NamedTuple):
    """Requests that were held when their client, or the proxy, came to its end.

    Attributes:
        going: what goes on all the same, a datagram or piece of a stream each.
        lost: frames that do not, and bytes that are none.
    """

    going: list[bytes]
    lost: list[Frame | bytes]


def part(way: Way, held: Iterable[bytes]) -> Parted:
    """Choose what goes on of requests that were held too long: what stops the robot or lets go of something.

    A motion that comes when nobody waits for it any more does harm; a stop never does. Of a stream goes on
    before it what is left of a frame that has begun to go, or the stop would be taken for its rest.
    """
    if not way.is_stream:
        parted = [_part(parse_datagram(data)) for data in held]
        going = [data for each in parted for data in each.going]
        return Parted(going, [lost for each in parted for lost in each.lost])
    splitter = Splitter(in_step=False)
    items = [piece.item for piece in (*splitter.feed(b"".join(held)), *splitter.close())]
    going, lost = _part(items)
    if going and lost and not (isinstance(items[0], Frame) and not items[0].problems):
        going.insert(0, items[0].raw)
        del lost[0]
    return Parted(going, lost)


def _part(items: Iterable[Frame | Malformed]) -> Parted:
    going: list[bytes] = []
    lost: list[Frame | bytes] = []
    for item in items:
        if not isinstance(item, Frame):
            lost.append(item.raw)
        elif not item.problems and always_passes(item.code, [each.variant for each in item.arguments]):
            going.append(item.raw)
        else:
            lost.append(item)
    return Parted(going, lost)


def joined(actions: list[Send | Close], way: Way) -> Sequence[Send | Close]:
    """Join bytes of a stream that pass untouched into one piece again, as they came."""
    if not way.is_stream or len(actions) < 2:
        return actions
    found: list[Send | Close] = []
    for action in actions:
        last = found[-1] if found else None
        if (
            isinstance(action, Send)
            and isinstance(last, Send)
            and not action.note
            and not last.note
            and action.client == last.client
            and action.toward is last.toward
        ):
            found[-1] = replace(last, data=last.data + action.data)
        else:
            found.append(action)
    return found
