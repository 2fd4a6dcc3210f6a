"""Sessions played by a client, a network and a server of whose doings every detail is known.

The clients number their requests as DENSO Wave 2009, orin_bcap's clients and the older C client do; the
server answers in order, knows a retry for one (or, as an option, does not) and sends S_EXECUTING while it is
at work. What passes the place of capture is written down with the call that it belongs to.
"""

from __future__ import annotations

import heapq
import random
from dataclasses import dataclass, field
from typing import NamedTuple

from bcapscope.protocol.codec.frame import Frame, encode_frame
from bcapscope.protocol.codec.variant import VT, Variant
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
START = 1_700_000_000_000_000_000
S_EXECUTING = 0x900
SLOWEST = 40 * MS
"""No datagram is on its way for longer."""
A_WHILE = 101 * MS
"""A client that starts anew takes at least as long."""
LONGEST_QUEUE = 300 * MS
"""The server drops what it could not begin with sooner."""


@dataclass(frozen=True)
class Profile:
    """How a client, its network and its server behave. On TCP nothing is lost, copied or begun anew.

    Attributes:
        convention: `seed`, `own`, `chain`, or on TCP `tcp0`, `tcp1` or `same`, where a serial is used again
            after a time-out.
        first_serial: of each service session.
        through_zero: serial 0 follows 65535, not 1.
        timeout: of a try, in milliseconds.
        tries: most tries of a call.
        loss: share of datagrams lost, each way.
        copies: share of frames of which the capture has a copy.
        delay: greatest delay of a datagram, in milliseconds; below `SLOWEST`.
        slow: share of calls at which the server works for long and says so.
        restart: share of calls in which the client stops and starts anew, on the same port.
        forgetful: the server executes each try anew.
        echo: replies carry the request's reserved, not 0.
    """

    convention: str = "seed"
    first_serial: int = 1
    through_zero: bool = False
    timeout: int = 5
    tries: int = 4
    loss: float = 0.1
    copies: float = 0.0
    delay: float = 4.0
    slow: float = 0.0
    restart: float = 0.0
    forgetful: bool = False
    echo: bool = False

    @property
    def is_tcp(self) -> bool:
        return self.convention in ("tcp0", "tcp1", "same")


class Record(NamedTuple):
    """What passed the place of capture.

    Attributes:
        call: the client's own number of the call.
        kind: `request`, `reply` or `notice`.
        attempt: which try of the call, from 0, this is or answers.
    """

    time: int
    direction: Direction
    raw: bytes
    call: int
    kind: str
    attempt: int


@dataclass
class _Call:
    number: int
    body: tuple[int, tuple[Variant, ...]]
    serials: list[int] = field(default_factory=list)
    reserved: list[int] = field(default_factory=list)
    done: bool = False
    given_up: bool = False


