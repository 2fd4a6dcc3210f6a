"""Sending set points in time.

Who sets the pace depends on the slave mode (DENSO Wave 2009, How to use the Slave mode; table of slave modes
in ShoheiKobata/orin_bcap_python_samples):

* **Async, mode 1**: we do. Deadlines are absolute, one a period. The reply may take until shortly before the
  next deadline; then the call is given up and the next set point sent, since the newest one wins and a try
  again only wastes bandwidth. Nobody is woken by the reply: it is looked for shortly before the call would be
  given up or the next packet made, and the system tells when it came (`BlockingExchanger.rest`). One that
  comes late still counts as word of the controller, and one that refuses ends the play. When the newest set
  point that is known to be answered is older than `SILENCE`, the controller has a row of them before it, or
  is gone; then nothing more is sent until it is through.
* **Sync, mode 2**: the controller does, by answering when it has room. The next set point is due `_PREPARING`
  after the reply, so that it always goes out equally long after. While the reply does not come the call is
  tried again, each `Pace.timeout`; a reply to an earlier try is discarded. When all tries are used up nothing
  more is sent, and a reply to any of them will do: a controller with a full buffer is not in need yet. After
  `SILENCE` it counts as gone.
* **mode 0**: both. S_BUF_FULL asks for a period's pause; S_OK says that there is room, so the next follows at
  once; 83201483 says that there was none, and the same set point is sent again.

Set points are never left out and never sent faster to catch up: who is late by more than half a period moves
the deadlines, so that the robot pauses instead of jumping. Nor does a controller that answers too soon make
it faster: see `_Throttle`.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from typing import NamedTuple, TypeAlias

from bcapscope.errors import ControllerError, ExchangeTimeout
from bcapscope.player.course import Course
from bcapscope.player.exchanger import BlockingExchanger
from bcapscope.player.lateness import Lateness
from bcapscope.player.messages import Counts, Point
from bcapscope.protocol.frame import Frame
from bcapscope.protocol.hresult import E_SLAVE_OVERFLOW, S_BUF_FULL, describe, hresult_name, is_failure
from bcapscope.protocol.requester import Pace, Settled, TimedOut
from bcapscope.protocol.slavemode import ModeKind, SlaveMode
from bcapscope.protocol.variant import VT, Variant

SILENCE = 100_000_000
"""ns without word of a controller after which it counts as behind, or gone: a dozen of its periods.

