"""The asyncio shell around the requester: bytes in, bytes out, one timer."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Sequence
from typing import TypeAlias

from bcapscope.protocol.codec.frame import Frame, Malformed, parse_datagram
from bcapscope.protocol.codec.stream_splitter import StreamSplitter
from bcapscope.protocol.codec.variant import Variant
from bcapscope.protocol.retry.requester import Requester, RequesterEvent, RequesterOutcome, RetryPolicy
from bcapscope.protocol.retry.reserved_convention import ReservedConvention
from bcapscope.traffic.observation import Conversation, Direction, Endpoint, Flow, Observation, Transport
from bcapscope.transport.loop_clock import LoopClock
from bcapscope.transport.peer_link import Link

Observer: TypeAlias = Callable[[Observation], None]
"""Sees every frame that goes out or comes in, at once; it must not raise."""

EventListener: TypeAlias = Callable[[RequesterEvent], None]
"""Hears of all that happens, late and strange replies and notices included; it must not raise."""


class Caller:
    """Makes calls over a link, one after the other, and lets an observer see every frame.

    After every input, which is a call, bytes or the timer, the same is done: send what is due, set the timer,
    tell what happened.
    """

    def __init__(self, observer: Observer | None = None, listener: EventListener | None = None) -> None:
        """Begin without a link, since a link must be told first who receives."""
        self._observer = observer
        self._listener = listener
        self._clock = LoopClock(asyncio.get_running_loop())
        self._one_at_a_time = asyncio.Lock()
        self._timer: asyncio.TimerHandle | None = None
        self._pending_call: asyncio.Future[RequesterOutcome] | None = None
        self._data_arrived: asyncio.Future[None] | None = None
        self._splitter = StreamSplitter()
        self._frames_seen = 0
        self._lost_reason: str | None = None

    def attach(self, link: Link, convention: ReservedConvention) -> None:
        """Use `link` from now on."""
        self._link = link
        self._requester = Requester(convention)
        transport = Transport.UDP if link.datagrams else Transport.TCP
        conversation = Conversation(
            Endpoint(*link.local), Endpoint(*link.peer), transport, "we are the client"
        )
        self._request_flow = Flow(conversation, Direction.REQUEST)
        self._reply_flow = Flow(conversation, Direction.RESPONSE)

    @property
    def link(self) -> Link:
        """The link in use."""
        return self._link

    async def perform_call(
        self, function_id: int, arguments: Sequence[Variant], retry_policy: RetryPolicy
    ) -> RequesterOutcome:
        """Make a call and return how it ended.

        Raises:
            LocalProtocolError: it cannot be sent; see `Requester.start_call`.
            ConnectionError: the link is gone.
        """
        async with self._one_at_a_time:
            if self._lost_reason is not None:
                raise ConnectionResetError(self._lost_reason)
            self._requester.start_call(function_id, arguments, retry_policy, self._clock.now())
            self._pending_call = asyncio.get_running_loop().create_future()
            self._after_input()
            try:
                return await self._pending_call
            finally:
                self._pending_call = None
                self._requester.abandon()
                self._after_input()

    async def send_raw(self, raw: bytes, timeout: float) -> bool:
        """Send bytes as they are, whether or not they make sense; nothing is sent again.

        Args:
            raw: one datagram, or bytes of a stream.
            timeout: seconds to wait for something to come.

        Returns:
            Whether something came; what it was, the observer has seen.

        Raises:
            ConnectionError: the link is gone.
        """
        async with self._one_at_a_time:
            if self._lost_reason is not None:
                raise ConnectionResetError(self._lost_reason)
            now = self._clock.now()
            for item in parse_datagram(raw):
                self._report_frame(self._request_flow, item, now)
            self._data_arrived = asyncio.get_running_loop().create_future()
            self._link.send(raw)
            done, _ = await asyncio.wait([self._data_arrived], timeout=timeout)
            if self._lost_reason is not None:
                raise ConnectionResetError(self._lost_reason)
            return bool(done)

    def close(self) -> None:
        """Close the link."""
        self._link.close()
        self.on_link_lost("the link was closed")

    def on_data(self, data: bytes) -> None:
        """Take what came over the link."""
        if self._link.datagrams:
            items: Sequence[Frame | Malformed] = parse_datagram(data)
        else:
            items = [piece.item for piece in self._splitter.feed(data)]
        now = self._clock.now()
        for item in items:
            self._report_frame(self._reply_flow, item, now)
            self._requester.receive_item(item, now)
        self._signal_data()
        self._after_input()

    def on_send_error(self, text: str) -> None:
        """Take what the system says of the last packet."""
        self._requester.record_send_error(text, self._clock.now())

    def on_link_lost(self, reason: str) -> None:
        """Take notice that the link is gone: the call under way fails, and so do all to come."""
        self._lost_reason = reason
        if self._pending_call is not None and not self._pending_call.done():
            self._pending_call.set_exception(ConnectionResetError(self._lost_reason))
        self._signal_data()

    def _signal_data(self) -> None:
        """Tell whoever has sent raw bytes."""
        if self._data_arrived is not None and not self._data_arrived.done():
            self._data_arrived.set_result(None)

    def _on_timer(self) -> None:
        self._requester.handle_timeout(self._clock.now())
        self._after_input()

    def _after_input(self) -> None:
        """Do what follows every input."""
        requester = self._requester
        for raw in requester.data_to_send():
            self._report_frame(self._request_flow, Frame(raw), self._clock.now())
            self._link.send(raw)
        if self._timer is not None:
            self._timer.cancel()
        due = requester.deadline
        self._timer = None if due is None else self._clock.call_at(due, self._on_timer)
        for event in requester.drain_events():
            if self._listener is not None:
                self._listener(event)
            if (
                isinstance(event, RequesterOutcome)
                and self._pending_call is not None
                and not self._pending_call.done()
            ):
                self._pending_call.set_result(event)

    def _report_frame(self, flow: Flow, item: Frame | Malformed, now: int) -> None:
        if self._observer is not None:
            self._frames_seen += 1
            time = self._clock.since_1970(now)
            self._observer(Observation(self._frames_seen, time, time, flow, item, 0))
