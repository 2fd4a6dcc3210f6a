"""The open calls of one conversation, and which of them a frame belongs to."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator

from bcapscope.protocol.budget import Budget
from bcapscope.protocol.frame import Frame
from bcapscope.protocol.functions import FUNCTIONS, ResultKind
from bcapscope.protocol.hresult import E_BUSY, S_EXECUTING, is_failure
from bcapscope.protocol.variant import VT
from bcapscope.traffic.convention import Habits, ReplyReserved
from bcapscope.traffic.exchange import Event, Exchange, FrameObservation, Role, Stray
from bcapscope.traffic.heard import Heard
from bcapscope.traffic.observation import Conversation, Transport
from bcapscope.traffic.question import question_of

SERVICE_START = 1

PATIENCE_NS = 2_000_000
"""A client that asks something new sooner than this was not waiting for the reply to what it asked before,
and may still take it. The shortest time-out that anyone recommends (DENSO Wave 2009, slvMove)."""

COPIES_WITHIN_NS = 100_000_000
"""What the network makes of a frame, copies and changes of order, comes within this time; factory networks
hold a frame for milliseconds. No client starts anew on the same port as fast as that, unless it says so with
Service_Start."""

RETRY_WITHIN_NS = 5_000_000_000
"""How long a client may still repeat a request that was answered here: longer than any time-out in use (3 s
in DENSO's ROS 2 driver, 1 s in DENSO Wave 2009)."""

LATE_WITHIN_NS = 1_000_000_000
"""How long a reply is waited for after the client has gone on, where the server answers what was asked later.
One that comes later is a stray that names its call."""

BUSY_WITHIN_NS = 30_000_000_000
"""The same where it has answered nothing since: servers answer in order, so it may be at that call still."""

EXECUTION_NS = 180_000_000_000
"""How long a call may stay silent with nothing after it: the server's InvokeTimeout, after which it never
answers (orin_bcap C/src/bCAPServer/bcap_server.c)."""

MOST_SHADOWED = 16
"""Unanswered requests of one serial on TCP that are remembered for their replies."""

MOST_HELD = 65536
"""Retries, notices and further replies of open calls that a conversation keeps, about 30 MB. The older C
client tries without end (start-jsk/denso b-Cap.c): every 20 ms, it is there in 20 minutes. The call that goes
beyond is let go with those before it, and what else comes of it begins another."""

_EVENT_COST = 512  # bytes that each of these costs beside its content
_HEAVY = 64 * 1024  # bytes; a settled call with more is not kept for the sake of the next one

MOST_PAST = 1024
"""Serials of settled calls: at least as many are known, at most twice."""

_OPENERS = frozenset(
    (SERVICE_START, *(f.id for f in FUNCTIONS.values() if f.result is ResultKind.HANDLE)),
)


class Lane:
    """One conversation; calls are given out in the order in which they started.

    Attributes:
        waiting: the calls that have not settled, in the order of their start.
        weight: bytes that they hold.
    """

    __slots__ = (
        "_answered",
        "_budget",
        "_by_serial",
        "_conversation",
        "_habits",
        "_handle",
        "_heard",
        "_held",
        "_is_tcp",
        "_let_go",
        "_mark",
        "_newest",
        "_overfull",
        "_overtaking",
        "_past",
        "_past_before",
        "_session",
        "_shadowed",
        "waiting",
        "weight",
    )

    def __init__(self, conversation: Conversation, let_go: int = 0, budget: Budget | None = None) -> None:
        """Begin.

        Args:
            conversation: between whom.
            budget: counts what the open calls of all conversations hold.
            let_go: the latest call of the traffic that may belong to this conversation and was evicted; 0 if
                there is none.
        """
        self.waiting: deque[Exchange] = deque()
        self.weight = 0
        self._budget = budget or Budget()
        self._conversation = conversation
        self._let_go = let_go
        self._is_tcp = conversation.transport is Transport.TCP
        self._habits = Habits()
        self._mark = -1  # reserved of the first packet seen last; on UDP only whether it was 0
        self._by_serial: dict[int, Exchange] = {}
        self._newest: Exchange | None = None
        self._heard: dict[Exchange, Heard] = {}  # of those open calls in which something was looked for
        self._held = 0  # frames that open calls have besides request and reply
        self._overfull = 0  # the latest call at which they became too many
        self._session = 0  # the call that started the service session
        self._answered = 0  # the latest call that was answered
        self._overtaking: deque[tuple[int, int]] = deque()  # calls answered while older ones wait, and when
        self._handle = 0  # the last handle of this service session that came back
        self._shadowed: dict[int, list[Exchange | int]] = {}
        self._past: dict[int, int] = {}
        self._past_before: dict[int, int] = {}

    def request(self, seen: FrameObservation, frame: Frame, call: int) -> bool:
        """Take in a request; tell whether it starts a new call, which then has the number `call`."""
        serial, reserved = frame.serial, frame.reserved
        prior = self._by_serial.get(serial)
        if prior is not None and self._belongs_to(prior, seen, frame):
            return False
        if reserved and reserved != serial and not self._is_tcp:
            origin = self._by_serial.get(reserved)
            if origin is not None and origin.request.item.raw[9:] == frame.raw[9:]:
                self._retry(origin, seen, frame)
                return False
            self._begin(seen, frame, call)
            # its first try was not seen; others of its tries will name it as well
            self._by_serial[reserved] = self._by_serial[serial]
            return True
        if not reserved and 0 in self._by_serial and self._goes_back_to_zero(seen, frame):
            return False
        if (reserved if self._is_tcp else reserved != 0) != self._mark:
            self._learn_first(serial, reserved)
        self._begin(seen, frame, call)
        return True

    def reply(self, seen: FrameObservation, frame: Frame) -> Stray | None:
        """Take in a reply or notice; return it where no open call wants it."""
        serial = frame.serial
        exchange = self._by_serial.get(serial)
        if self._shadowed and serial in self._shadowed:
            return self._reply_in_turn(seen, frame)
        if exchange is None:
            call = self._past.get(serial) or self._past_before.get(serial)
            return self._stray(seen, call)
        if (frame.reserved or self._mark) and self._habits.replies is ReplyReserved.UNKNOWN:
            self._learn_reply(exchange, frame)
        if (
            exchange.others
            or exchange.reply is not None
            or exchange.gone_on
            or frame.code == S_EXECUTING
            or exchange.last.item.serial != serial
        ):
            self._reply_in_trouble(exchange, seen, frame)
        else:
            self._accept(exchange, seen, frame)
        return None

    def settle(self, now: int) -> Iterator[Exchange]:
        """Give out the calls for which nothing more is to be expected at time `now`."""
        waiting = self.waiting
        if waiting and waiting[0].call <= self._overfull:
            yield from self.let_go(sum(exchange.call <= self._overfull for exchange in waiting))
        while waiting:
            exchange = waiting[0]
            if self._settles_at(exchange) > now:
                break
            exchange.silent = not exchange.gone_on
            yield self._finish(waiting.popleft())

    def let_go(self, count: int) -> Iterator[Exchange]:
        """Give out the `count` oldest calls, whatever may come."""
        for _ in range(min(count, len(self.waiting))):
            exchange = self.waiting.popleft()
            exchange.let_go = exchange.reply is None and not self._is_late(exchange)
            self._let_go = max(self._let_go, exchange.call)
            yield self._finish(exchange)

    def close(self) -> Iterator[Exchange]:
        """Give out all calls; the traffic has ended."""
        self._silence()
        while self.waiting:
            exchange = self.waiting.popleft()
            exchange.let_go = exchange.reply is None and exchange.call <= self._overfull
            yield self._finish(exchange)

    def _silence(self) -> None:
        """Tell of which open calls no reply was to be expected any more when the traffic ended.

        Servers answer in order. On UDP the network may change it, but does not take long to.
        """
        closing = self._conversation.closing
        over = closing is not None and closing.mutes
        end = max((exchange.activity for exchange in self.waiting), default=0)
        overtaken = end + 1 if self._is_tcp else end - COPIES_WITHIN_NS
        answered = overtaken  # when a later call was answered first, or too late to tell
        for exchange in reversed(self.waiting):
            exchange.silent = over or answered < overtaken
            if exchange.reply is not None and exchange.reply.item.code != E_BUSY:
                answered = min(answered, exchange.reply.time)

    # requests

    def _begin(self, seen: FrameObservation, frame: Frame, call: int) -> None:
        newest = self._newest
        if newest is not None and newest.reply is None and not newest.gone_on:
            since = max((newest.last.time, *(notice.time for notice in newest.notices)))
            if seen.time - since >= PATIENCE_NS:
                newest.gone_on = seen.time
        exchange = Exchange(call, self._conversation, question_of(frame), seen, self._habits)
        if frame.code == SERVICE_START:
            self._session = call
        if self._is_tcp:
            self._shadow(frame.serial)
        self._by_serial[frame.serial] = self._newest = exchange
        self.waiting.append(exchange)
        self._charge(exchange, len(frame.raw))

    def _belongs_to(self, prior: Exchange, seen: FrameObservation, frame: Frame) -> bool:
        """Take in a request that `prior` has already, or the first try of it that its retries overtook."""
        if self._is_tcp:
            return False
        starts_anew = prior.call < self._session or (
            frame.code == SERVICE_START and prior is not self._newest
        )
        sent = None if starts_anew else self._heard_of(prior).sent.get(frame.raw)
        if sent is not None and seen.time - sent <= COPIES_WITHIN_NS:
            self._add(prior, Role.DUPLICATE, seen)
            return True
        first = prior.request.item
        if (
            prior.origin_seen
            or first.reserved != frame.serial
            or frame.reserved not in (0, frame.serial)
            or first.raw[9:] != frame.raw[9:]
        ):
            return False
        self._learn_first(frame.serial, frame.reserved)
        prior.others = [Event(Role.RETRY, prior.request), *prior.others]
        prior.request = seen
        self._held += 1
        self._charge(prior, len(frame.raw) + _EVENT_COST)
        self._heard_of(prior).add(Role.REQUEST, seen)
        return True

    def _goes_back_to_zero(self, seen: FrameObservation, frame: Frame) -> bool:
        """Take in a retry of serial 0, whose reserved looks like that of a first packet.

        Old clients may pass through serial 0 (start-jsk/denso b-Cap.c); a retry is known by being the same
        request as the one that is still unanswered.
        """
        exchange = self._by_serial[0]
        if (
            exchange is not self._newest
            or exchange.reply is not None
            or exchange.request.item.raw[9:] != frame.raw[9:]
        ):
            return False
        self._retry(exchange, seen, frame)
        return True

    def _retry(self, exchange: Exchange, seen: FrameObservation, frame: Frame) -> None:
        first, last = exchange.request.item, exchange.last.item
        origin = first.serial if exchange.origin_seen else first.reserved
        self._habits = self._habits.after_retry(origin, last.serial, frame.reserved, self._mark == 0)
        self._by_serial[frame.serial] = exchange
        overtaken = (frame.serial - last.serial) & 0xFFFF >= 0x8000
        if exchange.reply is not None and exchange is self._newest and not overtaken:
            self._note(exchange, Role.LOST, exchange.reply)
            exchange.reply = None
        if not overtaken:
            exchange.last = seen
        self._add(exchange, Role.RETRY, seen)

    def _shadow(self, serial: int) -> None:
        """Note that replies to the request that had this serial come first: TCP keeps the order.

        The Python client uses its serial again after a time-out (orin_bcap Python bcapclient.py).
        """
        prior = self._by_serial.get(serial)
        if prior is None or prior.reply is not None or prior.late_replies:
            return
        queue = self._shadowed.setdefault(serial, [])
        queue.append(prior)
        del queue[:-MOST_SHADOWED]
        if len(self._shadowed) > MOST_SHADOWED:
            del self._shadowed[next(iter(self._shadowed))]

    def _learn_first(self, serial: int, reserved: int) -> None:
        if not self._is_tcp:
            if serial:  # 0 may be its own serial
                self._habits = self._habits.after_first(reserved)
                self._mark = int(reserved != 0)
            return
        self._habits = self._habits.after_first_on_tcp(serial, reserved)
        if not reserved == serial == 1:
            self._mark = reserved

    def _add(self, exchange: Exchange, role: Role, seen: FrameObservation) -> None:
        self._note(exchange, role, seen)
        exchange.activity = seen.time
        if self._held > MOST_HELD:
            self._overfull = self._let_go = max(self._overfull, self._let_go, exchange.call)
            self._forget_serials(exchange)

    def _note(self, exchange: Exchange, role: Role, seen: FrameObservation) -> None:
        exchange.add(role, seen)
        self._held += 1
        self._charge(exchange, len(seen.item.raw) + _EVENT_COST)
        if exchange in self._heard:
            self._heard[exchange].add(role, seen)

    def _charge(self, exchange: Exchange, weight: int) -> None:
        exchange.weight += weight
        self.weight += weight
        self._budget.held += weight

    def _heard_of(self, exchange: Exchange) -> Heard:
        heard = self._heard.get(exchange)
        if heard is None:
            heard = self._heard[exchange] = Heard(exchange)
        return heard

    # replies

    def _learn_reply(self, exchange: Exchange, frame: Frame) -> None:
        asked = self._heard_of(exchange).reserved.get(frame.serial)
        if asked is not None:
            self._habits = self._habits.after_reply(asked, frame.reserved)

    def _accept(self, exchange: Exchange, seen: FrameObservation, frame: Frame) -> None:
        exchange.reply = seen
        exchange.activity = seen.time
        self._charge(exchange, len(frame.raw))
        if self._heard and exchange in self._heard:
            self._heard[exchange].add(Role.REPLY, seen)
        if exchange.call > self._answered and frame.code != E_BUSY:
            self._answered = exchange.call
            if self.waiting[0] is not exchange:
                self._overtaking.append((exchange.call, seen.time))

    def _reply_in_trouble(self, exchange: Exchange, seen: FrameObservation, frame: Frame) -> None:
        if frame.code == S_EXECUTING:
            self._add(exchange, Role.NOTICE, seen)
        elif frame.raw in self._heard_of(exchange).replies:
            self._add(exchange, Role.DUPLICATE, seen)
        elif exchange.reply is None and not exchange.gone_on and frame.serial == exchange.last.item.serial:
            self._accept(exchange, seen, frame)
        else:
            self._add(exchange, Role.LATE, seen)

    def _reply_in_turn(self, seen: FrameObservation, frame: Frame) -> Stray | None:
        """Give a reply to the oldest of several requests with its serial."""
        queue = self._shadowed[frame.serial]
        oldest = queue[0]
        if frame.code != S_EXECUTING:
            del queue[0]
            if not queue:
                del self._shadowed[frame.serial]
        if isinstance(oldest, int):
            return self._stray(seen, oldest)
        self._reply_in_trouble(oldest, seen, frame)
        return None

    def _stray(self, seen: FrameObservation, call: int | None) -> Stray:
        return Stray(seen, call, overlooked=(1 if call is None else call) <= self._let_go)

    # settling

    def _settles_at(self, exchange: Exchange) -> int:
        quiet = exchange.activity
        if exchange.reply is not None:
            if self._is_tcp:
                return quiet
            return quiet + (RETRY_WITHIN_NS if exchange is self._newest else COPIES_WITHIN_NS)
        if exchange.gone_on:
            since = max(quiet, exchange.gone_on)
            if exchange.call >= self._answered:
                return since + BUSY_WITHIN_NS
            return max(since + LATE_WITHIN_NS, self._overtaking[0][1] + COPIES_WITHIN_NS)
        return quiet + (LATE_WITHIN_NS if exchange.call < self._answered else EXECUTION_NS)

    def _is_late(self, exchange: Exchange) -> bool:
        """Tell whether a reply would come late now, by the newest call."""
        newest = self._newest
        return newest is not None and 0 < exchange.gone_on <= newest.request.time - LATE_WITHIN_NS

    def _finish(self, exchange: Exchange) -> Exchange:
        overtaking = self._overtaking
        while overtaking and overtaking[0][0] <= exchange.call:
            overtaking.popleft()
        exchange.habits = self._habits
        self.weight -= exchange.weight
        self._budget.held -= exchange.weight
        if exchange.weight > _HEAVY and exchange is self._newest:
            self._newest = None
        if exchange.question.function_id in _OPENERS:
            self._follow_handles(exchange)
        if self._heard:
            self._heard.pop(exchange, None)
        frame = exchange.request.item
        serial = frame.serial
        if exchange.others or (frame.reserved and frame.reserved != serial):
            self._held -= len(exchange.others)
            self._forget_serials(exchange)
        else:
            self._forget(serial, exchange)
        return exchange

    def _forget_serials(self, exchange: Exchange) -> None:
        reserved = exchange.request.item.reserved
        for serial in {*exchange.serials, *((reserved,) if reserved else ())}:
            self._forget(serial, exchange)

    def _forget(self, serial: int, exchange: Exchange) -> None:
        if self._by_serial.get(serial) is exchange:
            del self._by_serial[serial]
        past = self._past
        past[serial] = exchange.call
        if len(past) >= MOST_PAST:
            self._past_before, self._past = past, {}
        if serial in self._shadowed:
            queue = self._shadowed[serial]
            queue[:] = [exchange.call if waiting is exchange else waiting for waiting in queue]

    def _follow_handles(self, exchange: Exchange) -> None:
        """Note handles that a server gave away unseen while it executed the tries of one call."""
        reply = exchange.reply
        if exchange.question.function_id == SERVICE_START:
            self._handle = 0
        if reply is None or is_failure(reply.item.code) or not reply.item.arguments:
            return
        vt, handle, _ = reply.item.arguments[0].variant
        if vt != VT.I4 or not isinstance(handle, int):
            return
        skipped = handle - self._handle - 1
        if self._handle and 0 < skipped < len(exchange.requests):
            exchange.skipped_handles = skipped
        self._handle = handle
