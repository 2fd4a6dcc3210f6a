"""Retries that break the rules, and serials that lead to mistakes."""

from __future__ import annotations

from bcapscope.analysis.client import Client, Clients, command_of
from bcapscope.analysis.finding import Severity
from bcapscope.analysis.rules.rule import MS, Incident, Kind, Report, Rule, Watcher
from bcapscope.analysis.speech import Speech, called, name_of, span
from bcapscope.analysis.stay import Stay
from bcapscope.protocol.effects import Effect
from bcapscope.protocol.functions import ID
from bcapscope.protocol.guard import request_effect
from bcapscope.protocol.wording import counted
from bcapscope.traffic.convention import Convention
from bcapscope.traffic.exchange import Exchange
from bcapscope.traffic.observation import Conversation, Transport
from bcapscope.traffic.question import Question

_SEED = "DENSO Wave 2009, How to use the Slave mode"
_SERVER = "orin_bcap C/src/bCAPServer/bcap_server.c"

IN_ASYNC = Rule(
    "retry-in-async",
    Severity.WARNING,
    "a set point was sent again in a mode where the newest point wins",
    "Set the retry count of slvMove to 0 in Async mode (0x1nn): the next set point is due anyway, and "
    "retries only take line time from it.",
    f"{_SEED}, Recommendation of the Slave mode",
)
WRONG_RESERVED = Rule(
    "wrong-reserved",
    Severity.ERROR,
    "a retry names neither the first try nor the one before it in reserved",
    "Put the serial of the first try into reserved of every retry; the controller takes any other retry for "
    "a new call and executes it.",
    f"{_SEED}, Retry sequence in UDP connection",
)
UNMARKED = Rule(
    "unmarked-retry",
    Severity.WARNING,
    "a request that changes or moves something was repeated as if it were new",
    "Repeat it with the serial of the first try in reserved, so that the controller can tell; or ask for the "
    "state first.",
    f"{_SEED}, Retry sequence in UDP connection; {_SERVER}",
    ("no-reply", "client-gave-up", "reply-lost"),
)
SERIAL_ZERO = Rule(
    "serial-zero",
    Severity.WARNING,
    "the first request of a client has serial 0",
    "Begin with serial 1: the official server takes a first packet with serial 0 for a retry and answers "
    "S_OK without executing anything.",
    _SERVER,
)
SERIAL_REUSED = Rule(
    "serial-reused",
    Severity.ERROR,
    "on TCP a serial was used again before its call was answered",
    "Close the connection after a time-out, or use a longer one (the official Python client counts it in "
    "seconds): its serial stays the same, and the late reply is taken for the answer to the next call.",
    "orin_bcap Python/bCAPClient/bcapclient.py",
    ("long-call-without-wdt",),
)
STALE = Rule(
    "stale-answer",
    Severity.WARNING,
    "a client began anew from the same port with the serial that was answered last",
    "Begin with another serial or another port: the official server takes such a packet for a retry, sends "
    "its stored answer again and executes nothing.",
    _SERVER,
    ("unclean-quit",),
)
SLOW_RETRY = Rule(
    "slow-retry",
    Severity.WARNING,
    "the client waits more than one period of 8 ms before it sends a lost set point again",
    "Give slvMove a time-out of 2 ms and 7 retries in a waiting mode, and all other calls their "
    "own, longer one.",
    f"{_SEED}, Recommendation of the Slave mode; DENSORobot/denso_robot_ros2 denso_robot_control",
    ("long-call-without-wdt",),
)
MIXED = Rule(
    "mixed-conventions",
    Severity.NOTE,
    "a client changed how it uses the reserved field",
    "Expect two programs, or two libraries, behind one address and port.",
    f"{_SEED}; orin_bcap C/src/bCAPClient/bcap_client.c; start-jsk/denso b-Cap.c",
)

_PERIOD = 8 * MS


