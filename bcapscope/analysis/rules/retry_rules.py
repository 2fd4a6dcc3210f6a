"""Rules about improper retries, and about serials that the controller or the client can confuse."""

from __future__ import annotations

from collections.abc import Iterator

from bcapscope.analysis.client_state import ClientState
from bcapscope.analysis.finding_places import call_name_place, call_place, client_place
from bcapscope.analysis.rules.rule_checker import CallHealth, Occurrence, RuleChecker
from bcapscope.analysis.slave.slave_session import SlaveSession
from bcapscope.messages import Message
from bcapscope.messages.places import Count, Duration, Moment
from bcapscope.protocol.guard import request_effect
from bcapscope.protocol.slave_mode.modes import PERIOD_NS
from bcapscope.protocol.tables.call_effect import CallEffect
from bcapscope.protocol.tables.function_table import ID
from bcapscope.traffic.call import Call
from bcapscope.traffic.call_kind import CallKind
from bcapscope.traffic.observation import Conversation, Transport
from bcapscope.traffic.reserved_field import ReservedConvention
from bcapscope.traffic.unseen_attempts import skipped_serials

_FIRST_FUNCTIONS = (ID["Service_Start"], ID["Controller_Connect"])
"""Functions that begin a session. `RetryChecker` reports serial 0 only in a call that begins a session."""


class RetryChecker(RuleChecker):
    by_client: dict[Conversation, ReservedConvention]

    def wants_call(self, call_kind: CallKind, health: CallHealth) -> bool:
        return health is not CallHealth.SMOOTH or call_kind.folded_command != "slvmove"

    def on_call(self, call: Call, client: ClientState) -> None:
        if call.convention is not ReservedConvention.UNKNOWN:
            self._check_convention(call)
        if call.retries and call.kind.folded_command == "slvmove":
            self._check_retry_delay(call)
        tcp = call.conversation.transport is Transport.TCP
        if not client.call_count:
            if not tcp and call.request.item.serial == 0 and call.kind.function_id in _FIRST_FUNCTIONS:
                self._report_serial_zero(call)
        elif tcp:
            self._check_serial_reuse(client.last_call, call)
        elif not call.first_attempt_seen:
            self._check_reserved(client.last_call, call)
        elif call.kind.function_id == ID["Service_Start"]:
            self._check_stale_answer(client.last_call, call)
        elif client.last_call.reply is None:
            self._check_unmarked_retry(client, call)

    def session_occurrences(self, session: SlaveSession) -> Iterator[Occurrence]:
        if session.counts.retries_forbidden:
            yield _retry_in_async(session)

    def _check_convention(self, call: Call) -> None:
        before = self.by_client.get(call.conversation)
        if before is call.convention:
            return
        self.by_client[call.conversation] = now = call.convention
        if before is not None:
            fact = Message(
                "finding.mixed-conventions",
                client=client_place(call.conversation),
                before=before.value,
                now=now.value,
                call=call_place(call),
            )
            self.report_call("mixed-conventions", call, fact)

    def _check_retry_delay(self, call: Call) -> None:
        first, second = call.attempts[:2] if len(call.attempts) > 1 else (call.request, call.request)
        if skipped_serials(first.item.serial, second.item.serial):
            return  # the capture lacks an attempt between `first` and `second`
        waited = second.time - first.time
        if waited > PERIOD_NS:
            places = {"call": call_place(call), "waited": Duration(waited)}
            fact = Message("finding.slow-retry", client=client_place(call.conversation), **places)
            self.report_call("slow-retry", call, fact, Message("clause.slow-retry", **places))

    def _report_serial_zero(self, call: Call) -> None:
        who, what = client_place(call.conversation), call_name_place(call)
        self.report_call("serial-zero", call, Message("finding.serial-zero", client=who, call=what))

    def _check_serial_reuse(self, before: Call, call: Call) -> None:
        serial = call.request.item.serial
        if serial != before.request.item.serial or _answered_before(before, call):
            return
        late = next((reply for reply in before.late_replies if reply.time > call.request.time), None)
        places = {
            "at": Moment(call.request.time),
            "client": client_place(call.conversation),
            "call": call_name_place(call),
            "before": call_name_place(before),
            "waited": Duration(call.request.time - before.request.time),
        }
        if late is None:
            fact = Message("finding.serial-reused", **places, serial=serial)
        else:
            late_at = Moment(late.time)
            fact = Message("finding.serial-reused.late-reply", **places, serial=serial, late=late_at)
        self.report_call("serial-reused", call, fact, evidence_call=before, explaining_calls=(before.number,))

    def _check_reserved(self, before: Call, call: Call) -> None:
        frame, earlier = call.request.item, before.last_attempt.item
        if frame.raw[9:] != earlier.raw[9:] or _answered_before(before, call):
            return
        if frame.reserved in skipped_serials(earlier.serial, frame.serial):
            return  # the reserved field has the serial of an attempt that was not captured
        fact = Message(
            "finding.wrong-reserved",
            at=Moment(call.request.time),
            call=call_place(call),
            before=call_place(before),
            reserved=frame.reserved,
            expected=before.request.item.serial,
        )
        self.report_call("wrong-reserved", call, fact, evidence_call=before)

    def _check_stale_answer(self, before: Call, call: Call) -> None:
        if before.reply is None or before.reply.item.serial != call.request.item.serial or call.reply is None:
            return
        outcome = "same" if before.reply.item.raw[7:] == call.reply.item.raw[7:] else "different"
        fact = Message(
            f"finding.stale-answer.{outcome}",
            client=client_place(call.conversation),
            at=Moment(call.request.time),
            serial=call.request.item.serial,
        )
        self.report_call("stale-answer", call, fact, evidence_call=before)

    def _check_unmarked_retry(self, client: ClientState, call: Call) -> None:
        before, frame = client.last_call, call.request.item
        if (
            not before.abandoned_at
            or not before.surely_unanswered
            or not _is_same_request(before, call)
            or _may_hold_position(client)
        ):
            return
        if request_effect(frame.code, frame.variants) < CallEffect.CHANGES:
            return
        fact = Message(
            "finding.unmarked-retry",
            at=Moment(call.request.time),
            call=call_place(call),
            before=call_place(before),
        )
        self.report_call(
            "unmarked-retry", call, fact, evidence_call=before, explaining_calls=(before.number,)
        )


def _retry_in_async(session: SlaveSession) -> Occurrence:
    places = {
        "client": client_place(session.conversation),
        "retries": Count(session.counts.retries_forbidden, "retry"),
        "points": Count(session.counts.sent, "set-point"),
    }
    mode, frames = session.mode.value, session.forbidden_retry_frames
    if mode is None:
        fact = Message("finding.retry-in-async", **places)
    else:
        fact = Message("finding.retry-in-async.mode", **places, mode=f"0x{mode:03X}")
    return Occurrence(
        "retry-in-async", session.entered_at, session.exit.time, session.conversation, frames[:8], fact
    )


def _is_same_request(one: Call, other: Call) -> bool:
    return one.request.item.raw[9:] == other.request.item.raw[9:]


def _may_hold_position(client: ClientState) -> bool:
    last = client.last_call
    if last.kind.folded_command != "slvmove":
        return False
    earlier = [point for point in client.recent_set_points if point is not last]
    return not earlier or _is_same_request(earlier[-1], last)


def _answered_before(before: Call, call: Call) -> bool:
    """Treat an earlier call with an unknown reply as an answered call."""
    if before.evicted or before.reply_not_captured:
        return True
    return before.reply is not None and before.reply.time <= call.request.time
