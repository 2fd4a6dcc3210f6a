"""Sessions of one client over UDP, captured somewhere on the way, of which every detail is known.

Unlike `sessions`, frames are lost before and behind the places of capture, the captures miss requests, and
each direction takes a time of its own.
"""

from __future__ import annotations

import heapq
import random
from dataclasses import dataclass, field
from typing import NamedTuple

from bcapscope.protocol.codec.frame import Frame, encode_frame
from bcapscope.protocol.codec.variant import VT, Variant
from bcapscope.traffic.joining.joined_observation import CapturePlace
from bcapscope.traffic.joining.place_merger import CapturedTwins, CaptureSide, Coverage
from bcapscope.traffic.observation import (
    SERVER_PORT,
    Conversation,
    Direction,
    Endpoint,
    Flow,
    Observation,
    Transport,
)

US, MS = 1_000, 1_000_000
S_EXECUTING = 0x900
START = 1_700_000_000_000_000_000
JITTER = 0.2
"""Share by which a datagram may take longer than the shortest one."""


@dataclass(frozen=True)
class Surroundings:
    """How a client, its network and the place of capture are.

    Attributes:
        convention: `seed`, `own` or `chain`.
        place: share of the way from the client to the controller, at which the capture is taken.
        far_place: share of the way at which a second capture is taken; None for one capture.
        is_relayed: whether the two places are the legs of a proxy, which records both.
        up, down: shortest time of a datagram to the controller and to the client, in µs.
        timeout: of an attempt, in ms.
        tries: most attempts of a call.
        loss: share of datagrams that are lost on each half of the way.
        missed: share of requests that the capture misses.
        work: time that the controller usually takes, in µs.
        slow: share of calls that take the controller up to four timeouts.
        notices: ms between two S_EXECUTING while the controller works; 0 for a controller that sends none.
        holds: whether the client sends the same position again and again.
    """

    convention: str = "seed"
    place: float = 0.0
    far_place: float | None = None
    is_relayed: bool = False
    up: int = 300
    down: int = 300
    timeout: int = 8
    tries: int = 4
    loss: float = 0.1
    missed: float = 0.0
    work: int = 400
    slow: float = 0.0
    notices: int = 0
    holds: bool = False

    @property
    def places(self) -> tuple[float, ...]:
        """The places of capture, the one at the client's side first."""
        return (self.place,) if self.far_place is None else (self.place, self.far_place)


@dataclass
class Reply:
    """A reply of the controller.

    Attributes:
        attempt: serial of the attempt that it answers.
        came: when it reached the client; None if it was lost.
    """

    attempt: int
    came: int | None = None


@dataclass
class KnownCall:
    """What really happened to a call.

    Attributes:
        sent: for each attempt, its serial and when the client sent it.
        accepted: serial of the attempt whose reply the client accepted.
        gave_up_at: when the client gave up waiting for a reply to its last attempt.
        replies: by frame number in the capture, those that were captured.
        answered: each reply that the controller sent.
    """

    number: int
    body: tuple[int, tuple[Variant, ...]]
    sent: list[tuple[int, int]] = field(default_factory=list)
    accepted: int | None = None
    gave_up_at: int | None = None
    replies: list[tuple[int, Reply]] = field(default_factory=list)
    answered: list[Reply] = field(default_factory=list)

    def given_up_at(self, serial: int) -> int | None:
        """Return when the client stopped waiting for the reply to an attempt; None if it never did."""
        later = [time for other, time in self.sent if (other - serial) & 0xFFFF in range(1, 0x8000)]
        return min(later, default=self.gave_up_at)


class Seen(NamedTuple):
    """A frame that was captured.

    Attributes:
        sent: number of the datagram among all that were sent; the same at each place of capture.
        place: index of the place of capture.
    """

    time: int
    direction: Direction
    raw: bytes
    call: KnownCall
    reply: Reply | None
    sent: int
    place: int


