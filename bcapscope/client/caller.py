"""Connects a `Requester` with a link and a timer of asyncio, and makes one call at a time."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Sequence
from typing import TypeAlias

from bcapscope.messages import Message
from bcapscope.protocol.codec.frame import Frame, Malformed, parse_datagram
from bcapscope.protocol.codec.frame_template import FrameTemplates
from bcapscope.protocol.codec.stream_splitter import StreamSplitter
from bcapscope.protocol.codec.variant import Variant
from bcapscope.protocol.retry.requester import Requester, RequesterEvent, RequesterOutcome, RetryPolicy
from bcapscope.protocol.retry.reserved_convention import ReservedConvention
from bcapscope.traffic.observation import (
    SERVER_PARTICIPANT,
    Conversation,
    Direction,
    Endpoint,
    Flow,
    Observation,
    Transport,
)
from bcapscope.transport.loop_clock import LoopClock
from bcapscope.transport.peer_link import Link

Observer: TypeAlias = Callable[[Observation], None]
"""Gets every frame when the frame is sent or received. An observer must not raise exceptions."""

EventListener: TypeAlias = Callable[[RequesterEvent], None]
"""Gets every event, including notices, late and stray replies. A listener must not raise exceptions."""


class Caller:
    """Makes calls over a link, one after the other, and passes every frame to an observer.

    After each input, such as a received frame, the caller sends the frames of its `Requester`, sets the timer
    and reports events.
    """

    def __init__(
        self,
        observer: Observer | None = None,
        listener: EventListener | None = None,
        fails_if_refused: bool = False,
    ) -> None:
        """Create a caller without a link. The link needs this caller as its receiver, so the link is created
        after the caller. Then pass the link to `attach`.

        If `fails_if_refused`, a call over UDP fails at the first error that the operating system reports for
        sent data. This holds only until the controller has sent any data.
        """
        self._fails_if_refused = fails_if_refused
        self._observer = observer
        self._listener = listener
        self._clock = LoopClock(asyncio.get_running_loop())
        self._one_at_a_time = asyncio.Lock()
        self._timer: asyncio.TimerHandle | None = None
        self._pending_call: asyncio.Future[RequesterOutcome] | None = None
        self._data_arrived: asyncio.Future[None] | None = None
        self._templates = FrameTemplates()
        self._splitter = StreamSplitter(templates=self._templates)
        self._frames_seen = 0
        self._lost_reason: Message | None = None

    def attach(self, link: Link, convention: ReservedConvention) -> None:
        self.link = link
        self._requester = Requester(convention)
        transport = Transport.UDP if link.datagrams else Transport.TCP
        conversation = Conversation(
            Endpoint(*link.local), Endpoint(*link.peer), transport, SERVER_PARTICIPANT
        )
        self._request_flow = Flow(conversation, Direction.REQUEST)
        self._reply_flow = Flow(conversation, Direction.RESPONSE)

    async def perform_call(
        self, function_id: int, arguments: Sequence[Variant], retry_policy: RetryPolicy
    ) -> RequesterOutcome:
        """Make a call and return its outcome, such as the reply or a timeout.

        Raises LocalProtocolError as `Requester.start_call` does, and ConnectionError for a lost link. With
        `fails_if_refused`, a closed port of the controller also raises ConnectionError.
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
        """Send a datagram or bytes of a stream unchanged and without retries, even if the bytes are invalid.

        Return whether the controller sent data within `timeout` s. Raises ConnectionError for a lost link.
        """
        async with self._one_at_a_time:
            if self._lost_reason is not None:
                raise ConnectionResetError(self._lost_reason)
            now = self._clock.now()
            for item in parse_datagram(raw, self._templates):
                self._report_frame(self._request_flow, item, now)
            self._data_arrived = asyncio.get_running_loop().create_future()
            self.link.send(raw)
            done, _ = await asyncio.wait([self._data_arrived], timeout=timeout)
            if self._lost_reason is not None:
                raise ConnectionResetError(self._lost_reason)
            return bool(done)

    def close(self) -> None:
        self.link.close()
        self.on_link_lost(Message("connection.link-closed"))

    def on_data(self, data: bytes) -> None:
        self._fails_if_refused = False
        if self.link.datagrams:
            items: Sequence[Frame | Malformed] = parse_datagram(data, self._templates)
        else:
            items = [piece.item for piece in self._splitter.feed(data)]
        now = self._clock.now()
        for item in items:
            self._report_frame(self._reply_flow, item, now)
            self._requester.receive_item(item, now)
        self._signal_data()
        self._after_input()

    def on_send_error(self, reason: Message) -> None:
        self._requester.record_send_error(reason, self._clock.now())
        if self._fails_if_refused and self._pending_call is not None and not self._pending_call.done():
            self._pending_call.set_exception(ConnectionRefusedError(reason))

    def on_link_lost(self, reason: Message) -> None:
        self._lost_reason = reason
        if self._pending_call is not None and not self._pending_call.done():
            self._pending_call.set_exception(ConnectionResetError(self._lost_reason))
        self._signal_data()

    def _signal_data(self) -> None:
        if self._data_arrived is not None and not self._data_arrived.done():
            self._data_arrived.set_result(None)

    def _on_timer(self) -> None:
        self._requester.handle_timeout(self._clock.now())
        self._after_input()

    def _after_input(self) -> None:
        requester = self._requester
        for raw in requester.data_to_send():
            frame = Frame(raw, None, self._templates)
            self._report_frame(self._request_flow, frame, self._clock.now())
            self.link.send(raw)
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
