"""Replies that came too late, twice or never."""

from __future__ import annotations

from bisect import bisect_right
from itertools import pairwise

from bcapscope.analysis.client import Client, Clients, command_of
from bcapscope.analysis.finding import Severity
from bcapscope.analysis.rules.rule import MS, SECOND, Incident, Report, Rule, Watcher
from bcapscope.analysis.speech import Speech, called, name_of, span, times
from bcapscope.protocol.functions import ID
from bcapscope.protocol.slavemode import PERIOD_MS
from bcapscope.protocol.wording import counted
from bcapscope.traffic.exchange import Exchange, FrameObservation, Stray
from bcapscope.traffic.observation import Conversation, Direction, Observation
from bcapscope.traffic.verdict import Verdict

_SEED = "DENSO Wave 2009, How to use the Slave mode"
_C_CLIENT = "orin_bcap C/src/bCAPClient/bcap_client.c"
_ROS_12 = "DENSORobot/denso_robot_ros issues 8 and 12"

_WAIT = (
    "Wait for longer than the call takes, a motion above all, or have the controller say S_EXECUTING (WDT in "
    "the option of Service_Start); a client that closes the connection gets no reply."
)

LATE_REPLY = Rule(
    "late-reply",
    Severity.WARNING,
    "a reply came after the client had given up that try and sent another",
    "Find out who was slow: give the controller's network no other load, and the client a longer time-out "
    "than its slowest reply; in a waiting mode a reply to slvMove may take 8 ms.",
    f"{_SEED}, Retry sequence in UDP connection; {_ROS_12}",
    ("long-call-without-wdt", "malformed-request"),
)
GAVE_UP = Rule(
    "client-gave-up",
    Severity.ERROR,
    "a reply came, but only after the client had stopped waiting for the call",
    "Raise the client's time-out or its number of tries, and look for what held the reply up; the client "
    "reports this as 80000900, though the controller did answer.",
    f"{_ROS_12}; {_C_CLIENT}",
    ("long-call-without-wdt", "malformed-request"),
)
NO_REPLY = Rule(
    "no-reply",
    Severity.ERROR,
    "a call was not answered at all, and the client went on",
    "Capture at the controller's end as well: only that tells a lost request from a lost reply and from a "
    "silent controller.",
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
STOPPED = Rule(
    "client-stopped",
    Severity.ERROR,
    "after its last try went unanswered the client said nothing more",
    "Expect 80000900 in the client's log at this moment; check cable, switch and controller, then the "
    "time-out and number of tries.",
    f"{_C_CLIENT}; {_ROS_12}",
    ("malformed-request", "oversize-datagram", "no-reply", "controller-silent", "long-call-without-wdt"),
    60 * SECOND,
)
SILENT = Rule(
    "controller-silent",
    Severity.ERROR,
    "a client asked and asked, and never had any reply",
    "Check address and port (5007), that b-CAP is enabled and licensed on the controller, and that the "
    "pendant's setting of TCP or UDP agrees with the client; or the capture shows one direction only.",
    f"{_SEED}, Setting up your RC7; DENSORobot/denso_robot_ros2 issues 3, 8 and 50",
    ("malformed-request", "oversize-datagram"),
    60 * SECOND,
)
TWICE = Rule(
    "executed-twice",
    Severity.ERROR,
    "the controller executed one call more than once",
    "Let retries carry the serial of the first try in reserved; note that the official server itself "
    "executes a second retry again when the first packet was lost, so a call that moves must not be retried "
    "blindly.",
    "orin_bcap C/src/bCAPServer/bcap_server.c",
    ("late-reply", "reply-lost", "retried"),
)
REPLY_LOST = Rule(
    "reply-lost",
    Severity.WARNING,
    "a reply was seen in time, and yet the client asked again",
    "Look between the place of the capture and the client: a full socket buffer, a firewall, a client too "
    "busy to read.",
    _SEED,
)
RETRIED = Rule(
    "retried",
    Severity.WARNING,
    "calls were answered only after they had been sent again",
    "Packets are lost on the way: check cable, switch, duplex and other load; each retry costs its time-out.",
    f"{_SEED}, Retry sequence in UDP connection",
    ("malformed-request", "malformed-reply", "reply-to-nothing"),
)
VERY_LATE = Rule(
    "very-late-reply",
    Severity.WARNING,
    "a reply came when its call was long over",
    "Look at what the controller was doing; a client that uses serials again may take such a reply "
    "for another's.",
    _C_CLIENT,
)
TO_NOTHING = Rule(
    "reply-to-nothing",
    Severity.WARNING,
    "a reply has a serial that the client never asked with",
    "If the capture missed the request, ignore it; otherwise the server answers with a wrong serial, and the "
    "client will time out.",
    f"{_SEED}, Retry sequence in UDP connection",
)

_QUIET = 20 * MS
_TURN = PERIOD_MS * MS + 2 * MS
_MOST_ASKING = 65536


class Replies(Watcher):
    """Judges calls that did not go smoothly by when their replies came."""

    rules = (
        LATE_REPLY,
        GAVE_UP,
        NO_REPLY,
        STOPPED,
        SILENT,
        TWICE,
        REPLY_LOST,
        RETRIED,
        VERY_LATE,
        TO_NOTHING,
    )

    def __init__(self, report: Report, clients: Clients) -> None:
        super().__init__(report, clients)
        self._asking: set[Conversation] = set()

    def fresh(self, seen: Observation) -> None:
        if seen.flow.direction is Direction.REQUEST:
            if len(self._asking) >= _MOST_ASKING:
                self._asking.clear()
            self._asking.add(seen.flow.conversation)

    def call(self, call: Exchange, client: Client) -> None:
        verdict = call.verdict
        if verdict is Verdict.EXECUTED_TWICE:
            self._twice(call)
        late = _first_late(call) if call.others else None
        if late is not None:
            self._late(call, late)
        elif call.reply is None:
            if call.given_up and not call.notices:
                self._unanswered(call)
        elif verdict is Verdict.REPLY_LOST and call.lost_replies:
            self._lost(call)
        elif call.retries and not _waited_its_turn(call, client):
            self._retried(call)

    def stray(self, stray: Stray) -> None:
        seen, conversation = stray.seen, stray.seen.flow.conversation
        if stray.overlooked:
            client = self.clients.find(conversation)
            if client is not None:
                client.heard = True
            return
        serial = seen.item.serial
        if stray.call is not None:
            rule, text = (
                VERY_LATE,
                f"a reply to call {stray.call} (serial {serial}) came when the call was over",
            )
        elif conversation not in self._asking:
            return  # the capture began after the request
        else:
            rule, text = TO_NOTHING, f"a reply with serial {serial} came, and no request with it was seen"

        def say(speech: Speech) -> str:
            return f"{text}, at {speech.at(seen.time)} to {speech.client(conversation)}"

        self.report(Incident(rule, seen.time, seen.time, conversation, (seen.number,), say))

    def forget(self, conversation: Conversation) -> None:
        self._asking.discard(conversation)

    def gone(self, client: Client, ended: int) -> None:
        last = client.last
        if client.heard:
            return
        first = client.first
        if not client.answered and (first.given_up or first.let_go or len(last.requests) > 1):
            self._silent(client, ended)
        if last.reply is not None or last.given_up or last.notices or last.late_replies:
            return
        tries = [request.time for request in last.requests]
        if len(tries) > 1:
            pause = max(after - before for before, after in pairwise(tries))
            quiet = ended - tries[-1]
            if quiet >= max(3 * pause, _QUIET):
                self._stopped(last, quiet)

    def _late(self, call: Exchange, reply: FrameObservation) -> None:
        tries = _Tries(call)
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

        self.tell(LATE_REPLY if answered else GAVE_UP, call, say, then, began=tried.time, time=reply.time)

    def _unanswered(self, call: Exchange) -> None:
        tries, name = len(call.requests), called(call)
        gone_on = call.gone_on - call.request.time if call.gone_on else 0
        closing = call.conversation.closing
        by_client = closing is not None and closing.by is Direction.REQUEST and not gone_on
        if by_client and call.question.function_id == ID["Service_Stop"]:
            return  # nobody waits for that one

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

        self.tell(
            NO_REPLY,
            call,
            say,
            then,
            time=call.gone_on or (0 if closing is None else closing.time),
            key="closed" if by_client else "",
            advice=_WAIT if by_client else "",
        )

    def _stopped(self, call: Exchange, quiet: int) -> None:
        first, last = call.requests[0].time, call.requests[-1].time

        def say(speech: Speech) -> str:
            tries = len(call.requests)
            who = speech.client(call.conversation)
            return (
                f"{who} sent {called(call)} {times(tries)} in {span(last - first)} without any reply and "
                f"then said nothing more for the {span(quiet)} that the capture goes on; its library has "
                "probably reported 80000900"
            )

        def then(speech: Speech, after: int) -> str:
            return f"{speech.client(call.conversation)} said nothing more after {called(call)}"

        self.tell(STOPPED, call, say, then, time=last)

    def _silent(self, client: Client, ended: int) -> None:
        first, last, calls = client.first, client.last, client.calls

        def say(speech: Speech) -> str:
            server = client.conversation.server
            tries = f" in {counted(len(last.requests), 'try', 'tries')}" if calls == 1 else ""
            return (
                f"{server} never answered {speech.client(client.conversation)}, which made "
                f"{counted(calls, 'call')}{tries} in {span(ended - first.request.time)}"
            )

        def then(speech: Speech, after: int) -> str:
            return f"{client.conversation.server} never answered {speech.client(client.conversation)}"

        frames = (first.request.number, last.requests[-1].number)
        began = first.request.time
        self.report(Incident(SILENT, began, began, client.conversation, frames, say, then))

    def _twice(self, call: Exchange) -> None:
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
            return f"{text}: its {len(call.requests)} tries were answered with different results"

        self.tell(TWICE, call, say)

    def _lost(self, call: Exchange) -> None:
        reply = call.lost_replies[0]
        took = span(reply.time - _Tries(call).answered_by(reply).time)

        def say(speech: Speech) -> str:
            who = speech.client(call.conversation)
            return (
                f"the reply to {name_of(call)} {reply.item.serial} was here after {took}, and yet {who} "
                "asked again"
            )

        self.tell(REPLY_LOST, call, say, began=reply.time)

    def _retried(self, call: Exchange) -> None:
        lost = call.verdict is Verdict.REQUEST_LOST
        sent = f"sent {times(len(call.requests))}" if call.origin_seen else "sent again"

        def say(speech: Speech) -> str:
            text = (
                f"at {speech.at(call.request.time)} {called(call)} of "
                f"{speech.client(call.conversation)} was {sent} before it was answered"
            )
            if call.latency is not None:
                text += f", {span(call.latency)} after the first try"
            return f"{text}; a request was lost" if lost else f"{text}; nothing seen here tells what was lost"

        def then(speech: Speech, after: int) -> str:
            return f"{called(call)} was answered only at try {len(call.requests)}"

        self.tell(RETRIED, call, say, then)


def _waited_its_turn(call: Exchange, client: Client) -> bool:
    """Tell whether a set point was only answered when it was taken, as it is in a waiting mode.

    With the time-out of 2 ms that DENSO recommends for these modes it is sent again meanwhile, and if one of
    those packets was lost, that did no harm.
    """
    mode, latency = client.slave_mode, call.latency
    if mode is None or not mode.paces or latency is None:
        return False
    return command_of(call.question) == "slvmove" and latency <= _TURN


class _Tries:
    """The tries of a call by serial and by time: of both tries and replies there may be thousands."""

    def __init__(self, call: Exchange) -> None:
        self._call = call
        self._times = sorted(each.time for each in call.requests)
        self._by_serial: dict[int, list[FrameObservation]] = {}
        for each in call.requests:
            self._by_serial.setdefault(each.item.serial, []).append(each)

    def answered_by(self, reply: FrameObservation) -> FrameObservation:
        """Return the latest try that a reply can answer."""
        tries = [each for each in self._by_serial.get(reply.item.serial, ()) if each.time <= reply.time]
        return tries[-1] if tries else self._call.request

    def given_up_at(self, reply: FrameObservation) -> int:
        """Return when the client stopped waiting for a reply that came later; 0 where it did not."""
        tried, gone_on = self.answered_by(reply).time, self._call.gone_on
        after = bisect_right(self._times, tried)
        if after < len(self._times) and self._times[after] <= reply.time:
            return self._times[after]
        return gone_on if tried < gone_on <= reply.time else 0


def _first_late(call: Exchange) -> FrameObservation | None:
    tries = _Tries(call)
    return next((reply for reply in call.late_replies if tries.given_up_at(reply)), None)


def _was(count: int) -> str:
    return "was" if count == 1 else "were"