On TCP it is the time-out of a call, since TCP itself takes longer than this to send again what was lost.
"""

REPEAT_AFTER = 1_000_000
"""ns after which a set point that found the buffer full is sent again."""

MOST_REPEATS = 64
"""How often; eight periods, in which a controller that is alive takes several."""

FASTEST = 0.98
"""Share of the period that a controller may ask for on average: clocks differ by far less than 2%."""

_START = 5_000_000
_PREPARING, _PREPARING_MOST, _PREPARING_SHARE = 300_000, 1_000_000, 0.4
"""ns kept free before a deadline for making the next packet, least and most, and the share of the period. The
first steps after a sleep take ten times as long as those that follow, with caches that others have filled."""

_PATIENCE = 8_000_000
_MOTION_ERRORS = 0x8420
"""Upper half of the results that set points can cause by coming too late: the buffer ran empty, too fast."""
_STAYS = 8
"""Set points back from a refused one, among which the cause is: more than any controller buffers."""
_ROBOT_EXECUTE = 64
_NAME = "Robot_Execute slvMove"
_BY_CLOCK = (ModeKind.ASYNC, ModeKind.MODE_1)


class HaltedError(Exception):
    """The robot is to be stopped at once."""


class Move(NamedTuple):
    """How slvMove is called.

    Attributes:
        robot: handle.
        real: VT_R8, or VT_R4 on RC7.
        mode: slave mode.
        pace: time-out and tries.
        period: ns.
    """

    robot: int
    real: VT
    mode: SlaveMode
    pace: Pace
    period: int

    def arguments(self, point: Point) -> tuple[Variant, ...]:
        """Return the arguments of Robot_Execute for one set point."""
        return Variant(VT.I4, self.robot), Variant(VT.BSTR, "slvMove"), Variant.array(self.real, point)


class _Stay(NamedTuple):
    """What lay between two set points, ns: all of it, what we were late by, what the reply took."""

    length: int
    late: int
    reply: int


Idle: TypeAlias = Callable[[int], None]
"""Called after each set point was sent, and now and then while a reply is awaited, with the time in ns: what
has to be done besides is done here, quickly. It raises HaltedError to end at once."""


class Pacer:
    """Sends the set points of a course.

    Attributes:
        lateness: from the deadline of each set point to when it was sent.
        cycle: from one set point to the next.
        began: when the first was sent, ns; None before.
        commanded: the last set point.
        reply: the last reply to one.
    """

    def __init__(
        self, exchanger: BlockingExchanger, move: Move, course: Course, idle: Idle, capacity: int
    ) -> None:
        """Make room for the lateness of `capacity` set points."""
        self.lateness = Lateness(capacity)
        self.cycle = Lateness(capacity)
        self.began: int | None = None
        self.commanded: Point = ()
        self.reply: Frame | None = None
        self._exchanger = exchanger
        self._move = move
        self._course = course
        self._idle = idle
        self._silence = SILENCE if exchanger.link.datagrams else move.pace.timeout
        self._preparing = max(_PREPARING, min(round(_PREPARING_SHARE * move.period), _PREPARING_MOST))
        self._throttle = _Throttle(round(FASTEST * move.period), move.mode.slots + 1)
        self._last = 0
        self._word = 0  # when the newest of the set points was sent that are known to be answered
        self._waited = False
        self._sent = self._retries = self._late = self._answered = self._under_way = 0
        self._repeated = self._shifted = self._held = 0
        self._stays: deque[_Stay] = deque(maxlen=_STAYS)
        self._overslept = self._reply_took = 0  # of the last call
        self._is_behind = False  # replies to earlier ones may come before the next one's

    @property
    def counts(self) -> Counts:
        """What happened to the set points so far."""
        unanswered = max(0, self._sent - self._answered - self._under_way)
        return Counts(
            self._sent, self._retries, self._late, unanswered, self._repeated, self._shifted, self._held
        )

    def play(self) -> None:
        """Send them all.

        Raises:
            ControllerError: the controller refused one.
            ExchangeTimeout: it does not answer any more.
            HaltedError: `idle` said so.
            OSError: the link is gone.
        """
        due = self._word = self._exchanger.link.now() + _START
        for point in self._course:
            self.commanded = point
            due = self._one(self._move.arguments(point), due)

    def _one(self, arguments: tuple[Variant, ...], due: int) -> int:
        """Send one set point until it is taken; return the deadline of the next."""
        for _ in range(MOST_REPEATS):
            sent = self._send(arguments, due)
            due = self._kept(due, sent)
            try:
                settled = self._await(due)
            finally:
                self._under_way = 0
            self._note_reply(settled, sent)
            code = self._code(settled)
            if code != E_SLAVE_OVERFLOW or not self._move.mode.overflow_is_error:
                break
            self._repeated += 1
            due = sent + REPEAT_AFTER
        if code is not None and is_failure(code):
            raise self._refusal(code)
        return self._next(due, code)

    def _note_reply(self, settled: Settled, sent: int) -> None:
        """Note how long the reply took, what we ourselves were late by left out as far as that is known."""
        exchanger = self._exchanger
        self._overslept = exchanger.overslept
        self._reply_took = exchanger.link.now() - sent - self._overslept
        self._is_behind = isinstance(settled, TimedOut) or bool(exchanger.late)
        if not isinstance(settled, TimedOut):
            self._reply_took = min(self._reply_took, exchanger.link.arrived - sent)

    def _send(self, arguments: tuple[Variant, ...], due: int) -> int:
        exchanger = self._exchanger
        exchanger.begin(_ROBOT_EXECUTE, arguments, self._move.pace, due)
        self._wait(due)
        sent = exchanger.send()
        self.lateness.add(sent - due)
        if self.began is None:
            self.began = sent
        else:
            self.cycle.add(sent - self._last)
            late = sent - due + self._overslept
            self._stays.append(_Stay(sent - self._last, late, self._reply_took))
        self._last = sent
        self._sent += 1
        self._under_way = 1
        self._throttle.sent(sent)
        self._idle(sent)
        return sent

    def _wait(self, due: int) -> None:
        """Wait for a deadline; where that is long, orders are looked for meanwhile."""
        link = self._exchanger.link
        while (now := link.now()) < due - 2 * _PATIENCE:
            link.wait(now + _PATIENCE)
            self._idle(link.now())
        link.wait(due)

    def _await(self, due: int) -> Settled:
        """Wait for the reply, as long as the mode lets us."""
        exchanger, link = self._exchanger, self._exchanger.link
        by_clock = self._move.mode.kind in _BY_CLOCK
        until = due + self._move.period - self._preparing
        if by_clock and not self._is_behind:
            self._rest(until)
        while True:
            look = link.now() + _PATIENCE
            settled = exchanger.settle(min(look, until) if by_clock else look)
            if settled is not None:
                return settled
            if by_clock and link.now() >= until:
                return exchanger.abandon()
            self._idle(link.now())

    def _rest(self, until: int) -> None:
        """Sleep, whatever comes; where that is long, orders are looked for afterwards."""
        look = self._exchanger.link.now() + _PATIENCE
        self._exchanger.rest(min(look, until))
        if look < until:
            self._idle(self._exchanger.link.now())

    def _code(self, settled: Settled) -> int | None:
        """Note how a call ended; return its result, None where there is none that we could wait for.

        Raises:
            ExchangeTimeout: that is the end.
            ControllerError: a set point before this one was refused, as we hear only now.
        """
        self._retries += len(settled.attempts) - 1
        self._hear_late()
        reply: Frame | None = None
        if not isinstance(settled, TimedOut):
            self._answered += 1
            self._word = settled.attempts[-1].sent
            reply = settled.reply
        elif self._move.mode.kind not in _BY_CLOCK or settled.attempts[-1].sent - self._word > SILENCE:
            reply = self._overdue(settled)
        if reply is None:
            return None
        self.reply = reply
        code: int = reply.code
        return code

    def _refusal(self, code: int) -> ControllerError:
        """Tell that a set point was refused; whose lateness it was where that may be the cause."""
        meaning = describe(code).text
        if code >> 16 == _MOTION_ERRORS and self._stays:
            length, late, reply = (each / 1e6 for each in max(self._stays))
            meaning += f"; {length:.1f} ms between two set points: this machine was late by {late:.1f} ms, "
            meaning += f"the reply took {reply:.1f} ms"
        return ControllerError(_NAME, code, hresult_name(code), meaning)

    def _overdue(self, settled: TimedOut) -> Frame:
        """Wait on for the reply, and send nothing meanwhile."""
        exchanger, attempts = self._exchanger, settled.attempts
        serials, give_up = [each.serial for each in attempts], attempts[0].sent + self._silence
        while (found := exchanger.overdue(serials, min(give_up, exchanger.link.now() + _PATIENCE))) is None:
            now = exchanger.link.now()
            if now >= give_up:
                raise ExchangeTimeout(_NAME, attempts)
            self._idle(now)
        self._exchanger.late.remove(found)
        self._hear_late()
        self._late += 1
        self._answered += 1
        self._word = attempts[-1].sent
        self._waited = True
        return found.reply

    def _hear_late(self) -> None:
        late = self._exchanger.late
        if not late:
            return
        by_clock = self._move.mode.kind in _BY_CLOCK
        for each in late:
            self._late += 1
            if by_clock:
                self._answered += 1
                self._word = max(self._word, each.sent)
                code = each.reply.code
                if is_failure(code):
                    raise self._refusal(code)
        late.clear()

    def _kept(self, due: int, sent: int) -> int:
        """Return the deadline from which the next one counts: put off if this one was missed by too much."""
        if sent - due <= self._move.period // 2:
            return due
        self._shifted += 1
        return sent

    def _next(self, due: int, code: int | None) -> int:
        """Return the deadline of the next set point."""
        if self._waited:
            self._waited = False
            return self._exchanger.link.now() + _PREPARING
        if self._move.mode.kind in _BY_CLOCK or code == S_BUF_FULL:
            self._overslept = 0  # the deadline does not follow the reply: what is late by that, it tells
            return due + self._move.period
        ready, free = self._exchanger.link.now() + _PREPARING, self._throttle.free
        self._held += free > ready
        return max(ready, free)


class _Throttle:
    """Keeps a controller that should set the pace from setting any.

    As many set points as its buffer holds, and two more, may go out at once; from then on no more than one a
    period on average. A controller that takes a mode for another, and answers at once what it should hold
    back, would else be driven through a whole trajectory in no time.
    """

    def __init__(self, period: int, burst: int) -> None:
        self._period = period
        self._allowance = period * burst
        self._next = 0

    @property
    def free(self) -> int:
        """When the next set point may be sent, ns."""
        return self._next - self._allowance

    def sent(self, now: int) -> None:
        """Count one."""
        self._next = max(self._next, now) + self._period
