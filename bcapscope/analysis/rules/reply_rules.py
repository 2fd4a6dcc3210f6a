"""Rules about replies that came too late, twice or never."""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Iterator
from dataclasses import dataclass, field

from bcapscope.analysis.client_state import ClientState
from bcapscope.analysis.finding_places import attempt_place, call_place, call_places, client_place
from bcapscope.analysis.rules.proxy_rules import advice_by_place, with_place
from bcapscope.analysis.rules.rule_checker import (
    MS,
    ClientEnd,
    Occurrence,
    RuleChecker,
    frame_numbers,
    last_frame_time,
)
from bcapscope.messages import Message
from bcapscope.messages.message import PlaceValue
from bcapscope.messages.places import Count, Duration, Moment, Times
from bcapscope.protocol.slave_mode.modes import PERIOD_MS
from bcapscope.protocol.tables.function_table import ID
from bcapscope.traffic.call import Call, FrameObservation, StrayReply
from bcapscope.traffic.call_verdict import CallVerdict
from bcapscope.traffic.client_timeout import gives_up_at, waits_in_vain
from bcapscope.traffic.joining.joined_observation import JoinedObservation
from bcapscope.traffic.observation import Conversation, Direction, Observation

_TURN_NS = PERIOD_MS * MS + 2 * MS
_MAX_REQUESTING = 65536
_MAX_STRAYS = 64


@dataclass(slots=True)
class _Pending:
    """Calls and replies that `ReplyChecker` can judge only after it has seen more traffic of the client.

    Attributes:
        given_up: Latest call without a reply: the client gave up this call, or the client program stopped.
        strays: Replies whose request the capture seems to lack (see `StrayReply.request_missed`).
    """

    given_up: Call | None = None
    strays: list[StrayReply] = field(default_factory=list)


