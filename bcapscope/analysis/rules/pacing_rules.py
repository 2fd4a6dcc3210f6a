"""Rules about set points that arrive too late, too fast, or out of step with the controller's 8 ms cycle."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator
from itertools import pairwise

from bcapscope.analysis.client_state import ClientState
from bcapscope.analysis.finding_places import call_name_place, call_place, client_place
from bcapscope.analysis.rules.rule_checker import (
    MS,
    NO_REASON,
    Occurrence,
    Refusal,
    RefusalReason,
    RuleChecker,
)
from bcapscope.analysis.slave.buffer_model import DEFAULT_SLOTS, PredictedUnderflow, slack_ms
from bcapscope.analysis.slave.motion_pace import MotionPace
from bcapscope.analysis.slave.slave_session import SlaveSession
from bcapscope.messages import Message
from bcapscope.messages.message import PlaceValue
from bcapscope.messages.places import CallPlace, Count, Duration, FramePlace, HexNumber, Moment, Quantity
from bcapscope.protocol.slave_mode.modes import PERIOD_MS
from bcapscope.protocol.tables.hresult import E_SLAVE_OVERFLOW, E_SLAVE_UNDERFLOW, S_BUF_FULL, with_rc7_forms
from bcapscope.traffic.call import Call

_EMPTY_CODES = with_rc7_forms((E_SLAVE_UNDERFLOW, 0x84400503, 0x83201684))
_FEWEST_CYCLES = 50
_TOLERANCE = 0.1
_MAX_SKIPPED_SHARE = 0.05
_RECENT = 8
_MAX_REPORTED = 64


class PacingChecker(RuleChecker):
    def set_up(self) -> None:
        self._reported_gaps: deque[int] = deque(maxlen=_MAX_REPORTED)

    def on_call(self, call: Call, client: ClientState) -> None:
        """Report the pause that explains an empty buffer. `session_occurrences` cannot report this pause,
        because a `SlaveSession` lacks details of the set points around the pause.
        """
        pair = _longest_pause(call, client) if call.hresult in _EMPTY_CODES else None
        if pair is None:
            return
        before, after = pair
        slack, pause = _buffer_slack_ns(client), after.request.time - before.request.time
        self._reported_gaps.append(after.request.number)
        self.report_call(
            "set-point-gap",
            after,
            _pause_message(before, after, slack),
            Message("clause.set-point-gap", pause=Duration(pause)),
            evidence_call=before,
            explaining_calls=(before.number,),
            began=before.request.time,
            completed=after.request.time,
        )

    def session_occurrences(self, session: SlaveSession) -> Iterator[Occurrence]:
        if not _may_overwrite(session):
            yield from self._underflows(session)
        yield from _pace_occurrences(session)

    def _underflows(self, session: SlaveSession) -> Iterator[Occurrence]:
        possible = [underflow for underflow in session.buffer.underflow_list if underflow.moving is not False]
        listed = [underflow for underflow in possible if underflow.moving]
        more = max(session.buffer.underflows_in_motion - len(possible), 0)
        unreported = [underflow for underflow in listed if underflow.late_frame not in self._reported_gaps]
        for underflow in unreported[:-1]:
            yield _predicted_gap(session, underflow, 1)
        for underflow in unreported[-1:]:
            yield _predicted_gap(session, underflow, 1 + more)


def _predicted_gap(session: SlaveSession, underflow: PredictedUnderflow, count: int) -> Occurrence:
    pause = round((underflow.late_ms + session.timing.slack_ms) * MS)
    fact = Message(
        "finding.set-point-gap.predicted",
        frame=FramePlace((underflow.late_frame,)),
        late=Duration(round(underflow.late_ms * MS)),
        slots=Count(session.buffer.slots, "set-point"),
    )
    clause = Message("clause.set-point-gap.predicted", pause=Duration(pause))
    ended, frames = underflow.time, (underflow.last_frame, underflow.late_frame)
    began = ended - round(session.timing.slack_ms * MS)
    return Occurrence("set-point-gap", began, ended, session.conversation, frames, fact, clause, count=count)


def _pace_occurrences(session: SlaveSession) -> Iterator[Occurrence]:
    pace = session.pace
    if pace is None or pace.cycles < _FEWEST_CYCLES:
        return
    grid_ms = session.timing.grid_ms
    keeps_grid = abs(pace.cycle_ms / grid_ms - 1) <= _TOLERANCE
    # Skipped cycles matter only if the client sends one set point per period of the controller. If a client
    # that sends faster skips a cycle, the controller still gets enough set points.
    skips = grid_ms == PERIOD_MS and keeps_grid and pace.skipped > pace.cycles * _MAX_SKIPPED_SHARE
    is_slow = pace.cycle_ms / PERIOD_MS - 1 > _TOLERANCE or skips
    if pace.long_cycle_ms / grid_ms - 1 < -_TOLERANCE:
        yield _off_pace("replies-do-not-pace" if session.buffer.replies_pace else "off-grid", session, pace)
    elif is_slow and _may_overwrite(session):
        case = ".skipped" if skips else ".unknown-mode" if session.mode.meaning is None else ""
        yield _off_pace("slow-set-points", session, pace, case)
    elif is_slow and pace.waits_for_reply:
        yield _off_pace("off-grid", session, pace, ".paced", Message("rule.off-grid.advice.paced"))
    elif is_slow:
        in_waiting_mode = Message("rule.off-grid.advice.waiting-mode")
        advice = in_waiting_mode if session.buffer.replies_pace else None
        yield _off_pace("off-grid", session, pace, ".skipped" if skips else "", advice)


def _may_overwrite(session: SlaveSession) -> bool:
    """Return whether a new set point may replace a set point in the buffer; True if the mode is unknown."""
    return session.mode.meaning is None or session.buffer.overwrites


def _off_pace(
    rule: str, session: SlaveSession, pace: MotionPace, case: str = "", advice: Message | None = None
) -> Occurrence:
    first, last = session.first_set_point, session.last_set_point
    assert first is not None
    assert last is not None
    interval = Quantity(pace.cycle_ms, "ms")
    skipped = {"skipped": pace.skipped, "cycles": pace.cycles} if case == ".skipped" else {}
    fact = Message(
        f"finding.{rule}{case}",
        client=client_place(session.conversation),
        points=Count(pace.cycles, "set-point"),
        mean=interval,
        rate=Quantity(1000 / pace.cycle_ms if pace.cycle_ms else 0),
        period=Quantity(PERIOD_MS if rule == "slow-set-points" else session.timing.grid_ms, "ms"),
        **skipped,
    )
    clause = Message(f"clause.{rule}", mean=interval)
    frames = (first.frame, last.frame)
    return Occurrence(rule, first.time, last.time, session.conversation, frames, fact, clause, advice=advice)


def _buffer_slack_ns(client: ClientState) -> int:
    """Return the time in ns for which a full buffer lasts without a new set point."""
    mode = client.slave_mode if client.mode_entered_by else None
    return round(slack_ms(DEFAULT_SLOTS if mode is None else mode.buffer_slots) * MS)


def _longest_pause(call: Call, client: ClientState) -> tuple[Call, Call] | None:
    """Return the two successive recent set points with the longest pause between them. Return None if a full
    buffer lasts as long as this pause or longer, or if there are fewer than two recent set points.
    """
    points = list(client.recent_set_points)
    if call.kind.folded_command == "slvmove":
        points.append(call)
    pairs = [*pairwise(points[-_RECENT:])]
    pair = max(pairs, key=lambda pair: pair[1].request.time - pair[0].request.time) if pairs else None
    if pair is None or pair[1].request.time - pair[0].request.time <= _buffer_slack_ns(client):
        return None
    return pair


def _pause_message(before: Call, after: Call, slack: int) -> Message:
    places: dict[str, PlaceValue] = {
        "call": call_place(before),
        "at": Moment(before.request.time),
        "client": client_place(before.conversation),
        "pause": Duration(after.request.time - before.request.time),
        "slack": Duration(slack),
    }
    reply = before.reply
    if reply is None:
        case = "late-reply" if before.late_replies else "unanswered"
        if before.reply_not_captured:
            case = "not-captured"
        return Message(f"finding.set-point-gap.{case}", **places)
    waited, idle = reply.time - before.request.time, after.request.time - reply.time
    places["waited"] = Duration(waited)
    if idle <= waited:
        return Message("finding.set-point-gap.slow-reply", **places)
    return Message("finding.set-point-gap.idle", **places, idle=Duration(idle))


def _explain_underflow(call: Call, client: ClientState) -> RefusalReason | None:
    pair = _longest_pause(call, client)
    places: dict[str, PlaceValue] = {
        "at": Moment(call.request.time if call.reply is None else call.reply.time),
        "call": call_place(call),
        "code": HexNumber(call.hresult or 0),
        "slack": Duration(_buffer_slack_ns(client)),
    }
    clause = Message("clause.underflow")
    if pair is None:
        return RefusalReason(fact=Message("finding.underflow.no-gap", **places), clause=clause)
    before, after = pair
    pause = Duration(after.request.time - before.request.time)
    return RefusalReason(
        fact=Message("finding.underflow.gap", **places, pause=pause, before=call_place(before)),
        clause=clause,
        explaining_calls=(after.number, before.number),
        evidence_call=before,
    )


def _explain_overflow(call: Call, client: ClientState) -> RefusalReason | None:
    points = list(client.recent_set_points)[-_RECENT:]
    if len(points) < 2:
        return NO_REASON
    interval = (call.request.time - points[0].request.time) / len(points)
    places: dict[str, PlaceValue] = {
        "points": Count(len(points), "set-point"),
        "interval": Duration(round(interval)),
    }
    reason = Message("reason.overflow", **places)
    full = [point for point in points if point.hresult == S_BUF_FULL]
    if full:
        last = full[-1]
        answered = CallPlace(call_name_place(last).name, last.last_attempt.item.serial, last.number)
        reason = Message("reason.overflow.full", **places, call=answered)
    return RefusalReason(reason, clause=Message("clause.overflow"))


REFUSALS: tuple[Refusal, ...] = (
    Refusal("underflow", _EMPTY_CODES, _explain_underflow),
    Refusal("overflow", (E_SLAVE_OVERFLOW, 0x84400502), _explain_overflow),
)
