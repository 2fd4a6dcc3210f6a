"""Making calls without an event loop: the requester, a channel, and a thread that waits for both.

`begin`, `send` and `settle` are the steps of a call for whoever has a deadline between them; `exchange` is
all of them, for a `Session`, which makes its calls through the same requester and so with the same row of
serials.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Coroutine, Sequence
from typing import Any, TypeAlias, TypeVar

from bcapscope.player.channel import Channel
from bcapscope.protocol.convention import Convention
from bcapscope.protocol.frame import Frame, Malformed, parse_datagram
from bcapscope.protocol.hresult import S_EXECUTING
from bcapscope.protocol.requester import Answered, Late, Pace, Refused, Requester, Settled, TimedOut
from bcapscope.protocol.stream import Splitter
from bcapscope.protocol.variant import Variant

R = TypeVar("R")

Watcher: TypeAlias = Callable[[bool, bytes, int], None]
"""Is told of every frame: whether we sent it, its bytes, and when it was sent or came, ns of the channel's
clock."""


def run(steps: Coroutine[Any, Any, R]) -> R:
    """Run a coroutine that never has to wait, since whoever it calls waits inside the call."""
    try:
        steps.send(None)
    except StopIteration as end:
        value: R = end.value
        return value
    raise RuntimeError("a step waits for an event loop, and there is none")


LOOK_EACH = 50_000_000
"""ns from one `BlockingExchanger.look` to the next."""

READING = 100_000
"""ns that are kept for reading a reply that came while `BlockingExchanger.rest` slept."""


def _unwatched(sent: bool, raw: bytes, time: int) -> None:
    """Take no notice."""


def _nothing() -> None:
    """There is nothing to look for."""


class BlockingExchanger:
    """Makes calls over a channel, one after the other.

    Attributes:
        link: the channel.
        late: replies that came when their try no longer counted; whoever reads them clears the list.
        look: called now and then while `exchange` waits; what it raises ends the call.
        overslept: ns by which waits of the call took longer than they were to: this machine's own lateness.
    """

    def __init__(
        self, channel: Channel, convention: Convention, watcher: Watcher = _unwatched, first_serial: int = 1
    ) -> None:
        self.link = channel
        self.late: list[Late] = []
        self.look: Callable[[], None] = _nothing
        self.overslept = 0
        self._requester = Requester(convention, first_serial)
        self._splitter = Splitter()
        self._watch = watcher

    async def exchange(self, function_id: int, arguments: Sequence[Variant], pace: Pace) -> Settled:
        """Make a call and return how it ended; it never waits for an event loop.

        Raises:
            LocalProtocolError: it cannot be sent; see `Requester.call`.
            OSError: the link is gone.
        """
        try:
            self.begin(function_id, arguments, pace, self.link.now())
            self.send()
            while True:
                settled = self.settle(self.link.now() + LOOK_EACH)
                if settled is not None:
                    return settled
                self.look()
        finally:
            self.abandon()

    def begin(self, function_id: int, arguments: Sequence[Variant], pace: Pace, at: int) -> None:
        """Prepare a call that `send` makes at the time `at`, from which its time-outs count.

        Raises:
            LocalProtocolError: it cannot be sent; see `Requester.call`.
        """
        self._requester.call(function_id, arguments, pace, at)
        self.overslept = 0

    def send(self) -> int:
        """Send what is due; return the time at which that began.

        Raises:
            OSError: the link is gone.
        """
        now = self.link.now()
        for raw in self._requester.data_to_send():
            self.link.send(raw)
            self._watch(True, raw, now)
        return now

    def rest(self, until: int) -> None:
        """Sleep for most of the time until a call is tried again, or until `until` if that is before.

        Who has just used the processor, and is woken by a reply before others had as much of it, is made to
        wait for them: without real-time priority three set points in a hundred were 2 ms late at 1 ms, beside
        busy programs, instead of three in a thousand (Linux 6.18, sched-eevdf).
        """
        due, now = self._requester.due, self.link.now()
        end = max(now, min(until, until if due is None else due) - READING)
        self.link.rest(end)
        self.overslept += max(0, self.link.now() - end)

    def settle(self, until: int) -> Settled | None:
        """Wait for the end of the call, and try again when it is time to; None if it goes on at `until`.

        What comes is read portion by portion only until then: a row of late replies holds nobody up.

        Raises:
            OSError: the link is gone.
        """
        requester = self._requester
        while True:
            settled = self._events()
            due = requester.due
            if settled is not None or due is None:
                return settled
            data = self._received(min(due, until))
            now = self.link.now()
            if data is not None:
                self._take(data)
                now = self.link.now()
            elif now >= due:
                requester.wake(now)
                self.send()
                continue
            if now >= until:
                return self._events()

    def overdue(self, serials: Collection[int], until: int) -> Late | None:
        """Wait on for a reply to a call that is given up; nothing is sent any more.

        Now one to any of its tries will do, even one that was discarded before: a try again would show
        nothing else, since a call is executed once.

        Args:
            serials: of its tries.
            until: when to stop waiting.

        Raises:
            OSError: the link is gone.
        """
        while True:
            self._events()
            for late in self.late:
                if late.reply.serial in serials and late.reply.code != S_EXECUTING:
                    return late
            data = self._received(until)
            now = self.link.now()
            if data is not None:
                self._take(data)
            elif now >= until:
                return None

    def abandon(self) -> TimedOut:
        """Give up the call under way; return it as one that was not answered."""
        return TimedOut(self._requester.abandon())

    def close(self) -> None:
        """Close the channel."""
        self.link.close()

    def _received(self, until: int) -> bytes | None:
        """Return what comes; on UDP word of a closed port is noted, and tries go on."""
        link = self.link
        end = max(until, link.now())
        try:
            return link.receive(until)
        except ConnectionRefusedError as error:
            if not link.datagrams:
                raise
            self._requester.trouble((error.strerror or str(error)).lower(), link.now())
            return None
        finally:
            self.overslept += max(0, link.now() - end)

    def _take(self, data: bytes) -> None:
        arrived = self.link.arrived
        if self.link.datagrams:
            items: Sequence[Frame | Malformed] = parse_datagram(data)
        else:
            items = [piece.item for piece in self._splitter.feed(data)]
        for item in items:
            self._watch(False, item.raw, arrived)
            self._requester.receive(item, arrived)

    def _events(self) -> Settled | None:
        settled: Settled | None = None
        for event in self._requester.events():
            if isinstance(event, Answered | Refused | TimedOut):
                settled = event
            elif isinstance(event, Late):
                self.late.append(event)
        return settled