class Session:
    """One client, run to the end when made.

    Attributes:
        records: what a capture on the client's computer sees, in order.
        crossing: the same at a place between, where requests and replies may be late and out of order.
        accepted: for each call that the client took a reply for, which try it answered.
    """

    def __init__(self, profile: Profile, calls: int, seed: int) -> None:
        self.profile = profile
        self.records: list[Record] = []
        self.crossing: list[Record] = []
        self.accepted: dict[int, int] = {}
        self._random = random.Random(seed)
        self._calls = calls
        self._events: list[tuple[int, int, str, _Call, int]] = []
        self._order = 0
        self._now = START + self._random.randrange(MS)
        self._serial = profile.first_serial - 1
        self._server_free = 0
        self._stored: dict[int, int] = {}
        self._executions = 0
        self._deadline = 0
        self._anew = True
        self._current = _Call(-1, (0, ()))
        self._run()
        self.records.sort(key=lambda record: record.time)
        self.crossing.sort(key=lambda record: record.time)

    # the client

    def _run(self) -> None:
        for number in range(self._calls):
            self._current = _Call(number, self._question(number))
            self._make(self._current)
        while self._events:
            self._step()

    def _question(self, number: int) -> tuple[int, tuple[Variant, ...]]:
        if self._anew:
            self._anew = False
            return 1, (Variant(VT.BSTR, ""),)
        pose = self._random.randrange(2)
        if not self._current.done:
            pose = number + 10  # the same question again behind serial 0 would be a retry to anyone
        joints = Variant.array(VT.R8, (float(pose), 1.0))
        return 64, (Variant(VT.I4, 1), Variant(VT.BSTR, "slvMove"), joints)

    def _make(self, call: _Call) -> None:
        profile = self.profile
        tries = 1 if profile.is_tcp else profile.tries
        stop = not profile.is_tcp and call.number > 0 and self._random.random() < profile.restart
        for attempt in range(tries):
            self._send(call, attempt)
            self._deadline = self._now + profile.timeout * MS
            while not call.done and self._events and self._events[0][0] <= self._deadline:
                self._step()
            if call.done:
                break
            self._now = max(self._now, self._deadline)
            if stop:
                break
        call.given_up = not call.done
        if stop:
            self._start_anew()
        else:
            self._pause()

    def _pause(self) -> None:
        until = self._now + self._random.choice((20 * US, 500 * US, 3 * MS, 90 * MS))
        while self._events and self._events[0][0] <= until:
            self._step()
        self._now = until

    def _start_anew(self) -> None:
        """Stop, let everything on its way arrive or vanish, and begin again with the first serial."""
        while self._events:
            self._step()
        self._now += A_WHILE
        self._serial = self.profile.first_serial - 1
        self._stored.clear()
        self._anew = True

    def _next_serial(self, is_retry: bool) -> int:
        self._serial = (self._serial + 1) & 0xFFFF
        passes = self.profile.through_zero or (is_retry and self.profile.convention == "chain")
        if self._serial == 0 and not passes:
            self._serial = 1
        return self._serial

    def _send(self, call: _Call, attempt: int) -> None:
        convention = self.profile.convention
        if convention == "same" and call.number > 0 and call.number - 1 not in self.accepted:
            serial = self._serial or self._next_serial(False)
        else:
            serial = self._next_serial(attempt > 0)
        reserved = {"tcp1": 1, "own": serial}.get(convention, 0)
        if attempt and convention == "chain":
            reserved = call.serials[-1]
        elif attempt:
            reserved = call.serials[0]
        call.serials.append(serial)
        call.reserved.append(reserved)
        raw = encode_frame(serial, reserved, *call.body)
        record = Record(self._now, Direction.REQUEST, raw, call.number, "request", attempt)
        self._see(self.records, record)
        self._carry(record, "server", call, attempt)

    def _take(self, call: _Call, attempt: int, kind: str) -> None:
        """Accept a reply to the last try; where serials are used again, that of an earlier call too."""
        current = self._current
        if call is not current and self.profile.convention != "same":
            return
        if current.done or current.given_up or call.serials[attempt] != current.serials[-1]:
            return
        if kind == "notice":
            self._deadline = self._now + self.profile.timeout * MS
        else:
            current.done = True
            self.accepted[current.number] = attempt

    # the network

    def _carry(self, record: Record, what: str, call: _Call, attempt: int) -> None:
        """Bring a datagram to the other end and past the place between, or lose it before or behind that."""
        delay = 100 * US if self.profile.is_tcp else self._delay()
        lost = not self.profile.is_tcp and self._random.random() < self.profile.loss
        if not lost or self._random.random() < 0.5:
            self._see(self.crossing, record._replace(time=record.time + self._random.randrange(delay)))
        if not lost:
            self._at(record.time + delay, what, call, attempt)

    def _delay(self) -> int:
        return 50 * US + round(self._random.random() ** 4 * self.profile.delay * MS)

    def _at(self, time: int, what: str, call: _Call, attempt: int) -> None:
        self._order += 1
        heapq.heappush(self._events, (time, self._order, what, call, attempt))

    def _step(self) -> None:
        time, _, what, call, attempt = heapq.heappop(self._events)
        self._now = max(self._now, time)
        if what == "server":
            self._serve(time, call, attempt)
        else:
            kind, _, number = what.partition(" ")
            self._arrive(time, call, attempt, kind, int(number or 0))

    def _see(self, records: list[Record], record: Record) -> None:
        records.append(record)
        copied = not self.profile.is_tcp and record.kind != "notice"
        if copied and self._random.random() < self.profile.copies:
            records.append(record._replace(time=record.time + self._random.randrange(1, 15 * US)))

    # the server

    def _serve(self, time: int, call: _Call, attempt: int) -> None:
        begin = max(time, self._server_free)
        if begin - time > LONGEST_QUEUE:
            return
        known = call.number in self._stored and not self.profile.forgetful
        work = 30 * US if known else self._random.randrange(50 * US, 900 * US)
        if not known:
            if self._random.random() < self.profile.slow:
                work = self._random.randrange(3, 4 * self.profile.timeout) * MS
            self._executions += 1
            self._stored[call.number] = self._executions
        watchdog = max(1, self.profile.timeout - 1) * MS
        for notice in range(1, work // watchdog + 1):
            self._answer(begin + notice * watchdog, call, attempt, "notice", 0)
        self._server_free = begin + work
        self._answer(begin + work, call, attempt, "reply", self._stored[call.number])

    def _answer(self, time: int, call: _Call, attempt: int, kind: str, body: int) -> None:
        raw = self._reply(call, attempt, kind, body)
        record = Record(time, Direction.RESPONSE, raw, call.number, kind, attempt)
        self._carry(record, f"{kind} {body}", call, attempt)

    def _arrive(self, time: int, call: _Call, attempt: int, kind: str, body: int) -> None:
        raw = self._reply(call, attempt, kind, body)
        self._see(self.records, Record(time, Direction.RESPONSE, raw, call.number, kind, attempt))
        self._take(call, attempt, kind)

    def _reply(self, call: _Call, attempt: int, kind: str, body: int) -> bytes:
        reserved = call.reserved[attempt] if self.profile.echo else 0
        if kind == "notice":
            return encode_frame(call.serials[attempt], reserved, S_EXECUTING)
        return encode_frame(call.serials[attempt], reserved, 0, (Variant(VT.I4, body),))


class Capture:
    """What was captured of several clients, merged.

    Attributes:
        observations: numbered from 1.
        records: for each client what each of its observations is, by number.
        conversations: of the clients.
    """

    def __init__(self, sessions: list[tuple[Profile, list[Record]]]) -> None:
        self.observations: list[Observation] = []
        self.records: list[dict[int, Record]] = [{} for _ in sessions]
        self.conversations = [
            Conversation(
                Endpoint("10.0.0.2", 50001 + index),
                Endpoint("10.0.0.1", 5007),
                Transport.TCP if profile.is_tcp else Transport.UDP,
                SERVER_PORT,
            )
            for index, (profile, _) in enumerate(sessions)
        ]
        flows = [{way: Flow(conversation, way) for way in Direction} for conversation in self.conversations]
        merged = [
            (record.time, index, record) for index, (_, records) in enumerate(sessions) for record in records
        ]
        for number, (time, index, record) in enumerate(sorted(merged, key=lambda entry: entry[0]), 1):
            flow, frame = flows[index][record.direction], Frame(record.raw)
            self.observations.append(Observation(number, time, time, flow, frame, number))
            self.records[index][number] = record
