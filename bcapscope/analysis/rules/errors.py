"""Errors of the controller: not cleared, cleared unread, and all that no other rule tells."""

from __future__ import annotations

from bcapscope.analysis.client import Client, Clients, command_of
from bcapscope.analysis.finding import Severity
from bcapscope.analysis.rules.refusal import Refusal, Why, refusal
from bcapscope.analysis.rules.rule import SECOND, Kind, Report, Rule, Watcher
from bcapscope.analysis.speech import Speech, called
from bcapscope.protocol.commands import command
from bcapscope.protocol.effects import Effect, function_effect
from bcapscope.protocol.guard import always_passes
from bcapscope.protocol.hresult import E_ROBOTISBUSY, E_TIMEOUT, describe
from bcapscope.protocol.wording import counted
from bcapscope.traffic.exchange import Exchange
from bcapscope.traffic.observation import Conversation
from bcapscope.traffic.question import Question

_SEED = "DENSO Wave 2009, How to use the Slave mode"
_ERRORS = "public list of controller errors in nkawa/Denso_CobottaPro900_MQTT_Control"
_EVER = 24 * 3600 * SECOND
_FIRST_ERRORS = (
    "underflow",
    "over-limit",
    "beyond-range",
    "overflow",
    "invalid-set-point",
    "refused-in-slave-mode",
    "slvmove-outside-slave-mode",
    "emergency-stop",
    "controller-error",
)

NOT_CLEARED = Rule(
    "error-not-cleared",
    Severity.ERROR,
    "a call is refused since an error is active (81501025 and the like)",
    "Read the errors (GetCurErrorCount, GetCurErrorInfo), then ClearError, then go on with Motor, the first "
    "position and slvChangeMode.",
    f"{_SEED}, Clearing errors; {_ERRORS}",
    _FIRST_ERRORS,
    _EVER,
)
WENT_ON = Rule(
    "went-on-after-error",
    Severity.WARNING,
    "after an error the client went on with calls that change or move something, and never called ClearError",
    "Stop at the first error, then follow the sequence: ClearError, restart RobSlave (RC7), first position, "
    "slvChangeMode.",
    f"{_SEED}, Error, and the sequence of clearing error",
    _FIRST_ERRORS,
    _EVER,
)
UNREAD = Rule(
    "cleared-unread",
    Severity.WARNING,
    "ClearError was called before the error was read, and the evidence is gone",
    "Leave slave mode, read GetCurErrorCount and GetCurErrorInfo and keep them, and only then call "
    "ClearError; in slave mode itself error details are refused.",
    "nkawa/Denso_CobottaPro900_MQTT_Control",
    (*_FIRST_ERRORS, "motor-off", "arm-not-taken", "error-not-cleared"),
    _EVER,
)
TIMEOUT = Rule(
    "controller-timeout",
    Severity.ERROR,
    "the controller itself reports a time-out (80000900 and the like in a reply)",
    "Look at what the controller waited for: this time-out is not the client's.",
    f"orin_bcap C/include/dn_common.h; {_ERRORS}",
)
ROBOT_BUSY = Rule(
    "robot-busy",
    Severity.NOTE,
    "calls are refused with 80010004, robot is busy",
    "Repeat the call a little later, or wait for the end of the motion.",
    "start-jsk/denso denso_controller/src/main.cpp",
)
OTHER = Rule(
    "controller-error",
    Severity.ERROR,
    "any other refusal, by its code",
    "See what the code says, and the controller's error log for the same moment.",
    f"{_ERRORS}; orin_bcap C/include/dn_common.h",
    ("malformed-request",),
)

_ACTIVE_CODES = (0x81501025, 0x81201701, 0x81201749, 0x82501009, 0x21D3, 0x800021D3)
_TIMEOUT_CODES = (E_TIMEOUT, 0x8150012D, 0x81500151, 0x82201F92, 0x82201694, 0x800706BE)


class _WentOn:
    """What a client did after an error that it has not cleared."""

    def __init__(self, failure: Exchange) -> None:
        self.failure = failure
        self.count = 0
        self.first: Exchange | None = None


class Errors(Watcher):
    """Looks at what a client does after an error."""

    rules = (WENT_ON, UNREAD)

    def __init__(self, report: Report, clients: Clients) -> None:
        super().__init__(report, clients)
        self._went_on: dict[Conversation, _WentOn] = {}

    def heeds(self, question: Question, kind: Kind) -> bool:
        name = command_of(question)
        if name == "slvmove":
            return kind is not Kind.SMOOTH
        if name:
            known = command(question.function_id, name)
            return known is None or known.effect >= Effect.CHANGES
        return function_effect(question.function_id) >= Effect.CHANGES

    def call(self, call: Exchange, client: Client) -> None:
        failure = client.failure
        if failure is None:
            return
        if command_of(call.question) == "clearerror":
            self._went_on.pop(call.conversation, None)
            if call.reply is not None and not client.error_read and not self._read_by_other(client):
                self._unread(call, failure)
            return
        story = self._went_on.get(call.conversation)
        if story is None or story.failure is not failure:
            story = self._went_on[call.conversation] = _WentOn(failure)
        if call.request.time > failure.request.time and not _stops(call):
            story.count += 1
            story.first = story.first or call

    def gone(self, client: Client, ended: int) -> None:
        story = self._went_on.pop(client.conversation, None)
        if story is None or story.first is None or story.failure is not client.failure:
            return
        failure, count, first = story.failure, story.count, story.first

        def say(speech: Speech) -> str:
            who = speech.client(client.conversation)
            return (
                f"after the error of {called(failure)} {who} made {counted(count, 'more call')} that "
                f"can change or move something, from {called(first)} on, and never called ClearError"
            )

        self.tell(WENT_ON, first, say, before=failure, because=(failure.call,))

    def _read_by_other(self, client: Client) -> bool:
        return any(other.error_read for other in self.clients.others(client))

    def _unread(self, call: Exchange, failure: Exchange) -> None:
        def say(speech: Speech) -> str:
            code = failure.hresult or 0
            who, when = speech.client(call.conversation), speech.at(call.request.time)
            return (
                f"{who} called ClearError at {when} without having read the errors behind 0x{code:08X} "
                f"of {called(failure)}"
            )

        self.tell(UNREAD, call, say, before=failure, because=(failure.call,))


def _stops(call: Exchange) -> bool:
    """Tell whether a call only stops or lets go, which is right after an error."""
    return always_passes(call.question.function_id, [each.variant for each in call.request.item.arguments])


def _not_cleared(call: Exchange, client: Client, clients: Clients) -> Why | None:
    failure = client.failure
    if failure is None:
        first = [other.failure for other in clients.others(client) if other.failure is not None]
        return Why(because=tuple(each.call for each in first))
    return Why(
        lambda speech: f"the error of {called(failure)} at {speech.at(failure.request.time)} was not cleared",
        because=(failure.call,),
        before=failure,
    )


def _other(call: Exchange, client: Client, clients: Clients) -> Why | None:
    code = call.hresult or 0
    known = describe(code)
    failure = client.failure
    because = (failure.call,) if failure is not None and known.level is not None else ()
    return Why(
        because=because,
        key=f"{code:08X}",
        advice=f"{known.advice[:1].upper()}{known.advice[1:]}." if known.advice else "",
    )


REFUSALS: tuple[Refusal, ...] = (
    refusal(NOT_CLEARED, _ACTIVE_CODES, _not_cleared),
    refusal(TIMEOUT, _TIMEOUT_CODES),
    refusal(ROBOT_BUSY, (E_ROBOTISBUSY,)),
    refusal(OTHER, (), _other),
)