class ReplyChecker(RuleChecker):
    by_client: dict[Conversation, _Pending]

    def set_up(self) -> None:
        self._requesting: set[Conversation] = set()

    def on_new_flow(self, observation: Observation) -> None:
        if observation.flow.direction is Direction.REQUEST:
            if len(self._requesting) >= _MAX_REQUESTING:
                self._requesting.clear()
            self._requesting.add(observation.flow.conversation)

    def on_call(self, call: Call, client: ClientState) -> None:
        verdict = call.verdict
        if verdict is CallVerdict.EXECUTED_TWICE:
            self._report_executed_twice(call)
        late = _first_late_reply(call) if call.other_frames else None
        if late is not None:
            self._report_late(call, late)
        elif call.reply is None:
            if call.surely_unanswered and not call.notices:
                self._check_unanswered(call)
        elif verdict is CallVerdict.REPLY_LOST and call.lost_replies:
            self._report_reply_lost(call)
        elif call.retries and not _waited_for_room(call, client):
            if call.lost_replies and not call.lost_between:
                self._report_crossed(call)
            else:
                self._report_retried(call)

    def on_stray_reply(self, stray: StrayReply) -> None:
        seen, conversation = stray.observation, stray.observation.flow.conversation
        if stray.may_answer_evicted:
            client = self.clients.find(conversation)
            if client is not None:
                client.may_be_answered = True
            return
        if stray.call_number is not None:
            self.report_occurrence(_very_late(seen, stray.call_number))
        elif conversation not in self._requesting:
            return  # the request of this reply was sent before the capture began
        elif not stray.request_missed:
            self.report_occurrence(_to_nothing(seen))
        else:  # wait, because the serial of the client's next request shows whether a request is missing
            strays = self.by_client.setdefault(conversation, _Pending()).strays
            strays.append(stray)
            del strays[:-_MAX_STRAYS]

    def on_conversation_closed(self, conversation: Conversation) -> None:
        self._requesting.discard(conversation)

    def end_occurrences(self, end: ClientEnd) -> Iterator[Occurrence]:
        client, first, last = end.client, end.client.first_call, end.client.last_call
        if client.may_be_answered:
            return
        unanswered = first.surely_unanswered or first.evicted or waits_in_vain(last, end.ended_at)
        if not client.answered_count and unanswered and not last.reply_not_captured:
            yield _controller_silent(first, last, client.call_count, end.ended_at)
        pending = self.by_client.get(client.conversation, _Pending())
        if pending.given_up is last:
            yield _client_stopped(last, end.ended_at - last.last_attempt.time)
        elif pending.given_up is not None:
            yield _no_reply(pending.given_up)
        for stray in pending.strays:
            if not stray.request_missed:
                yield _to_nothing(stray.observation)

    def _report_late(self, call: Call, reply: FrameObservation) -> None:
        attempts = _AttemptIndex(call)
        attempt, gave_up = attempts.answered_by(reply), attempts.given_up_at(reply)
        rule = "client-gave-up" if call.reply is None else "late-reply"
        places = {
            "call": attempt_place(call, reply.item.serial),
            "client": client_place(call.conversation),
            "took": Duration(reply.time - attempt.time),
        }
        case, waited = ".inferred" if call.gave_up_inferred else "", Duration(gave_up - attempt.time)
        retries = Count(call.retries, "retry")
        fact = Message(f"finding.{rule}{case}", **places, waited=waited, retries=retries)
        clause = Message("clause.late-reply", **places)
        self._report_with_place(rule, call, fact, clause, began=attempt.time, completed=reply.time)

    def _check_unanswered(self, call: Call) -> None:
        closing = call.conversation.connection_end
        by_client = closing is not None and closing.by is Direction.REQUEST and not call.abandoned_at
        if by_client and call.kind.function_id == ID["Service_Stop"]:
            return  # a client that closes the connection after Service_Stop does not wait for the reply
        if call.abandoned_at or closing is not None or not gives_up_at(call):
            self.report_occurrence(_no_reply(call))
            return
        # The client's later traffic shows whether the client program has stopped.
        pending = self.by_client.setdefault(call.conversation, _Pending())
        if pending.given_up is not None:
            self.report_occurrence(_no_reply(pending.given_up))
        pending.given_up = call

    def _report_executed_twice(self, call: Call) -> None:
        if call.skipped_handles:
            handles = Count(call.skipped_handles, "handle")
            fact = Message("finding.executed-twice.handles", **call_places(call), handles=handles)
        else:
            attempts = Count(len(call.attempts), "attempt")
            fact = Message("finding.executed-twice", **call_places(call), attempts=attempts)
        self.report_call("executed-twice", call, fact)

    def _report_reply_lost(self, call: Call) -> None:
        reply = call.lost_replies[0]
        fact = Message(
            "finding.reply-lost",
            call=attempt_place(call, reply.item.serial),
            client=client_place(call.conversation),
            took=Duration(reply.time - _AttemptIndex(call).answered_by(reply).time),
        )
        self._report_with_place("reply-lost", call, fact, began=reply.time)

    def _report_crossed(self, call: Call) -> None:
        reply = call.lost_replies[0]
        retry = next((each for each in call.attempts if each.time > reply.time), call.last_attempt)
        fact = Message(
            "finding.retried.crossed",
            call=attempt_place(call, reply.item.serial),
            client=client_place(call.conversation),
            before=Duration(retry.time - reply.time),
        )
        clause = Message(
            "clause.retried", call=call_place(call), attempt=len(call.attempts) + call.unseen_retries
        )
        advice = Message("rule.retried.advice.crossed")
        self.report_call("retried", call, fact, clause, group_key="crossed", advice=advice)

    def _report_retried(self, call: Call) -> None:
        attempts = len(call.attempts) + call.unseen_retries
        case = "" if call.first_attempt_seen else ".first-unseen"
        if call.verdict is CallVerdict.REQUEST_LOST:
            case += ".request-lost"
        fact = Message(
            f"finding.retried{case}",
            **call_places(call),
            attempts=Count(attempts, "attempt"),
            after=Duration(call.latency or 0),
        )
        clause = Message("clause.retried", call=call_place(call), attempt=attempts)
        self._report_with_place("retried", call, fact, clause)

    def _report_with_place(
        self,
        rule: str,
        call: Call,
        fact: Message,
        clause: Message | None = None,
        *,
        began: int = 0,
        completed: int = 0,
    ) -> None:
        """Report a problem of a call. The place where frames were lost or held determines the advice. Calls
        with different advice become different findings.
        """
        fact, advice = with_place(call, fact), advice_by_place(call)
        key = "" if advice is None else advice.id
        self.report_call(
            rule, call, fact, clause, began=began, completed=completed, group_key=key, advice=advice
        )


def _no_reply(call: Call) -> Occurrence:
    continued_after = call.abandoned_at - call.request.time if call.abandoned_at else 0
    closing = call.conversation.connection_end
    by_client = closing is not None and closing.by is Direction.REQUEST and not continued_after
    sent = {**call_places(call), "times": Times(len(call.attempts))}
    settled = ".settled" if isinstance(call.request, JoinedObservation) else ""
    if by_client and closing is not None:
        after = Duration(closing.time - call.request.time)
        fact = Message("finding.no-reply.closed", **sent, after=after)
    elif continued_after:
        fact = Message(f"finding.no-reply.continued{settled}", **sent, after=Duration(continued_after))
    else:
        fact = Message(f"finding.no-reply{settled}", **sent)
    advice = Message("rule.no-reply.advice.closed") if by_client else advice_by_place(call)
    return Occurrence(
        "no-reply",
        call.request.time,
        call.abandoned_at or (last_frame_time(call) if closing is None else closing.time),
        call.conversation,
        frame_numbers(call),
        with_place(call, fact),
        Message("clause.no-reply", call=sent["call"]),
        call=call.number,
        group_key="" if advice is None else advice.id,
        advice=advice,
    )


