"""Rules about replies that came too late, twice or never."""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Iterator
from itertools import pairwise

from bcapscope.analysis.client_state import ClientRegistry, ClientState, folded_command
from bcapscope.analysis.finding import Severity
from bcapscope.analysis.rules.rule_checker import (
    MS,
    SECOND,
    ClientEnd,
    DiagnosisRule,
    Occurrence,
    OccurrenceSink,
    RuleChecker,
    frame_numbers,
)
from bcapscope.analysis.speech import Speech, called, name_of, span, times
from bcapscope.protocol.slave_mode.modes import PERIOD_MS
from bcapscope.protocol.tables.function_table import ID
from bcapscope.protocol.text_format import counted
from bcapscope.traffic.call import Call, FrameObservation, StrayReply
from bcapscope.traffic.call_verdict import CallVerdict
from bcapscope.traffic.observation import Conversation, Direction, Observation

_SEED = "DENSO Wave 2009, How to use the Slave mode"
_C_CLIENT = "orin_bcap C/src/bCAPClient/bcap_client.c"
_ROS_12 = "DENSORobot/denso_robot_ros issues 8 and 12"

_WAIT_ADVICE = (
    "Wait for longer than the call takes, a motion above all, or have the controller say S_EXECUTING (WDT in "
    "the option of Service_Start); a client that closes the connection gets no reply."
)

LATE_REPLY = DiagnosisRule(
    "late-reply",
    Severity.WARNING,
    f"{_SEED}, Retry sequence in UDP connection; {_ROS_12}",
    ("long-call-without-wdt", "malformed-request"),
)
CLIENT_GAVE_UP = DiagnosisRule(
    "client-gave-up",
    Severity.ERROR,
    f"{_ROS_12}; {_C_CLIENT}",
    ("long-call-without-wdt", "malformed-request"),
)
NO_REPLY = DiagnosisRule(
    "no-reply",
    Severity.ERROR,
    f"{_C_CLIENT}; {_ROS_12}",
    (
        "controller-hung-up",
        "malformed-request",
        "oversize-datagram",
        "executing-forever",
        "controller-silent",
        "malformed-reply",
        "reply-to-nothing",
    ),
    60 * SECOND,
)
CLIENT_STOPPED = DiagnosisRule(
    "client-stopped",
    Severity.ERROR,
    f"{_C_CLIENT}; {_ROS_12}",
    ("malformed-request", "oversize-datagram", "no-reply", "controller-silent", "long-call-without-wdt"),
    60 * SECOND,
)
CONTROLLER_SILENT = DiagnosisRule(
    "controller-silent",
    Severity.ERROR,
    f"{_SEED}, Setting up your RC7; DENSORobot/denso_robot_ros2 issues 3, 8 and 50",
    ("malformed-request", "oversize-datagram"),
    60 * SECOND,
)
EXECUTED_TWICE = DiagnosisRule(
    "executed-twice",
    Severity.ERROR,
    "orin_bcap C/src/bCAPServer/bcap_server.c",
    ("late-reply", "reply-lost", "retried"),
)
REPLY_LOST = DiagnosisRule(
    "reply-lost",
    Severity.WARNING,
    _SEED,
)
RETRIED = DiagnosisRule(
    "retried",
    Severity.WARNING,
    f"{_SEED}, Retry sequence in UDP connection",
    ("malformed-request", "malformed-reply", "reply-to-nothing"),
)
VERY_LATE_REPLY = DiagnosisRule(
    "very-late-reply",
    Severity.WARNING,
    _C_CLIENT,
)
REPLY_TO_NOTHING = DiagnosisRule(
    "reply-to-nothing",
    Severity.WARNING,
    f"{_SEED}, Retry sequence in UDP connection",
)

_QUIET_NS = 20 * MS
_TURN_NS = PERIOD_MS * MS + 2 * MS
_MAX_REQUESTING = 65536


