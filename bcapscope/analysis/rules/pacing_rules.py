"""Rules about set points that come too late, too fast, or out of step with the controller's 8 ms."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator
from itertools import pairwise

from bcapscope.analysis.client_state import ClientRegistry, ClientState, folded_command
from bcapscope.analysis.finding import Severity
from bcapscope.analysis.rules.refusal import Refusal, RefusalReason, make_refusal
from bcapscope.analysis.rules.rule_checker import (
    MS,
    CallHealth,
    DiagnosisRule,
    Occurrence,
    OccurrenceSink,
    RuleChecker,
)
from bcapscope.analysis.slave.buffer_model import DEFAULT_SLOTS, PredictedUnderflow, slack_ms
from bcapscope.analysis.slave.slave_session import SlaveSession
from bcapscope.analysis.speech import Speech, amount, called, name_of, span
from bcapscope.protocol.tables.hresult import E_SLAVE_OVERFLOW, E_SLAVE_UNDERFLOW, S_BUF_FULL
from bcapscope.protocol.text_format import counted
from bcapscope.traffic.call import Call
from bcapscope.traffic.call_kind import CallKind

_SEED = "DENSO Wave 2009, How to use the Slave mode"
_SAMPLES = "documentation of ShoheiKobata/orin_bcap_python_samples (table of slave modes)"

SET_POINT_GAP = DiagnosisRule(
    "set-point-gap",
    Severity.WARNING,
    f"{_SAMPLES}; DENSORobot/denso_robot_ros issues 20 and 49",
    ("late-reply", "client-gave-up", "no-reply", "retried", "reply-lost", "slow-retry"),
)
UNDERFLOW = DiagnosisRule(
    "underflow",
    Severity.ERROR,
    f"{_SAMPLES}; DENSORobot/denso_robot_ros issues 20 and 49; orin_bcap issue 3",
    (
        "set-point-gap",
        "late-reply",
        "client-gave-up",
        "no-reply",
        "retried",
        "reply-lost",
        "slow-retry",
        "off-grid",
    ),
)
OVERFLOW = DiagnosisRule(
    "overflow",
    Severity.ERROR,
    "ShoheiKobata/orin_bcap_python_samples 05_00_slvMove.py; DENSORobot/denso_robot_ros2 denso_robot_core",
    ("off-grid",),
)
OFF_GRID = DiagnosisRule(
    "off-grid",
    Severity.WARNING,
    "DENSORobot/denso_robot_ros2 issue 17; d-yui-hub/denso_robot_ros2_neo; " + _SEED,
)
REPLIES_DO_NOT_PACE = DiagnosisRule(
    "replies-do-not-pace",
    Severity.NOTE,
    f"{_SAMPLES}; {_SEED}",
)

_EMPTY_CODES = (E_SLAVE_UNDERFLOW, 0x84400503, 0x83201684)
_FEWEST_CYCLES = 50
_TOLERANCE = 0.1
_MAX_SKIPPED_SHARE = 0.05
_RECENT = 8
_MAX_REPORTED = 64


class PacingChecker(RuleChecker):
    """Checks the timing of set points."""

    rules = (SET_POINT_GAP, UNDERFLOW, OVERFLOW, OFF_GRID, REPLIES_DO_NOT_PACE)

    def __init__(self, report_occurrence: OccurrenceSink, clients: ClientRegistry) -> None:
        super().__init__(report_occurrence, clients)
        self._reported_gaps: deque[int] = deque(maxlen=_MAX_REPORTED)

    def wants_call(self, call_kind: CallKind, health: CallHealth) -> bool:
        return health is CallHealth.REFUSED

    def on_call(self, call: Call, client: ClientState) -> None:
        """Look for the pause that explains an empty buffer.

        `session_occurrences` comes later and knows less about it.
        """
        pair = _longest_pause(call, client) if call.hresult in _EMPTY_CODES else None
        if pair is None:
            return
        before, after = pair
        slack, pause = _buffer_slack_ns(client), after.request.time - before.request.time
        self._reported_gaps.append(after.request.number)
        self.report_call(
            SET_POINT_GAP,
            after,
            lambda speech: _pause_text(before, after, slack, speech),
            lambda speech, since: f"no set point was sent for {span(pause)}",
            evidence_call=before,
            explaining_calls=(before.number,),
            began=before.request.time,
            completed=after.request.time,
        )

    def session_occurrences(self, session: SlaveSession) -> Iterator[Occurrence]:
        if not session.buffer.overwrites:
            yield from self._underflows(session)
        yield from _off_grid_occurrences(session)

    def _underflows(self, session: SlaveSession) -> Iterator[Occurrence]:
        listed = [underflow for underflow in session.buffer.underflow_list if underflow.moving is not False]
        more = max(session.buffer.underflows_in_motion - len(listed), 0)
        unreported = [underflow for underflow in listed if underflow.late_frame not in self._reported_gaps]
        for underflow in unreported[:-1]:
            yield _predicted_gap(session, underflow, 1)
        for underflow in unreported[-1:]:
            yield _predicted_gap(session, underflow, 1 + more)


def _predicted_gap(session: SlaveSession, underflow: PredictedUnderflow, count: int) -> Occurrence:
    wait = round((underflow.late_ms + session.timing.slack_ms) * MS)

    def say(speech: Speech) -> str:
        return (
            f"the set point of frame {underflow.late_frame} came {span(round(underflow.late_ms * MS))} "
            f"after the buffer of {counted(session.buffer.slots, 'point')} must have been empty, "
            "while the robot moved (by a model of the buffer)"
        )

    def then(speech: Speech, after: int) -> str:
        return f"no set point came for {span(wait)}"

    frames = (underflow.last_frame, underflow.late_frame)
    began = underflow.time - round(session.timing.slack_ms * MS)
    return Occurrence(
        SET_POINT_GAP, began, underflow.time, session.conversation, frames, say, then, count=count
    )


def _off_grid_occurrences(session: SlaveSession) -> Iterator[Occurrence]:
    cycle = session.timing.cycle
    if cycle is None or cycle.count < _FEWEST_CYCLES:
        return
    grid = session.timing.grid_ms
    off = cycle.mean / grid - 1
    if session.buffer.replies_pace and off < -_TOLERANCE:
        yield _off_grid(REPLIES_DO_NOT_PACE, session, cycle.mean, "")
    elif abs(off) > _TOLERANCE:
        yield _off_grid(OFF_GRID, session, cycle.mean, "")
    elif session.timing.skipped > cycle.count * _MAX_SKIPPED_SHARE:
        share = f", and {session.timing.skipped} of {cycle.count} cycles took one and a half periods or more"
        yield _off_grid(OFF_GRID, session, cycle.mean, share)


def _off_grid(rule: DiagnosisRule, session: SlaveSession, mean: float, more: str) -> Occurrence:
    first, last = session.first_set_point, session.last_set_point
    assert first is not None
    assert last is not None
    rate, grid = 1000 / mean if mean else 0, session.timing.grid_ms

    def say(speech: Speech) -> str:
        who, points = speech.client(session.conversation), counted(session.counts.sent, "set point")
        return (
            f"{who} sent {points} every {amount(mean)} ms on average ({amount(rate)} a second), where "
            f"{grid:g} ms is the period{more}"
        )

    def then(speech: Speech, after: int) -> str:
        return f"set points came every {amount(mean)} ms"

    frames = (first.frame, last.frame)
    return Occurrence(rule, first.time, last.time, session.conversation, frames, say, then)


def _buffer_slack_ns(client: ClientState) -> int:
    """Return how long the controller's buffer lasts, in ns; for an unknown mode, assume `DEFAULT_SLOTS`."""
    mode = client.slave_mode if client.mode_entered_by else None
    return round(slack_ms(DEFAULT_SLOTS if mode is None else mode.buffer_slots) * MS)


