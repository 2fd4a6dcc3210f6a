"""The asyncio shell around the requester: bytes in, bytes out, one timer."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Sequence
from typing import TypeAlias

from bcapscope.protocol.convention import Convention
from bcapscope.protocol.frame import Frame, Malformed, parse_datagram
from bcapscope.protocol.requester import Event, Pace, Requester, Settled
from bcapscope.protocol.stream import Splitter
from bcapscope.protocol.variant import Variant
from bcapscope.traffic.observation import Conversation, Direction, Endpoint, Flow, Observation, Transport
from bcapscope.transport.clock import Clock
from bcapscope.transport.link import Link

Observer: TypeAlias = Callable[[Observation], None]
"""Sees every frame that goes out or comes in, at once; it must not raise."""

Listener: TypeAlias = Callable[[Event], None]
"""Hears of all that happens, late and strange replies and notices included; it must not raise."""


class Caller:
    """Makes calls over a link, one after the other, and lets an observer see every frame.

    After every input, which is a call, bytes or the timer, the same is done: send what is due, set the timer,
    tell what happened.
    """

    def __init__(self, observer: Observer | None = None, listener: Listener | None = None) -> None:
        """Begin without a link, since a link must be told first who receives."""
        self._observer = observer
        self._listener = listener
        self._clock = Clock(asyncio.get_running_loop())
        self._one_at_a_time = asyncio.Lock()
        self._timer: asyncio.TimerHandle | None = None
        self._waiting: asyncio.Future[Settled] | None = None
        self._something: asyncio.Future[None] | None = None
        self._splitter = Splitter()
        self._seen = 0
        self._lost: str | None = None

    def attach(self, link: Link, convention: Convention) -> None:
        """Use `link` from now on."""
        self._link = link
        self._requester = Requester(convention)
        transport = Transport.UDP if link.datagrams else Transport.TCP
        conversation = Conversation(
            Endpoint(*link.local), Endpoint(*link.peer), transport, "we are the client"
        )
        self._out = Flow(conversation, Direction.REQUEST)
        self._in = Flow(conversation, Direction.RESPONSE)

    @property
    def link(self) -> Link:
        """The link in use."""
        return self._link

    async def exchange(self, function_id: int, arguments: Sequence[Variant], pace: Pace) -> Settled:
        """Make a call and return how it ended.

        Raises:
            LocalProtocolError: it cannot be sent; see `Requester.call`.
            ConnectionError: the link is gone.
        """
        async with self._one_at_a_time:
            if self._lost is not None:
                raise ConnectionResetError(self._lost)
            self._requester.call(function_id, arguments, pace, self._clock.now())
            self._waiting = asyncio.get_running_loop().create_future()
            self._settle()
            try:
                return await self._waiting
            finally:
                self._waiting = None
                self._requester.abandon()
                self._settle()

    async def send_raw(self, raw: bytes, patience: float) -> bool:
        """Send bytes as they are, whether or not they make sense; nothing is sent again.

        Args:
            raw: one datagram, or bytes of a stream.
            patience: seconds to wait for something to come.

        Returns:
            Whether something came; what it was, the observer has seen.

        Raises:
            ConnectionError: the link is gone.
        """
        async with self._one_at_a_time:
            if self._lost is not None:
                raise ConnectionResetError(self._lost)
            now = self._clock.now()
            for item in parse_datagram(raw):
                self._observe(self._out, item, now)
            self._something = asyncio.get_running_loop().create_future()
            self._link.send(raw)
            done, _ = await asyncio.wait([self._something], timeout=patience)
            if self._lost is not None:
                raise ConnectionResetError(self._lost)
            return bool(done)

    def close(self) -> None:
        """Close the link."""
        self._link.close()
        self.lost("the link was closed")

    def received(self, data: bytes) -> None:
        """Take what came over the link."""
        if self._link.datagrams:
            items: Sequence[Frame | Malformed] = parse_datagram(data)
        else:
            items = [piece.item for piece in self._splitter.feed(data)]
        now = self._clock.now()
        for item in items:
            self._observe(self._in, item, now)
            self._requester.receive(item, now)
        self._came()
        self._settle()

    def trouble(self, text: str) -> None:
        """Take what the system says of the last packet."""
        self._requester.trouble(text, self._clock.now())

    def lost(self, reason: str) -> None:
        """Take notice that the link is gone: the call under way fails, and so do all to come."""
        self._lost = reason
        if self._waiting is not None and not self._waiting.done():
            self._waiting.set_exception(ConnectionResetError(self._lost))
        self._came()

    def _came(self) -> None:
        """Tell whoever has sent raw bytes."""
        if self._something is not None and not self._something.done():
            self._something.set_result(None)

    def _wake(self) -> None:
        self._requester.wake(self._clock.now())
        self._settle()

    def _settle(self) -> None:
        """Do what follows every input."""
        requester = self._requester
        for raw in requester.data_to_send():
            self._observe(self._out, Frame(raw), self._clock.now())
            self._link.send(raw)
        if self._timer is not None:
            self._timer.cancel()
        due = requester.due
        self._timer = None if due is None else self._clock.wake_at(due, self._wake)
        for event in requester.events():
            if self._listener is not None:
                self._listener(event)
            if isinstance(event, Settled) and self._waiting is not None and not self._waiting.done():
                self._waiting.set_result(event)

    def _observe(self, flow: Flow, item: Frame | Malformed, now: int) -> None:
        if self._observer is not None:
            self._seen += 1
            time = self._clock.since_1970(now)
            self._observer(Observation(self._seen, time, time, flow, item, 0))