class ReplyChecker(RuleChecker):
    """Checks calls that did not go smoothly by the times of their replies."""

    rules = (
        LATE_REPLY,
        CLIENT_GAVE_UP,
        NO_REPLY,
        CLIENT_STOPPED,
        CONTROLLER_SILENT,
        EXECUTED_TWICE,
        REPLY_LOST,
        RETRIED,
        VERY_LATE_REPLY,
        REPLY_TO_NOTHING,
    )

    def __init__(self, report_occurrence: OccurrenceSink, clients: ClientRegistry) -> None:
        super().__init__(report_occurrence, clients)
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
                self._report_unanswered(call)
        elif verdict is CallVerdict.REPLY_LOST and call.lost_replies:
            self._report_reply_lost(call)
        elif call.retries and not _waited_for_room(call, client):
            self._report_retried(call)

    def on_stray_reply(self, stray: StrayReply) -> None:
        seen, conversation = stray.observation, stray.observation.flow.conversation
        if stray.may_answer_evicted:
            client = self.clients.find(conversation)
            if client is not None:
                client.may_be_answered = True
            return
        serial = seen.item.serial
        if stray.call_number is not None:
            rule, text = (
                VERY_LATE_REPLY,
                f"a reply to call {stray.call_number} (serial {serial}) came when the call was over",
            )
        elif conversation not in self._requesting:
            return  # the capture began after the request
        else:
            rule, text = (
                REPLY_TO_NOTHING,
                f"a reply with serial {serial} came, and no request with it was seen",
            )

        def say(speech: Speech) -> str:
            return f"{text}, at {speech.at(seen.time)} to {speech.client(conversation)}"

        self.report_occurrence(Occurrence(rule, seen.time, seen.time, conversation, (seen.number,), say))

    def on_conversation_closed(self, conversation: Conversation) -> None:
        self._requesting.discard(conversation)

    def end_occurrences(self, end: ClientEnd) -> Iterator[Occurrence]:
        client, first, last = end.client, end.client.first_call, end.client.last_call
        if client.may_be_answered:
            return
        if not client.answered_count and (first.surely_unanswered or first.evicted or len(last.attempts) > 1):
            yield _controller_silent(first, last, client.call_count, end.ended_at)
        if last.reply is not None or last.surely_unanswered or last.notices or last.late_replies:
            return
        attempts = [request.time for request in last.attempts]
        if len(attempts) > 1:
            pause = max(after - before for before, after in pairwise(attempts))
            quiet = end.ended_at - attempts[-1]
            if quiet >= max(3 * pause, _QUIET_NS):
                yield _client_stopped(last, quiet)

    def _report_late(self, call: Call, reply: FrameObservation) -> None:
        tries = _AttemptIndex(call)
        tried, gave_up = tries.answered_by(reply), tries.given_up_at(reply)
        answered = call.reply is not None
        name, serial = name_of(call), reply.item.serial
        took, waited = span(reply.time - tried.time), span(gave_up - tried.time)

        def say(speech: Speech) -> str:
            who = speech.client(call.conversation)
            text = (
                f"the reply to {name} {serial} came {took} after it was sent, {who} had given up at {waited}"
            )
            if not answered:
                return text
            return f"{text} and tried again ({counted(call.retries, 'retry', 'retries')})"

        def then(speech: Speech, after: int) -> str:
            return (
                f"the reply to {name} {serial} came after {took}, when "
                f"{speech.client(call.conversation)} had given up"
            )

        self.report_call(
            LATE_REPLY if answered else CLIENT_GAVE_UP,
            call,
            say,
            then,
            began=tried.time,
            completed=reply.time,
        )

    def _report_unanswered(self, call: Call) -> None:
        tries, name = len(call.attempts), called(call)
        gone_on = call.abandoned_at - call.request.time if call.abandoned_at else 0
        closing = call.conversation.connection_end
        by_client = closing is not None and closing.by is Direction.REQUEST and not gone_on
        if by_client and call.kind.function_id == ID["Service_Stop"]:
            return  # the client does not wait for this reply

        def say(speech: Speech) -> str:
            text = f"at {speech.at(call.request.time)} {name} was sent {times(tries)} and never answered"
            who = speech.client(call.conversation)
            if by_client and closing is not None:
                return f"{text}; {who} closed the connection after {span(closing.time - call.request.time)}"
            if gone_on:
                text += f"; {who} went on after {span(gone_on)}"
            return f"{text}; whether requests or replies were lost cannot be told from here"

        def then(speech: Speech, after: int) -> str:
            return f"{name} was never answered"

        self.report_call(
            NO_REPLY,
            call,
            say,
            then,
            completed=call.abandoned_at or (0 if closing is None else closing.time),
            group_key="closed" if by_client else "",
            advice=_WAIT_ADVICE if by_client else "",
        )

    def _report_executed_twice(self, call: Call) -> None:
        def say(speech: Speech) -> str:
            text = (
                f"at {speech.at(call.request.time)} {called(call)} was executed more than once for "
                f"{speech.client(call.conversation)}"
            )
            if call.skipped_handles:
                extra = counted(call.skipped_handles, "handle")
                return (
                    f"{text}: the handle that came back skips {extra}, which "
                    f"{_was(call.skipped_handles)} given away unseen"
                )
            return f"{text}: its {len(call.attempts)} tries were answered with different results"

        self.report_call(EXECUTED_TWICE, call, say)

    def _report_reply_lost(self, call: Call) -> None:
        reply = call.lost_replies[0]
        took = span(reply.time - _AttemptIndex(call).answered_by(reply).time)

        def say(speech: Speech) -> str:
            who = speech.client(call.conversation)
            return (
                f"the reply to {name_of(call)} {reply.item.serial} was here after {took}, and yet {who} "
                "asked again"
            )

        self.report_call(REPLY_LOST, call, say, began=reply.time)

    def _report_retried(self, call: Call) -> None:
        lost = call.verdict is CallVerdict.REQUEST_LOST
        sent = f"sent {times(len(call.attempts))}" if call.first_attempt_seen else "sent again"

        def say(speech: Speech) -> str:
            text = (
                f"at {speech.at(call.request.time)} {called(call)} of "
                f"{speech.client(call.conversation)} was {sent} before it was answered"
            )
            if call.latency is not None:
                text += f", {span(call.latency)} after the first try"
            return f"{text}; a request was lost" if lost else f"{text}; nothing seen here tells what was lost"

        def then(speech: Speech, after: int) -> str:
            return f"{called(call)} was answered only at try {len(call.attempts)}"

        self.report_call(RETRIED, call, say, then)