def _very_late(reply: FrameObservation, call_number: int) -> Occurrence:
    conversation = reply.flow.conversation
    fact = Message(
        "finding.very-late-reply",
        at=Moment(reply.time),
        client=client_place(conversation),
        number=call_number,
        serial=reply.item.serial,
    )
    return Occurrence("very-late-reply", reply.time, reply.time, conversation, (reply.number,), fact)


def _to_nothing(reply: FrameObservation) -> Occurrence:
    conversation = reply.flow.conversation
    fact = Message(
        "finding.reply-to-nothing",
        at=Moment(reply.time),
        client=client_place(conversation),
        serial=reply.item.serial,
    )
    return Occurrence("reply-to-nothing", reply.time, reply.time, conversation, (reply.number,), fact)


def _client_stopped(call: Call, quiet: int) -> Occurrence:
    first, last = call.attempts[0].time, call.attempts[-1].time
    client, stopped = client_place(call.conversation), call_place(call)
    fact = Message(
        "finding.client-stopped",
        client=client,
        call=stopped,
        times=Times(len(call.attempts)),
        lasted=Duration(last - first),
        quiet=Duration(quiet),
    )
    clause = Message("clause.client-stopped", client=client, call=stopped)
    frames = frame_numbers(call)
    return Occurrence(
        "client-stopped", first, last, call.conversation, frames, fact, clause, call=call.number
    )


def _controller_silent(first: Call, last: Call, calls: int, ended_at: int) -> Occurrence:
    conversation, began = first.conversation, first.request.time
    ends: dict[str, PlaceValue] = {"server": str(conversation.server), "client": client_place(conversation)}
    lasted = Duration(ended_at - began)
    if calls == 1:
        attempts = Count(len(last.attempts), "attempt")
        fact = Message("finding.controller-silent.one-call", **ends, attempts=attempts, lasted=lasted)
    else:
        fact = Message("finding.controller-silent", **ends, calls=Count(calls, "call"), lasted=lasted)
    frames = (first.request.number, last.attempts[-1].number)
    clause = Message("clause.controller-silent", **ends)
    return Occurrence("controller-silent", began, began, conversation, frames, fact, clause)


def _waited_for_room(call: Call, client: ClientState) -> bool:
    """Return whether the controller answered a set point late because the buffer had no room.

    The controller waits for room only in modes in which the controller sets the pace. In these modes, DENSO
    recommends a client timeout of 2 ms. Therefore the client retries while the controller waits for room.
    These retries do no harm.
    """
    mode, latency = client.slave_mode, call.latency
    if mode is None or not mode.paces_client or latency is None:
        return False
    return call.kind.folded_command == "slvmove" and latency <= _TURN_NS


class _AttemptIndex:
    """Finds an attempt of a call by serial and time, fast even if the call has thousands of attempts."""

    def __init__(self, call: Call) -> None:
        self._call = call
        self._times = sorted(each.time for each in call.attempts)
        self._by_serial: dict[int, list[FrameObservation]] = {}
        for each in call.attempts:
            self._by_serial.setdefault(each.item.serial, []).append(each)

    def answered_by(self, reply: FrameObservation) -> FrameObservation:
        """Return the last attempt that has the same serial as `reply` and was sent before `reply`. If there
        is no such attempt, return the call's request.
        """
        sent = [each for each in self._by_serial.get(reply.item.serial, ()) if each.time <= reply.time]
        return sent[-1] if sent else self._call.request

    def given_up_at(self, reply: FrameObservation) -> int:
        """Return when the client gave up the answered attempt, ns since 1970; 0 if `reply` was not late."""
        sent_at, abandoned_at = self.answered_by(reply).time, self._call.abandoned_at
        after = bisect_right(self._times, sent_at)
        if after < len(self._times) and self._times[after] <= reply.time:
            return self._times[after]
        return abandoned_at if sent_at < abandoned_at <= reply.time else 0


def _first_late_reply(call: Call) -> FrameObservation | None:
    attempts = _AttemptIndex(call)
    return next((reply for reply in call.late_replies if attempts.given_up_at(reply)), None)