def _longest_pause(call: Call, client: ClientState) -> tuple[Call, Call] | None:
    """Return the set points on both sides of the longest recent pause; None if the buffer bridges it."""
    points = (
        [*client.recent_set_points, call]
        if folded_command(call.kind) == "slvmove"
        else list(client.recent_set_points)
    )
    pairs = [*pairwise(points[-_RECENT:])]
    pair = max(pairs, key=lambda pair: pair[1].request.time - pair[0].request.time) if pairs else None
    if pair is None or pair[1].request.time - pair[0].request.time <= _buffer_slack_ns(client):
        return None
    return pair


def _pause_text(before: Call, after: Call, slack: int, speech: Speech) -> str:
    pause = span(after.request.time - before.request.time)
    when, who = speech.at(before.request.time), speech.client(before.conversation)
    text = (
        f"after {called(before)} at {when} {who} sent no set point for {pause}, and the buffer lasts "
        f"{span(slack)}"
    )
    reply = before.reply
    if reply is None:
        return f"{text}; {name_of(before)} was never answered"
    waited, idle = reply.time - before.request.time, after.request.time - reply.time
    if idle > waited:
        return f"{text}: its reply was there after {span(waited)}, and the next was sent {span(idle)} later"
    return f"{text}: the reply took {span(waited)}"


def _explain_underflow(call: Call, client: ClientState, clients: ClientRegistry) -> RefusalReason | None:
    pair = _longest_pause(call, client)
    code, slack = call.hresult or 0, _buffer_slack_ns(client)

    def say(speech: Speech) -> str:
        when = speech.at(call.reply.time if call.reply is not None else call.request.time)
        text = (
            f"at {when} the controller said, in the reply to {called(call)}, that it had run out of set "
            f"points (0x{code:08X}), and left slave mode"
        )
        if pair is None:
            return f"{text}; the set points before that were never more than {span(slack)} apart"
        pause = span(pair[1].request.time - pair[0].request.time)
        return (
            f"{text}: none was sent for {pause} after {called(pair[0])}, and its buffer lasts {span(slack)}"
        )

    def then(speech: Speech, after: int) -> str:
        return f"the controller said{_later(after)} that it had run out of set points, and left slave mode"

    because = () if pair is None else (pair[1].number, pair[0].number)
    return RefusalReason(
        say=say, then=then, explaining_calls=because, evidence_call=None if pair is None else pair[0]
    )


def _later(nanoseconds: int) -> str:
    return f" {span(nanoseconds)} later" if nanoseconds > 0 else ""


def _explain_overflow(call: Call, client: ClientState, clients: ClientRegistry) -> RefusalReason | None:
    points = list(client.recent_set_points)[-_RECENT:]
    if len(points) < 2:
        return None
    each = (call.request.time - points[0].request.time) / len(points)
    full = [point for point in points if point.hresult == S_BUF_FULL]

    def text(speech: Speech) -> str:
        said = f"the {counted(len(points), 'set point')} before came every {span(round(each))}"
        if full:
            last = full[-1]
            said += f", and the reply to {name_of(last)} {last.last_attempt.item.serial} had said that"
            said += " the buffer was full"
        return said

    return RefusalReason(
        text, then=lambda speech, after: f"the controller's buffer overflowed{_later(after)}"
    )


REFUSALS: tuple[Refusal, ...] = (
    make_refusal(UNDERFLOW, _EMPTY_CODES, _explain_underflow),
    make_refusal(OVERFLOW, (E_SLAVE_OVERFLOW, 0x84400502), _explain_overflow),
    make_refusal(OVERFLOW, (E_SLAVE_OVERFLOW, 0x84400502)),
)