class CapturedSession:
    """A client, run to the end when made.

    Attributes:
        calls: what really happened.
        observations: what was captured.
        seen: for each observation, what it is.
        by_serial: the calls, by the serials of their attempts.
    """

    def __init__(self, around: Surroundings, calls: int, seed: int) -> None:
        self.around = around
        self.calls: list[KnownCall] = []
        self.by_serial: dict[int, KnownCall] = {}
        self._random = random.Random(seed)
        self._events: list[tuple[int, int, str, KnownCall, int, Reply | None]] = []
        self._order = self._sent = 0
        self._now = START
        self._serial = self._random.choice((0, 99, 65500))
        self._free_at = self._deadline = 0
        self._done_at: dict[int, int] = {}
        self._latest = {Direction.REQUEST: 0, Direction.RESPONSE: 0}
        self.seen: list[Seen] = []
        for number in range(calls):
            self._make_call(number)
        while self._events:
            self._step()
        self.seen.sort(key=lambda seen: seen.time)
        self.observations = self._observe()

    def _observe(self) -> list[Observation]:
        flows = [
            {direction: Flow(conversation, direction) for direction in Direction}
            for conversation in self._conversations()
        ]
        found = []
        for number, seen in enumerate(self.seen, 1):
            flow = flows[seen.place][seen.direction]
            found.append(Observation(number, seen.time, seen.time, flow, Frame(seen.raw), number))
            if seen.reply is not None:
                seen.call.replies.append((number, seen.reply))
        return found

    def _conversations(self) -> list[Conversation]:
        """Return the conversation as each capture has it. The clocks of the captures agree."""
        ends = Endpoint("10.0.0.2", 50001), Endpoint("10.0.0.1", 5007)
        places = [Conversation(*ends, Transport.UDP, SERVER_PORT) for _ in self.around.places]
        if len(places) > 1:
            twins = CapturedTwins((Coverage(), Coverage()), 0, is_relayed=self.around.is_relayed)
            for conversation, place in zip(places, CapturePlace, strict=True):
                conversation.capture_side = CaptureSide(twins, place)
        return places

    # the client

    def _make_call(self, number: int) -> None:
        around = self.around
        pose = 0.0 if around.holds else float(number)
        joints = Variant.array(VT.R8, (pose, 1.0))
        call = KnownCall(number, (64, (Variant(VT.I4, 1), Variant(VT.BSTR, "slvMove"), joints)))
        self.calls.append(call)
        for _ in range(around.tries):
            self._send(call)
            self._deadline = self._now + around.timeout * MS
            while call.accepted is None and self._events and self._events[0][0] <= self._deadline:
                self._step()
            if call.accepted is not None:
                break
            self._now = self._deadline
        else:
            call.gave_up_at = self._now
        quick = number < 6
        until = self._now + (150 * US if quick else self._random.randrange(100 * US, 7500 * US))
        while self._events and self._events[0][0] <= until:
            self._step()
        self._now = until

    def _send(self, call: KnownCall) -> None:
        serial = self._serial = self._serial % 0xFFFF + 1
        first = not call.sent
        reserved = serial if self.around.convention == "own" else 0
        if not first:
            reserved = call.sent[-1 if self.around.convention == "chain" else 0][0]
        call.sent.append((serial, self._now))
        self.by_serial[serial] = call
        raw = encode_frame(serial, reserved, *call.body)
        self._carry(Direction.REQUEST, raw, call, serial, None)

    # the network

    def _carry(
        self, direction: Direction, raw: bytes, call: KnownCall, serial: int, reply: Reply | None
    ) -> None:
        """Bring a datagram past the places of capture to the other end, in order."""
        around = self.around
        upward = direction is Direction.REQUEST
        shortest = (around.up if upward else around.down) * US
        takes = shortest + round(self._random.random() * JITTER * shortest)
        arrives = max(self._now + takes, self._latest[direction] + 1)
        self._latest[direction] = arrives
        self._sent += 1
        is_missed = upward and self._random.random() < around.missed
        shares = sorted((at if upward else 1 - at, index) for index, at in enumerate(around.places))
        passed = 0.0
        for share, index in shares:
            if share > passed and self._random.random() < around.loss:
                return
            if not is_missed:
                passes = self._now + round((arrives - self._now) * share)
                self.seen.append(Seen(passes, direction, raw, call, reply, self._sent, index))
            passed = share
        if passed < 1 and self._random.random() < around.loss:
            return
        self._at(arrives, "serve" if upward else "take", call, serial, reply)

    def _at(self, time: int, what: str, call: KnownCall, serial: int, reply: Reply | None) -> None:
        self._order += 1
        heapq.heappush(self._events, (time, self._order, what, call, serial, reply))

    def _step(self) -> None:
        time, _, what, call, serial, reply = heapq.heappop(self._events)
        before, self._now = self._now, time
        if what == "serve":
            self._serve(call, serial)
        elif what == "answer":
            raw = encode_frame(serial, 0, 0, (Variant(VT.I4, call.number),))
            if reply is None:
                raw = encode_frame(serial, 0, S_EXECUTING)
            self._carry(Direction.RESPONSE, raw, call, serial, reply)
        elif reply is not None:
            reply.came = time
            if call.accepted is None and call.gave_up_at is None and call.sent[-1][0] == serial:
                call.accepted = serial
        elif call.accepted is None and call.gave_up_at is None and call.sent[-1][0] == serial:
            self._deadline = time + self.around.timeout * MS
        self._now = max(before, time)

    # the controller

    def _serve(self, call: KnownCall, serial: int) -> None:
        """Answer an attempt; a retry gets the stored answer once the call is done."""
        begins = max(self._now, self._free_at)
        if call.number not in self._done_at:
            work = round(self.around.work * US * (1 + JITTER * self._random.random()))
            if self._random.random() < self.around.slow:
                work = self._random.randrange(4 * self.around.timeout * MS)
            self._done_at[call.number] = self._free_at = begins + work
            every = self.around.notices * MS
            for notice in range(begins + every, begins + work, every) if every else ():
                self._at(notice, "answer", call, serial, None)
        done = max(self._done_at[call.number], self._now) + 20 * US
        call.answered.append(Reply(serial))
        self._at(done, "answer", call, serial, call.answered[-1])
