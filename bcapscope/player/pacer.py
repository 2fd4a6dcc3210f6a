"""Sending set points in time.

Who sets the pace depends on the slave mode (DENSO Wave 2009, How to use the Slave mode; table of slave modes
in ShoheiKobata/orin_bcap_python_samples):

* **Async, mode 1**: we do. Deadlines are absolute, one a period. The reply may take until shortly before the
  next deadline; then the call is given up and the next set point sent, since the newest one wins and a try
  again only wastes bandwidth. Nobody is woken by the reply: it is looked for shortly before the call would be
  given up or the next packet made, and the system tells when it came (`BlockingCaller.sleep_until_due`). One
  that comes late still counts as word of the controller, and one that refuses ends the play. When the newest
  set point that is known to be answered is older than `SILENCE_TIMEOUT`, the controller has a row of them
  before it, or is gone; then nothing more is sent until it is through.
* **Sync, mode 2**: the controller does, by answering when it has room. The next set point is due
`_PREPARATION`
  after the reply, so that it always goes out equally long after. While the reply does not come the call is
  tried again, each `RetryPolicy.timeout`; a reply to an earlier try is discarded. When all tries are used up
  nothing more is sent, and a reply to any of them will do: a controller with a full buffer is not in need
  yet. After
  `SILENCE_TIMEOUT` it counts as gone.
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

from bcapscope.errors import CallTimeout, ControllerError
from bcapscope.player.blocking_caller import BlockingCaller
from bcapscope.player.lateness import Lateness
from bcapscope.player.player_messages import PlayCounts, SetPointValues
from bcapscope.player.set_point_sequence import SetPointSequence
from bcapscope.protocol.codec.frame import Frame
from bcapscope.protocol.codec.variant import VT, Variant
from bcapscope.protocol.retry.requester import CallTimedOut, RequesterOutcome, RetryPolicy
from bcapscope.protocol.slave_mode.modes import ModeKind, SlaveMode
from bcapscope.protocol.tables.hresult import (
    E_SLAVE_OVERFLOW,
    S_BUF_FULL,
    describe_hresult,
    hresult_name,
    is_failure,
)

SILENCE_TIMEOUT = 100_000_000
"""ns without word of a controller after which it counts as behind, or gone: a dozen of its periods.

