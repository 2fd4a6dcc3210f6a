"""Making calls without an event loop: the requester, a channel, and a thread that waits for both.

`begin_call`, `send_due` and `wait_for_outcome` are the steps of a call for a caller with a deadline between
them; `perform_call` is all of them, for a `Session`, which makes its calls through the same requester and so
with the same row of serials.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Coroutine, Sequence
from typing import Any, TypeAlias, TypeVar

from bcapscope.player.channel import Channel
from bcapscope.protocol.codec.frame import Frame, Malformed, parse_datagram
from bcapscope.protocol.codec.stream_splitter import StreamSplitter
from bcapscope.protocol.codec.variant import Variant
from bcapscope.protocol.retry.requester import (
    CallAnswered,
    CallRefused,
    CallTimedOut,
    LateReply,
    Requester,
    RequesterOutcome,
    RetryPolicy,
)
from bcapscope.protocol.retry.reserved_convention import ReservedConvention
from bcapscope.protocol.tables.hresult import S_EXECUTING

R = TypeVar("R")

FrameCallback: TypeAlias = Callable[[bool, bytes, int], None]
"""Is told of every frame: whether we sent it, its bytes, and when it was sent or came, ns of the channel's
clock."""


def run_blocking(steps: Coroutine[Any, Any, R]) -> R:
    """Run a coroutine that never has to wait, since whoever it calls waits inside the call."""
    try:
        steps.send(None)
    except StopIteration as end:
        value: R = end.value
        return value
    raise RuntimeError("a step waits for an event loop, and there is none")


ABORT_CHECK_INTERVAL = 50_000_000
"""ns from one `BlockingCaller.check_abort` to the next."""

READ_RESERVE = 100_000
"""ns that are kept for reading a reply that came while `BlockingCaller.sleep_until_due` slept."""


def _ignore_frame(sent: bool, raw: bytes, time: int) -> None:
    """Take no notice."""


def _never_abort() -> None:
    """There is nothing to look for."""


class BlockingCaller:
    """Makes calls over a channel, one after the other.

    Attributes:
        link: the channel.
        late_replies: replies that came when their try no longer counted; whoever reads them clears the list.
        check_abort: called now and then while `perform_call` waits; what it raises ends the call.
        overslept: ns by which waits of the call took longer than they were to: this machine's own lateness.
    """

    def __init__(
        self,
        channel: Channel,
        convention: ReservedConvention,
        on_frame: FrameCallback = _ignore_frame,
        first_serial: int = 1,
    ) -> None:
        self.link = channel
        self.late_replies: list[LateReply] = []
        self.check_abort: Callable[[], None] = _never_abort
        self.overslept = 0
        self._requester = Requester(convention, first_serial)
        self._splitter = StreamSplitter()
        self._on_frame = on_frame

    async def perform_call(
        self, function_id: int, arguments: Sequence[Variant], retry_policy: RetryPolicy
    ) -> RequesterOutcome:
        """Make a call and return how it ended; it never waits for an event loop.

        Raises:
            LocalProtocolError: it cannot be sent; see `Requester.start_call`.
            OSError: the link is gone.
        """
        try:
            self.begin_call(function_id, arguments, retry_policy, self.link.now())
            self.send_due()
            while True:
                settled = self.wait_for_outcome(self.link.now() + ABORT_CHECK_INTERVAL)
                if settled is not None:
                    return settled
                self.check_abort()
        finally:
            self.abandon()

    def begin_call(
        self, function_id: int, arguments: Sequence[Variant], retry_policy: RetryPolicy, at: int
    ) -> None:
        """Prepare a call that `send_due` makes at the time `at`, from which its time-outs count.

        Raises:
            LocalProtocolError: it cannot be sent; see `Requester.start_call`.
        """
        self._requester.start_call(function_id, arguments, retry_policy, at)
        self.overslept = 0

    def send_due(self) -> int:
        """Send what is due; return the time at which that began.

        Raises:
            OSError: the link is gone.
        """
        now = self.link.now()
        for raw in self._requester.data_to_send():
            self.link.send(raw)
            self._on_frame(True, raw, now)
        return now

    def sleep_until_due(self, until: int) -> None:
        """Sleep for most of the time until a call is tried again, or until `until` if that is before.

        Who has just used the processor, and is woken by a reply before others had as much of it, is made to
        wait for them: without real-time priority three set points in a hundred were 2 ms late at 1 ms, beside
        busy programs, instead of three in a thousand (Linux 6.18, sched-eevdf).
        """
        due, now = self._requester.deadline, self.link.now()
        end = max(now, min(until, until if due is None else due) - READ_RESERVE)
        self.link.sleep_until(end)
        self.overslept += max(0, self.link.now() - end)

    def wait_for_outcome(self, until: int) -> RequesterOutcome | None:
        """Wait for the end of the call, and try again when it is time to; None if it goes on at `until`.

        What comes is read portion by portion only until then: a row of late replies holds nobody up.

        Raises:
            OSError: the link is gone.
        """
        requester = self._requester
        while True:
            settled = self._next_outcome()
            due = requester.deadline
            if settled is not None or due is None:
                return settled
            data = self._receive(min(due, until))
            now = self.link.now()
            if data is not None:
                self._feed_bytes(data)
                now = self.link.now()
            elif now >= due:
                requester.handle_timeout(now)
                self.send_due()
                continue
            if now >= until:
                return self._next_outcome()

    def wait_for_late_reply(self, serials: Collection[int], until: int) -> LateReply | None:
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
            self._next_outcome()
            for late in self.late_replies:
                if late.reply.serial in serials and late.reply.code != S_EXECUTING:
                    return late
            data = self._receive(until)
            now = self.link.now()
            if data is not None:
                self._feed_bytes(data)
            elif now >= until:
                return None

    def abandon(self) -> CallTimedOut:
        """Give up the call under way; return it as one that was not answered."""
        return CallTimedOut(self._requester.abandon())

    def close(self) -> None:
        """Close the channel."""
        self.link.close()

    def _receive(self, until: int) -> bytes | None:
        """Return what comes; on UDP word of a closed port is noted, and tries go on."""
        link = self.link
        end = max(until, link.now())
        try:
            return link.receive(until)
        except ConnectionRefusedError as error:
            if not link.datagrams:
                raise
            self._requester.record_send_error((error.strerror or str(error)).lower(), link.now())
            return None
        finally:
            self.overslept += max(0, link.now() - end)

    def _feed_bytes(self, data: bytes) -> None:
        arrived = self.link.arrival_time
        if self.link.datagrams:
            items: Sequence[Frame | Malformed] = parse_datagram(data)
        else:
            items = [piece.item for piece in self._splitter.feed(data)]
        for item in items:
            self._on_frame(False, item.raw, arrived)
            self._requester.receive_item(item, arrived)

    def _next_outcome(self) -> RequesterOutcome | None:
        settled: RequesterOutcome | None = None
        for event in self._requester.drain_events():
            if isinstance(event, CallAnswered | CallRefused | CallTimedOut):
                settled = event
            elif isinstance(event, LateReply):
                self.late_replies.append(event)
        return settled