class Retries(Watcher):
    """Looks at how tries follow each other."""

    rules = (IN_ASYNC, WRONG_RESERVED, UNMARKED, SERIAL_ZERO, SERIAL_REUSED, STALE, SLOW_RETRY, MIXED)

    def __init__(self, report: Report, clients: Clients) -> None:
        super().__init__(report, clients)
        self._conventions: dict[Conversation, Convention] = {}

    def heeds(self, question: Question, kind: Kind) -> bool:
        return kind is not Kind.SMOOTH or command_of(question) != "slvmove"

    def call(self, call: Exchange, client: Client) -> None:
        if call.convention is not Convention.UNKNOWN:
            self._compare_convention(call)
        if call.retries and command_of(call.question) == "slvmove":
            self._time_retry(call)
        tcp = call.conversation.transport is Transport.TCP
        if not client.calls:
            if not tcp and call.request.item.serial == 0:
                self._zero(call)
        elif tcp:
            self._look_for_reuse(client.last, call)
        elif not call.origin_seen:
            self._look_for_wrong_reserved(client.last, call)
        elif call.question.function_id == ID["Service_Start"]:
            self._look_for_stale(client.last, call)
        elif client.last.reply is None:
            self._look_for_unmarked(client, call)

    def stay(self, stay: Stay) -> None:
        count, frames = stay.counts.retries_forbidden, stay.forbidden_retry_list
        if not count:
            return
        mode = f"mode 0x{stay.mode.value:03X}" if stay.mode.value is not None else "Async mode"

        def say(speech: Speech) -> str:
            who = speech.client(stay.conversation)
            points = counted(stay.counts.sent, "set point")
            return (
                f"{who} sent {counted(count, 'retry', 'retries')} of {points} in {mode}, where the "
                "newest point wins"
            )

        self.report(Incident(IN_ASYNC, stay.entered, stay.exit.time, stay.conversation, frames[:8], say))

    def gone(self, client: Client, ended: int) -> None:
        self._conventions.pop(client.conversation, None)

    def _compare_convention(self, call: Exchange) -> None:
        before = self._conventions.get(call.conversation)
        if before is call.convention:
            return
        self._conventions[call.conversation] = now = call.convention
        if before is not None:
            self.tell(
                MIXED,
                call,
                lambda speech: (
                    f"{speech.client(call.conversation)} used the reserved field as '{before}' first "
                    f"and as '{now}' later, about {called(call)}"
                ),
            )

    def _time_retry(self, call: Exchange) -> None:
        first, second = call.requests[:2] if len(call.requests) > 1 else (call.request, call.request)
        wait = second.time - first.time
        if wait > _PERIOD:
            self.tell(
                SLOW_RETRY,
                call,
                lambda speech: (
                    f"{speech.client(call.conversation)} waited {span(wait)} before it sent {called(call)} "
                    "again, and the controller wants a set point each 8 ms"
                ),
                lambda speech, after: f"{called(call)} was sent again only after {span(wait)}",
            )

    def _zero(self, call: Exchange) -> None:
        self.tell(
            SERIAL_ZERO,
            call,
            lambda speech: (
                f"the first request of {speech.client(call.conversation)}, {name_of(call)}, has serial 0, "
                "and the official server answers such a one S_OK without executing it"
            ),
        )

    def _look_for_reuse(self, before: Exchange, call: Exchange) -> None:
        serial = call.request.item.serial
        if serial != before.request.item.serial or _answered_before(before, call):
            return
        late = next((reply for reply in before.late_replies if reply.time > call.request.time), None)

        def say(speech: Speech) -> str:
            waited = span(call.request.time - before.request.time)
            text = (
                f"at {speech.at(call.request.time)} {name_of(call)} was sent with serial {serial}, "
                f"{waited} after {name_of(before)} with the same serial and before that was answered"
            )
            if late is None:
                return text
            who = speech.client(call.conversation)
            return (
                f"{text}; the reply at {speech.at(late.time)} is that to {name_of(before)}, and {who} "
                "cannot know it"
            )

        self.tell(SERIAL_REUSED, call, say, before=before, because=(before.call,))

    def _look_for_wrong_reserved(self, before: Exchange, call: Exchange) -> None:
        frame, earlier = call.request.item, before.last.item
        if frame.raw[9:] != earlier.raw[9:] or _answered_before(before, call):
            return
        origin = before.request.item.serial
        self.tell(
            WRONG_RESERVED,
            call,
            lambda speech: (
                f"at {speech.at(call.request.time)} {called(call)} repeats {called(before)}, and "
                f"its reserved field says {frame.reserved} instead of "
                f"{origin}, so that the controller takes it for another call"
            ),
            before=before,
        )

    def _look_for_stale(self, before: Exchange, call: Exchange) -> None:
        if before.reply is None or before.reply.item.serial != call.request.item.serial or call.reply is None:
            return
        same = before.reply.item.raw[7:] == call.reply.item.raw[7:]
        outcome = "and the reply is the same as before" if same else "though the reply is another"
        self.tell(
            STALE,
            call,
            lambda speech: (
                f"{speech.client(call.conversation)} began anew at {speech.at(call.request.time)} from the "
                f"same port with serial {call.request.item.serial}, which was answered last, {outcome}; the "
                "official server does not execute such a request"
            ),
            before=before,
        )

    def _look_for_unmarked(self, client: Client, call: Exchange) -> None:
        before, frame = client.last, call.request.item
        if not before.gone_on or before.let_go or not _asks_the_same(before, call) or _may_rest(client):
            return
        arguments = frame.variants
        if request_effect(frame.code, arguments) < Effect.CHANGES:
            return
        self.tell(
            UNMARKED,
            call,
            lambda speech: (
                f"at {speech.at(call.request.time)} {called(call)} repeats {called(before)}, which was not "
                "answered, as if it were new, so that it may be executed twice"
            ),
            before=before,
            because=(before.call,),
        )


def _asks_the_same(one: Exchange, other: Exchange) -> bool:
    return one.request.item.raw[9:] == other.request.item.raw[9:]


def _may_rest(client: Client) -> bool:
    """Tell whether the last call is a set point that the next may equal, as the robot is to stand still."""
    last = client.last
    if command_of(last.question) != "slvmove":
        return False
    earlier = [point for point in client.points if point is not last]
    return not earlier or _asks_the_same(earlier[-1], last)


def _answered_before(before: Exchange, call: Exchange) -> bool:
    """Tell whether a call was answered before another was sent, or may have been."""
    return before.let_go or (before.reply is not None and before.reply.time <= call.request.time)