On TCP it is the time-out of a call, since TCP itself takes longer than this to send again what was lost.
"""

OVERFLOW_DELAY = 1_000_000
"""ns after which a set point that found the buffer full is sent again."""

MAX_REPEATS = 64
"""How often; eight periods, in which a controller that is alive takes several."""

MIN_PERIOD_SHARE = 0.98
"""Share of the period that a controller may ask for on average: clocks differ by far less than 2%."""

_START_DELAY = 5_000_000
_PREPARATION, _PREPARATION_MAX, _PREPARATION_SHARE = 300_000, 1_000_000, 0.4
"""ns kept free before a deadline for making the next packet, least and most, and the share of the period. The
first steps after a sleep take ten times as long as those that follow, with caches that others have filled."""

_IDLE_INTERVAL = 8_000_000
_MOTION_ERRORS = 0x8420
"""Upper half of the results that set points can cause by coming too late: the buffer ran empty, too fast."""
_GAPS_KEPT = 8
"""Set points back from a refused one, among which the cause is: more than any controller buffers."""
_ROBOT_EXECUTE = 64
_NAME = "Robot_Execute slvMove"
_BY_CLOCK = (ModeKind.ASYNC, ModeKind.MODE_1)


class HaltedError(Exception):
    """The robot is to be stopped at once."""


class SlvMoveCall(NamedTuple):
    """How slvMove is called.

    Attributes:
        robot: handle.
        real_type: VT_R8, or VT_R4 on RC7.
        mode: slave mode.
        retry_policy: time-out and tries.
        period: ns.
    """

    robot: int
    real_type: VT
    mode: SlaveMode
    retry_policy: RetryPolicy
    period: int

    def arguments(self, point: SetPointValues) -> tuple[Variant, ...]:
        """Return the arguments of Robot_Execute for one set point."""
        return Variant(VT.I4, self.robot), Variant(VT.BSTR, "slvMove"), Variant.array(self.real_type, point)


class _SetPointGap(NamedTuple):
    """What lay between two set points, ns: all of it, what we were late by, what the reply took."""

    length: int
    late: int
    reply: int


IdleCallback: TypeAlias = Callable[[int], None]
"""Called after each set point was sent, and now and then while a reply is awaited, with the time in ns: what
has to be done besides is done here, quickly. It raises HaltedError to end at once."""


class Pacer:
    """Sends the set points of a course.

    Attributes:
        lateness: from the deadline of each set point to when it was sent.
        cycle: from one set point to the next.
        started_at: when the first was sent, ns; None before.
        commanded: the last set point.
        last_reply: the last reply to one.
    """

    def __init__(
        self,
        caller: BlockingCaller,
        move: SlvMoveCall,
        sequence: SetPointSequence,
        on_idle: IdleCallback,
        capacity: int,
    ) -> None:
        """Make room for the lateness of `capacity` set points."""
        self.lateness = Lateness(capacity)
        self.cycle = Lateness(capacity)
        self.started_at: int | None = None
        self.commanded: SetPointValues = ()
        self.last_reply: Frame | None = None
        self._caller = caller
        self._move = move
        self._sequence = sequence
        self._on_idle = on_idle
        self._silence = SILENCE_TIMEOUT if caller.link.datagrams else move.retry_policy.timeout
        self._preparation = max(_PREPARATION, min(round(_PREPARATION_SHARE * move.period), _PREPARATION_MAX))
        self._throttle = _Throttle(round(MIN_PERIOD_SHARE * move.period), move.mode.buffer_slots + 1)
        self._last_sent_at = 0
        self._last_answered_at = 0  # when the newest of the set points was sent that are known to be answered
        self._had_to_wait = False
        self._sent = self._retries = self._late = self._answered = self._pending = 0
        self._repeated = self._shifted = self._held = 0
        self._recent_gaps: deque[_SetPointGap] = deque(maxlen=_GAPS_KEPT)
        self._overslept = self._reply_took = 0  # of the last call
        self._is_behind = False  # replies to earlier ones may come before the next one's

    @property
    def counts(self) -> PlayCounts:
        """What happened to the set points so far."""
        unanswered = max(0, self._sent - self._answered - self._pending)
        return PlayCounts(
            self._sent, self._retries, self._late, unanswered, self._repeated, self._shifted, self._held
        )

    def play(self) -> None:
        """Send them all.

        Raises:
            ControllerError: the controller refused one.
            CallTimeout: it does not answer any more.
            HaltedError: `on_idle` said so.
            OSError: the link is gone.
        """
        due = self._last_answered_at = self._caller.link.now() + _START_DELAY
        for point in self._sequence:
            self.commanded = point
            due = self._play_point(self._move.arguments(point), due)

    def _play_point(self, arguments: tuple[Variant, ...], due: int) -> int:
        """Send one set point until it is taken; return the deadline of the next."""
        for _ in range(MAX_REPEATS):
            sent = self._send_point(arguments, due)
            due = self._adjusted_deadline(due, sent)
            try:
                settled = self._await_reply(due)
            finally:
                self._pending = 0
            self._record_reply_time(settled, sent)
            code = self._result_code(settled)
            if code != E_SLAVE_OVERFLOW or not self._move.mode.overflow_is_error:
                break
            self._repeated += 1
            due = sent + OVERFLOW_DELAY
        if code is not None and is_failure(code):
            raise self._refusal_error(code)
        return self._next_deadline(due, code)

    def _record_reply_time(self, settled: RequesterOutcome, sent: int) -> None:
        """Note how long the reply took, what we ourselves were late by left out as far as that is known."""
        exchanger = self._caller
        self._overslept = exchanger.overslept
        self._reply_took = exchanger.link.now() - sent - self._overslept
        self._is_behind = isinstance(settled, CallTimedOut) or bool(exchanger.late_replies)
        if not isinstance(settled, CallTimedOut):
            self._reply_took = min(self._reply_took, exchanger.link.arrival_time - sent)

    def _send_point(self, arguments: tuple[Variant, ...], due: int) -> int:
        exchanger = self._caller
        exchanger.begin_call(_ROBOT_EXECUTE, arguments, self._move.retry_policy, due)
        self._wait_until(due)
        sent = exchanger.send_due()
        self.lateness.add(sent - due)
        if self.started_at is None:
            self.started_at = sent
        else:
            self.cycle.add(sent - self._last_sent_at)
            late = sent - due + self._overslept
            self._recent_gaps.append(_SetPointGap(sent - self._last_sent_at, late, self._reply_took))
        self._last_sent_at = sent
        self._sent += 1
        self._pending = 1
        self._throttle.count_sent(sent)
        self._on_idle(sent)
        return sent

    def _wait_until(self, due: int) -> None:
        """Wait for a deadline; where that is long, orders are looked for meanwhile."""
        link = self._caller.link
        while (now := link.now()) < due - 2 * _IDLE_INTERVAL:
            link.wait_until(now + _IDLE_INTERVAL)
            self._on_idle(link.now())
        link.wait_until(due)

    def _await_reply(self, due: int) -> RequesterOutcome:
        """Wait for the reply, as long as the mode lets us."""
        exchanger, link = self._caller, self._caller.link
        by_clock = self._move.mode.kind in _BY_CLOCK
        until = due + self._move.period - self._preparation
        if by_clock and not self._is_behind:
            self._sleep_until(until)
        while True:
            look = link.now() + _IDLE_INTERVAL
            settled = exchanger.wait_for_outcome(min(look, until) if by_clock else look)
            if settled is not None:
                return settled
            if by_clock and link.now() >= until:
                return exchanger.abandon()
            self._on_idle(link.now())

    def _sleep_until(self, until: int) -> None:
        """Sleep, whatever comes; where that is long, orders are looked for afterwards."""
        look = self._caller.link.now() + _IDLE_INTERVAL
        self._caller.sleep_until_due(min(look, until))
        if look < until:
            self._on_idle(self._caller.link.now())

    def _result_code(self, settled: RequesterOutcome) -> int | None:
        """Note how a call ended; return its result, None where there is none that we could wait for.

        Raises:
            CallTimeout: that is the end.
            ControllerError: a set point before this one was refused, as we hear only now.
        """
        self._retries += len(settled.attempts) - 1
        self._count_late_replies()
        reply: Frame | None = None
        if not isinstance(settled, CallTimedOut):
            self._answered += 1
            self._last_answered_at = settled.attempts[-1].sent
            reply = settled.reply
        elif (
            self._move.mode.kind not in _BY_CLOCK
            or settled.attempts[-1].sent - self._last_answered_at > SILENCE_TIMEOUT
        ):
            reply = self._await_late_reply(settled)
        if reply is None:
            return None
        self.last_reply = reply
        code: int = reply.code
        return code

    def _refusal_error(self, code: int) -> ControllerError:
        """Tell that a set point was refused; whose lateness it was where that may be the cause."""
        meaning = describe_hresult(code).text
        if code >> 16 == _MOTION_ERRORS and self._recent_gaps:
            length, late, reply = (each / 1e6 for each in max(self._recent_gaps))
            meaning += f"; {length:.1f} ms between two set points: this machine was late by {late:.1f} ms, "
            meaning += f"the reply took {reply:.1f} ms"
        return ControllerError(_NAME, code, hresult_name(code), meaning)

    def _await_late_reply(self, settled: CallTimedOut) -> Frame:
        """Wait on for the reply, and send nothing meanwhile."""
        exchanger, attempts = self._caller, settled.attempts
        serials, give_up = [each.serial for each in attempts], attempts[0].sent + self._silence
        while (
            found := exchanger.wait_for_late_reply(
                serials, min(give_up, exchanger.link.now() + _IDLE_INTERVAL)
            )
        ) is None:
            now = exchanger.link.now()
            if now >= give_up:
                raise CallTimeout(_NAME, attempts)
            self._on_idle(now)
        self._caller.late_replies.remove(found)
        self._count_late_replies()
        self._late += 1
        self._answered += 1
        self._last_answered_at = attempts[-1].sent
        self._had_to_wait = True
        return found.reply

    def _count_late_replies(self) -> None:
        late = self._caller.late_replies
        if not late:
            return
        by_clock = self._move.mode.kind in _BY_CLOCK
        for each in late:
            self._late += 1
            if by_clock:
                self._answered += 1
                self._last_answered_at = max(self._last_answered_at, each.sent)
                code = each.reply.code
                if is_failure(code):
                    raise self._refusal_error(code)
        late.clear()

    def _adjusted_deadline(self, due: int, sent: int) -> int:
        """Return the deadline from which the next one counts: put off if this one was missed by too much."""
        if sent - due <= self._move.period // 2:
            return due
        self._shifted += 1
        return sent

    def _next_deadline(self, due: int, code: int | None) -> int:
        """Return the deadline of the next set point."""
        if self._had_to_wait:
            self._had_to_wait = False
            return self._caller.link.now() + _PREPARATION
        if self._move.mode.kind in _BY_CLOCK or code == S_BUF_FULL:
            self._overslept = 0  # the deadline does not follow the reply: what is late by that, it tells
            return due + self._move.period
        ready, free = self._caller.link.now() + _PREPARATION, self._throttle.free_at
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
        self._next_at = 0

    @property
    def free_at(self) -> int:
        """When the next set point may be sent, ns."""
        return self._next_at - self._allowance

    def count_sent(self, now: int) -> None:
        """Count one."""
        self._next_at = max(self._next_at, now) + self._period