def _client_stopped(call: Call, quiet: int) -> Occurrence:
    first, last = call.attempts[0].time, call.attempts[-1].time

    def say(speech: Speech) -> str:
        tries = len(call.attempts)
        who = speech.client(call.conversation)
        return (
            f"{who} sent {called(call)} {times(tries)} in {span(last - first)} without any reply and "
            f"then said nothing more for the {span(quiet)} that the capture goes on; its library has "
            "probably reported 80000900"
        )

    def then(speech: Speech, after: int) -> str:
        return f"{speech.client(call.conversation)} said nothing more after {called(call)}"

    frames = frame_numbers(call)
    return Occurrence(CLIENT_STOPPED, first, last, call.conversation, frames, say, then, call=call.number)


def _controller_silent(first: Call, last: Call, calls: int, ended_at: int) -> Occurrence:
    conversation, began = first.conversation, first.request.time

    def say(speech: Speech) -> str:
        tries = f" in {counted(len(last.attempts), 'try', 'tries')}" if calls == 1 else ""
        return (
            f"{conversation.server} never answered {speech.client(conversation)}, which made "
            f"{counted(calls, 'call')}{tries} in {span(ended_at - began)}"
        )

    def then(speech: Speech, after: int) -> str:
        return f"{conversation.server} never answered {speech.client(conversation)}"

    frames = (first.request.number, last.attempts[-1].number)
    return Occurrence(CONTROLLER_SILENT, began, began, conversation, frames, say, then)


def _waited_for_room(call: Call, client: ClientState) -> bool:
    """Return whether the controller delayed the reply to a set point until its buffer had room.

    It does so in modes whose replies wait. DENSO recommends a time-out of 2 ms for these modes, so the client
    retries in the meantime. A lost packet among these attempts does no harm.
    """
    mode, latency = client.slave_mode, call.latency
    if mode is None or not mode.paces_client or latency is None:
        return False
    return folded_command(call.kind) == "slvmove" and latency <= _TURN_NS


class _AttemptIndex:
    """Finds attempts of a call by serial and time; a call may have thousands of attempts and replies."""

    def __init__(self, call: Call) -> None:
        self._call = call
        self._times = sorted(each.time for each in call.attempts)
        self._by_serial: dict[int, list[FrameObservation]] = {}
        for each in call.attempts:
            self._by_serial.setdefault(each.item.serial, []).append(each)

    def answered_by(self, reply: FrameObservation) -> FrameObservation:
        """Return the latest attempt that a reply can answer."""
        tries = [each for each in self._by_serial.get(reply.item.serial, ()) if each.time <= reply.time]
        return tries[-1] if tries else self._call.request

    def given_up_at(self, reply: FrameObservation) -> int:
        """Return when the client gave up the attempt that `reply` answers, ns since 1970; 0 if it did not."""
        tried, gone_on = self.answered_by(reply).time, self._call.abandoned_at
        after = bisect_right(self._times, tried)
        if after < len(self._times) and self._times[after] <= reply.time:
            return self._times[after]
        return gone_on if tried < gone_on <= reply.time else 0


def _first_late_reply(call: Call) -> FrameObservation | None:
    tries = _AttemptIndex(call)
    return next((reply for reply in call.late_replies if tries.given_up_at(reply)), None)


def _was(count: int) -> str:
    return "was" if count == 1 else "were"
