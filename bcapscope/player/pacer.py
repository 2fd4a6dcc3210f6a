"""Send each set point at its deadline.

The slave mode decides whether the player or the controller sets the pace (DENSO Wave 2009, How to use the
Slave mode; table of slave modes in ShoheiKobata/orin_bcap_python_samples):

* **Async, mode 1**: the player sets the pace. Deadlines are absolute, one per period. If the reply is still
  missing shortly before the next deadline, the pacer gives the call up and sends the next set point. The
  pacer never retries a set point, because the controller follows only the newest set point. A reply does not
  wake the player: the pacer reads replies only shortly before the next deadline. The operating system records
  when each reply arrived (`BlockingCaller.sleep_until_due`). If a late reply refuses a set point, the pacer
  raises ControllerError. If the newest answered set point is older than `SILENCE_TIMEOUT`, the pacer sends
  nothing until a reply arrives.
* **Sync, mode 2**: the controller sets the pace by answering only when its buffer has room. The next set
  point is due 0.3 ms (`_PREPARATION`) after the reply. If no reply arrives, the requester retries after each
  `RetryPolicy.timeout`, and discards replies to earlier attempts. After the last attempt, the pacer only
  waits, and accepts a reply to any attempt. A controller with a full buffer needs no set point yet. After
  `SILENCE_TIMEOUT` without a reply, the pacer treats the controller as gone.
* **Mode 0**: player and controller set the pace together. S_BUF_FULL makes the pacer pause for one period.
  S_OK means that the buffer has room, so the next set point follows at once. 83201483 means that the buffer
  had no room, so the pacer sends the same set point again.

The pacer never skips a set point and never sends faster to catch up. If a set point is late by more than half
a period, the pacer moves the deadlines, so that the robot pauses instead of jumping. `_Throttle` prevents a
controller that answers too soon from speeding up the pacer.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from typing import NamedTuple, TypeAlias

from bcapscope.errors import CallTimeout, ControllerError
from bcapscope.messages import Message
from bcapscope.player.blocking_caller import BlockingCaller
from bcapscope.player.lateness import Lateness
from bcapscope.player.player_messages import PlayCounts, SetPointValues
from bcapscope.player.set_point_sequence import SetPointSequence
from bcapscope.protocol.codec.frame import Frame
from bcapscope.protocol.codec.variant import VT, Variant
from bcapscope.protocol.retry.requester import CallTimedOut, RequesterOutcome, RetryPolicy
from bcapscope.protocol.slave_mode.modes import PERIOD_NS, ModeKind, SlaveMode
from bcapscope.protocol.tables.hresult import (
    E_SLAVE_OVERFLOW,
    S_BUF_FULL,
    describe_hresult,
    hresult_name,
    is_failure,
)

SILENCE_TIMEOUT = 100_000_000
"""If no reply arrives for this time in ns (about twelve periods), the pacer stops sending set points until a
reply arrives. Over UDP, the pacer also gives the controller up after `SILENCE_TIMEOUT`. Over TCP, the pacer
gives the controller up only after a call's timeout, because TCP may need more than 100 ms to retransmit.
"""

OVERFLOW_DELAY = 1_000_000
"""Delay in ns before the pacer repeats a set point that found the buffer full."""

MAX_REPEATS = 64
"""Maximum number of sendings of one set point: enough to wait eight periods for room in the buffer."""

MIN_PERIOD_SHARE = 0.98
"""Minimum average time between set points, as a share of the period; clocks differ by less than 2 %."""

_START_DELAY = 5_000_000
_PREPARATION, _PREPARATION_MAX, _PREPARATION_SHARE = 300_000, 1_000_000, 0.4
"""Preparation time: the pacer needs this time before a deadline to make the next packet. The preparation time
is a share of the period, with a minimum and a maximum in ns. After a sleep, code first runs ten times slower,
because other programs have filled the processor's caches.
"""

_MOTION_ERRORS = 0x8420
"""Upper 16 bits of codes that late set points can cause: the buffer ran empty, or an axis was too fast."""
_GAPS_KEPT = 8
"""The pacer remembers this number of intervals between set points. If the controller refuses a set point with
an error that late set points can cause, the error message shows the longest of these intervals. This number
suffices, because a controller's buffer holds at most 3 set points.
"""
_ROBOT_EXECUTE = 64
_NAME = "Robot_Execute slvMove"
_BY_CLOCK = (ModeKind.ASYNC, ModeKind.MODE_1)


class HaltedError(Exception):
    """Raised when the user orders the robot to halt."""


class SlvMoveCall(NamedTuple):
    """The robot handle, number type, mode, retry policy and period (ns) that all calls of slvMove share."""

    robot: int
    real_type: VT
    mode: SlaveMode
    retry_policy: RetryPolicy
    period: int

    def arguments(self, point: SetPointValues) -> tuple[Variant, ...]:
        return Variant(VT.I4, self.robot), Variant(VT.BSTR, "slvMove"), Variant.array(self.real_type, point)


class _SetPointGap(NamedTuple):
    """Time in ns between two set points, and how much a late player and a slow reply added to this time."""

    length: int
    late: int
    reply: int


IdleCallback: TypeAlias = Callable[[int], None]
"""Function that the pacer calls after each set point and during waits, with the time in ns. The function must
be quick, and may raise HaltedError.
"""


class Pacer:
    """Sends each set point of a sequence at its deadline.

    Attributes:
        lateness: Time from each set point's deadline to its sending.
        cycle: Time from each set point's sending to the sending of the next set point.
        started_at: Time in ns at which the first set point was sent; None until then.
    """

    def __init__(
        self,
        caller: BlockingCaller,
        move: SlvMoveCall,
        sequence: SetPointSequence,
        on_idle: IdleCallback,
        capacity: int,
    ) -> None:
        """Allocate room to record the lateness of `capacity` set points."""
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
        self._last_answered_at = 0  # sending time of the newest set point that was answered
        self._had_to_wait = False
        self._sent = self._retries = self._late = self._answered = self._pending = 0
        self._repeated = self._shifted = self._held = 0
        self._recent_gaps: deque[_SetPointGap] = deque(maxlen=_GAPS_KEPT)
        self._overslept = self._reply_took = 0  # of the last call
        self._is_behind = False  # True while replies to earlier set points may still arrive

    @property
    def counts(self) -> PlayCounts:
        unanswered = max(0, self._sent - self._answered - self._pending)
        return PlayCounts(
            self._sent, self._retries, self._late, unanswered, self._repeated, self._shifted, self._held
        )

    def play(self) -> None:
        """Send all set points.

        Raises ControllerError if the controller refuses a set point, CallTimeout if it no longer answers,
        OSError if the link fails, and the exceptions of `on_idle`.
        """
        due = self._last_answered_at = self._caller.link.now() + _START_DELAY
        for point in self._sequence:
            self.commanded = point
            due = self._play_point(self._move.arguments(point), due)

    def _play_point(self, arguments: tuple[Variant, ...], due: int) -> int:
        """Send a set point, repeatedly while the controller's buffer is full. Return the next deadline."""
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
        """Store the time from the set point to its reply, without the time that the player overslept."""
        caller = self._caller
        self._overslept = caller.overslept
        self._reply_took = caller.link.now() - sent - self._overslept
        self._is_behind = isinstance(settled, CallTimedOut) or bool(caller.late_replies)
        if not isinstance(settled, CallTimedOut):
            self._reply_took = min(self._reply_took, caller.link.arrival_time - sent)

    def _send_point(self, arguments: tuple[Variant, ...], due: int) -> int:
        caller = self._caller
        caller.begin_call(_ROBOT_EXECUTE, arguments, self._move.retry_policy, due)
        self._wait_until(due)
        sent = caller.send_due()
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
        link = self._caller.link
        while (now := link.now()) < due - 2 * PERIOD_NS:
            link.wait_until(now + PERIOD_NS)
            self._on_idle(link.now())
        link.wait_until(due)

    def _await_reply(self, due: int) -> RequesterOutcome:
        caller, link = self._caller, self._caller.link
        by_clock = self._move.mode.kind in _BY_CLOCK
        until = due + self._move.period - self._preparation
        if by_clock and not self._is_behind:
            self._sleep_until(until)
        while True:
            look = link.now() + PERIOD_NS
            settled = caller.wait_for_outcome(min(look, until) if by_clock else look)
            if settled is not None:
                return settled
            if by_clock and link.now() >= until:
                return caller.abandon()
            self._on_idle(link.now())

    def _sleep_until(self, until: int) -> None:
        """Sleep without reading replies; after a long sleep, call `on_idle`."""
        look = self._caller.link.now() + PERIOD_NS
        self._caller.sleep_until_due(min(look, until))
        if look < until:
            self._on_idle(self._caller.link.now())

    def _result_code(self, settled: RequesterOutcome) -> int | None:
        """Count the outcome of a call. Return the result code of the call, or None if no reply arrived in
        time. Raises CallTimeout if the controller no longer answers, and ControllerError if a late reply is a
        refusal.
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
        """If late set points may be the cause, the error names the longest gap."""
        meaning = describe_hresult(code).meaning
        if code >> 16 == _MOTION_ERRORS and self._recent_gaps:
            gap, late, reply = (f"{each / 1e6:.1f}" for each in max(self._recent_gaps))
            meaning = Message("play.refused-late", meaning=meaning, gap=gap, late=late, reply=reply)
        return ControllerError(_NAME, code, hresult_name(code), meaning)

    def _await_late_reply(self, settled: CallTimedOut) -> Frame:
        """Wait for a late reply without sending; raise CallTimeout if none arrives in time."""
        caller, attempts = self._caller, settled.attempts
        serials, give_up = [each.serial for each in attempts], attempts[0].sent + self._silence
        while (
            found := caller.wait_for_late_reply(serials, min(give_up, caller.link.now() + PERIOD_NS))
        ) is None:
            now = caller.link.now()
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
        """Return `sent` if the set point was sent more than half a period after `due`, else `due`."""
        if sent - due <= self._move.period // 2:
            return due
        self._shifted += 1
        return sent

    def _next_deadline(self, due: int, code: int | None) -> int:
        if self._had_to_wait:
            self._had_to_wait = False
            return self._caller.link.now() + _PREPARATION
        if self._move.mode.kind in _BY_CLOCK or code == S_BUF_FULL:
            # The next deadline ignores the time of the reply, so the next `sent - due` includes this
            # oversleep.
            self._overslept = 0
            return due + self._move.period
        ready, free = self._caller.link.now() + _PREPARATION, self._throttle.free_at
        self._held += free > ready
        return max(ready, free)


class _Throttle:
    """Limits the rate of set points if the controller sets the pace: first a burst, then about one set point
    per period.

    The burst has two more set points than the buffer has slots. If the controller sets the pace, it should
    reply only when its buffer has room. A controller that confuses two slave modes may reply at once. Without
    the throttle, the pacer would send the whole trajectory to such a controller in an instant.
    """

    def __init__(self, period: int, burst: int) -> None:
        self._period = period
        self._allowance = period * burst
        self._next_at = 0

    @property
    def free_at(self) -> int:
        """Earliest time in ns to send the next set point."""
        return self._next_at - self._allowance

    def count_sent(self, now: int) -> None:
        self._next_at = max(self._next_at, now) + self._period
