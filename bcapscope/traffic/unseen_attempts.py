"""Attempts that were not captured, inferred from the serials around them.

On UDP, every known client increments the serial by one per attempt. A skipped serial therefore belongs to an
attempt that was not captured. The network lost the skipped attempt before the capture point, or the capture
missed it.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

from bcapscope.protocol.codec.frame import Frame
from bcapscope.protocol.tables.hresult import S_EXECUTING
from bcapscope.traffic.reserved_field import ReservedConvention

if TYPE_CHECKING:
    from bcapscope.traffic.call import Call, StrayReply

MAX_UNSEEN = 64
"""Maximum number of successive skipped serials that count as uncaptured attempts. If two successive requests
skip more serials, the client probably restarted, so the skipped serials do not count as attempts.
"""


MAX_RECENT = 1024
"""A serial counts as recent if it differs from the latest serial by at most this number. `serial_table`
remembers at least this number of serials of settled calls.
"""


def is_later(serial: int, than: int) -> bool:
    """Return whether a serial follows another serial by fewer than 32768 steps."""
    return 0 < (serial - than) & 0xFFFF < 0x8000


def skipped_serials(before: int, after: int) -> tuple[int, ...]:
    """Return the serials between `before` and `after`, oldest first.

    The result is empty if more than `MAX_UNSEEN` serials are skipped. Serial 0 is left out, because most
    clients skip serial 0.
    """
    gap = (after - before) & 0xFFFF
    if gap > MAX_UNSEEN + 1:
        return ()
    return tuple(serial for step in range(1, gap) if (serial := (before + step) & 0xFFFF))


class UnseenRequests:
    """Infers from stray replies to one client which requests of this client the capture lacks.

    A stray reply with an earlier serial than the client's latest captured request answers an uncaptured
    request. A stray reply with a later serial than all captured requests may answer an uncaptured retry of
    the newest call. The serial of the client's next request shows whether the client really sent the
    uncaptured retry. The reserved field of the client's next request may show which call a stray reply
    answers.

    Attributes:
        waiting: Whether an `UnseenRequests` holds stray replies until the client's next request.
    """

    def __init__(self) -> None:
        self._recent: list[StrayReply] = []
        self._noticed: set[int] = set()
        self._latest = 0  # serial of the newest call's last captured attempt; set by `pop_before`
        self._newest: Call | None = None  # the client's newest call when the latest stray reply came
        self.waiting = False

    def add_stray_reply(self, stray: StrayReply, newest: Call | None) -> None:
        """Set `request_missed` of a stray reply. Ignore a stray reply to a known complete call."""
        if stray.call_number is not None:
            return
        serial = stray.observation.item.serial
        if newest is not None:
            latest = newest.last_attempt.item.serial
            stray.request_missed = 0 < (latest - serial) & 0xFFFF <= MAX_RECENT
            if not 0 < (serial - latest) & 0xFFFF <= MAX_UNSEEN:
                return
            stray.request_missed = self.waiting = True
            if self._may_answer(newest, stray):
                newest.may_go_on = newest.was_overtaken = True
        self._newest, self.waiting = newest, True
        if stray.observation.item.code == S_EXECUTING:
            # A controller may send thousands of notices for one attempt. The first notice already shows that
            # the controller received this attempt.
            if serial in self._noticed:
                return
            self._noticed.add(serial)
        self._recent.append(stray)
        del self._recent[: -2 * MAX_UNSEEN]

    def pop_before(self, serial: int) -> list[StrayReply]:
        """Return the held stray replies whose serials are earlier than `serial`, the serial of the client's
        next request.

        A reply whose serial equals `serial` or is later than `serial` does not belong to a skipped request.
        `pop_before` drops such a reply and sets its `request_missed` to False. For a copy of the client's
        latest request, `pop_before` returns an empty list and drops no reply.
        """
        newest, strays = self._newest, self._recent
        latest = serial - MAX_UNSEEN if newest is None else newest.last_attempt.item.serial
        self._latest = latest
        if newest is not None:
            if serial == latest:
                return []
            if newest.sure_until is None:
                newest.may_go_on = newest.was_overtaken = False
        self._recent, self.waiting = [], False
        found = []
        for stray in strays:
            if (serial - latest) & 0xFFFF <= (stray.observation.item.serial - latest) & 0xFFFF:
                stray.request_missed = False
            else:
                found.append(stray)
        if not found:
            self._noticed.clear()
        return found

    def assign(self, strays: Sequence[StrayReply], call: Call, named: int) -> None:
        """Add to `call` each stray reply that answers an uncaptured attempt of `call`.

        `named` is the serial in the reserved field of the first request that the client sent after the stray
        replies. If `call` is the client's newest call and has an uncaptured retry with this serial, `assign`
        adds only the replies to this retry. If one of the other replies may answer `_newest`, `assign` sets
        `may_go_on` of `_newest`.
        """
        unseen, newest = call.all_unseen_serials, self._newest
        is_joined = call is newest and named in call.unseen_serials
        for stray in strays:
            serial = stray.observation.item.serial
            if serial in unseen and (serial == named or not is_joined):
                stray.request_missed = True
                call.stray_replies += (stray.observation,)
            elif newest is not None and self._may_answer(newest, stray):
                newest.may_go_on = newest.was_overtaken = True
                if is_joined and newest.sure_until is None:
                    newest.sure_until = self._latest
        self._noticed.clear()

    def _may_answer(self, call: Call, stray: StrayReply) -> bool:
        """Return whether a stray reply may answer an attempt of `call` after its last captured attempt.

        The controller sends S_EXECUTING only for one attempt of a call: the first attempt that the controller
        receives.
        """
        frame = stray.observation.item
        if frame.code == S_EXECUTING:
            return False
        latest = call.last_attempt.item.serial if self.waiting else self._latest
        steps: int = (frame.serial - latest) & 0xFFFF
        executed = sum((serial - latest) & 0xFFFF <= steps for serial in self._noticed)
        return executed == 0 or (executed == 1 and not call.was_received)


def find_retried_call(
    newest: Call | None, open_calls: Sequence[Call], frame: Frame, convention: ReservedConvention
) -> tuple[Call | None, Call | None]:
    """Return, as a pair of values, whether the retry `frame` belongs to `newest`, the client's newest call.

    If the retry probably belongs to `newest`, both values are `newest`. If the retry possibly belongs to
    `newest`, the first value is None and the second value is `newest`. Otherwise, both values are None.

    The reserved field of the retry `frame` holds the serial of an uncaptured attempt. This attempt is the
    call's first attempt, except with the convention `CHAIN`.
    """
    if newest is None or newest.request.item.raw[9:] != frame.raw[9:]:
        return None, None
    latest = newest.last_attempt.item.serial
    is_next = skipped_serials(latest, frame.serial)[-1:] == (frame.reserved,)
    if not is_next or convention in (ReservedConvention.SEED, ReservedConvention.OWN):
        return None, None
    if convention is not ReservedConvention.CHAIN or newest.reply is not None or newest.abandoned_at:
        return None, newest
    before = open_calls[-2] if len(open_calls) > 1 else None
    if newest.sure_until is None and (before is None or before.request.item.raw[9:] == frame.raw[9:]):
        newest.sure_until = latest
    return newest, newest


def settle_continuation(call: Call, convention: ReservedConvention, latest_answered: int) -> None:
    """Set `may_go_on` of an unanswered call if bcapscope may have counted retries of the call as newer calls.

    The controller sends S_EXECUTING only for one attempt of a call: the first attempt that the controller
    receives. If this call reached the controller, a newer call with S_EXECUTING is no retry of this call.
    """
    later, call.may_continue_in = call.may_continue_in, None
    if convention in (ReservedConvention.SEED, ReservedConvention.OWN):
        return  # the reserved field of each retry identifies its call, so a newer call is a separate call
    was_received = call.was_received
    while later is not None and not (was_received and later.was_executed):
        if later.reply is not None or later.may_go_on or not later.abandoned_at:
            call.may_go_on = True
            call.was_overtaken = latest_answered > call.number
            return
        was_received = was_received or later.was_received
        later = later.may_continue_in
