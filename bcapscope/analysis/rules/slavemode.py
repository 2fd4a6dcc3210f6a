"""Slave mode entered wrongly, left unawares, or disturbed by another client."""

from __future__ import annotations

from bcapscope.analysis.client import Client, Clients, argument, command_of
from bcapscope.analysis.finding import Severity
from bcapscope.analysis.rules.refusal import Refusal, Why, fixed, refusal
from bcapscope.analysis.rules.rule import MS, OF_ITSELF, SECOND, Incident, Rule, Watcher
from bcapscope.analysis.speech import Speech, called, name_of, shown
from bcapscope.analysis.stay import Call, ExitReason, Stay
from bcapscope.protocol.commands import command
from bcapscope.protocol.effects import Effect, function_effect
from bcapscope.protocol.functions import function_name
from bcapscope.protocol.hresult import E_NOT_IN_SLAVE_MODE, E_REFUSED_IN_SLAVE_MODE
from bcapscope.protocol.slavemode import mode_value
from bcapscope.traffic.exchange import Exchange

_ERRORS = "public list of controller errors in nkawa/Denso_CobottaPro900_MQTT_Control"
_REACH = 60 * SECOND

OUTSIDE = Rule(
    "slvmove-outside-slave-mode",
    Severity.ERROR,
    "slvMove is refused since slave mode is off (83500121)",
    "Look for what switched slave mode off: this is mostly the second error. Stop sending, read the errors, "
    "ClearError, go to the first position, then slvChangeMode.",
    f"DENSORobot/denso_robot_ros issues 6 and 42; {_ERRORS}",
    (
        "underflow",
        "refused-in-slave-mode",
        "slave-mode-ended-by-other",
        "slave-mode-lost-unseen",
        "over-limit",
        "beyond-range",
        "overflow",
        "emergency-stop",
        "motor-off",
        "controller-error",
        "robslave-not-running",
        "not-in-automatic-mode",
        "slave-mode-refused",
        "robot-still-moving",
        "arm-not-taken",
        "arm-taken-by-other",
        "error-not-cleared",
        "no-executable-token",
        "no-licence",
    ),
    _REACH,
)
REFUSED = Rule(
    "refused-in-slave-mode",
    Severity.ERROR,
    "a command is refused since slave mode is on (83501032), and slave mode ends",
    "While slave mode is on call only slvMove, slvGetMode, slvRecvFormat, CurPos, CurJnt and GetSrvData; do "
    "all else (grippers, I/O, error details) before or after, or through the send format; let one process "
    "own the robot.",
    f"DENSORobot/denso_robot_ros issues 13, 21, 42 and 48; {_ERRORS}",
)
BY_OTHER = Rule(
    "slave-mode-ended-by-other",
    Severity.ERROR,
    "another client switched slave mode while this one was sending set points",
    "Let one process own the robot; give the second one only reading calls.",
    "DENSORobot/denso_robot_ros issues 13, 21 and 48",
)
UNSEEN = Rule(
    "slave-mode-lost-unseen",
    Severity.WARNING,
    "slave mode was found off, and nothing that was captured had ended it",
    "Look at the pendant's error log for this moment: an emergency stop, a mode switch, a stopped RobSlave "
    "or a client on another network are not in this capture.",
    f"DENSORobot/denso_robot_ros issues 6 and 42; {_ERRORS}",
    ("late-reply", "client-gave-up", "no-reply", "set-point-gap"),
)
MODE_REFUSED = Rule(
    "slave-mode-refused",
    Severity.ERROR,
    "slvChangeMode is refused for its value",
    "Use 0x001-0x003 or 0x101-0x103, on an RC8 or later also 0x201-0x203, as VT_I4 (VT_I2 on RC7).",
    "DENSO Wave 2009, How to use the Slave mode; ShoheiKobata/orin_bcap_python_samples",
    ("unusual-argument",),
    OF_ITSELF,
)

_NOT_ALLOWED = (E_REFUSED_IN_SLAVE_MODE, 0x8120174E, 0x81500177)
_NEEDS_IT = (E_NOT_IN_SLAVE_MODE, 0x83501033, 0x8120184E)
_SUSPECT_WITHIN = 200 * MS


class SlaveMode(Watcher):
    """Looks at how stays in slave mode ended."""

    rules = (OUTSIDE, REFUSED, BY_OTHER, UNSEEN, MODE_REFUSED)

    def stay(self, stay: Stay) -> None:
        exit_ = stay.exit
        if exit_.reason is ExitReason.OTHER_CLIENT and exit_.by is not None:
            self._ended_by_other(stay, exit_.by)
        elif exit_.reason is ExitReason.FOUND_OFF:
            self._lost_unseen(stay)

    def _ended_by_other(self, stay: Stay, by: Call) -> None:
        def say(speech: Speech) -> str:
            who = speech.client(stay.conversation)
            return (
                f"client {by.client} called {_named(by)} at {speech.at(by.time)} while {who} was in "
                "slave mode"
            )

        def then(speech: Speech, after: int) -> str:
            return f"client {by.client} called {_named(by)}"

        time = stay.exit.time
        frames = (by.request, *(() if by.reply is None else (by.reply,)))
        self.report(Incident(BY_OTHER, by.time, time, stay.conversation, frames, say, then, by.call))

    def _lost_unseen(self, stay: Stay) -> None:
        exit_, last = stay.exit, stay.last
        if last is None:
            return
        suspects = [
            call
            for call in stay.other_calls
            if call.client != stay.conversation.client
            and last.time - _SUSPECT_WITHIN <= call.time < exit_.time
            and not _is_harmless(call)
        ]

        def say(speech: Speech) -> str:
            who, since = speech.client(stay.conversation), speech.at(last.time)
            text = (
                f"slave mode of {who} was off after the set point at {since}, and no call that was seen "
                "had ended it"
            )
            if suspects:
                by = suspects[-1]
                text += (
                    f"; client {by.client} had called {_named(by)} at {speech.at(by.time)}, which may "
                    "be the reason"
                )
            return text

        def then(speech: Speech, after: int) -> str:
            return "slave mode ended"

        frames = (last.frame, *(call.request for call in suspects[-1:]), *exit_.frames[-1:])
        self.report(Incident(UNSEEN, last.time, last.time + 1, stay.conversation, frames, say, then))


def _named(call: Call) -> str:
    return function_name(call.function_id) if call.command is None else shown(call.command)


def _is_harmless(call: Call) -> bool:
    """Tell whether a call only reads, or is known to be allowed in slave mode."""
    if call.command is None:
        return function_effect(call.function_id) < Effect.CHANGES
    known = command(call.function_id, call.command)
    return known is not None and (known.effect < Effect.CHANGES or known.in_slave_mode is True)


def _outside(call: Exchange, client: Client, clients: Clients) -> Why | None:
    ended, entered = client.mode_end, client.mode_call
    if entered is None and ended is None:
        if client.mode is None and not client.seen_from_start:
            return fixed("slave mode was never seen on in this capture")
        return fixed("no slvChangeMode had switched slave mode on")
    if ended is None or (entered is not None and entered.call > ended.call):
        return _off_without_end(call, client, clients)
    if command_of(ended.question) == "slvchangemode":
        return Why(
            lambda speech: (
                f"{called(ended)} of the same client had left slave mode at {speech.at(ended.request.time)}"
            ),
            before=ended,
        )
    return Why(
        lambda speech: f"the error of {called(ended)} had switched slave mode off", because=(ended.call,)
    )


def _off_without_end(call: Exchange, client: Client, clients: Clients) -> Why:
    ends = [each.mode_end for each in clients.others(client)]
    others = [each for each in ends if each is not None and each.request.time <= call.request.time]
    return Why(
        lambda speech: "slave mode had been switched off without this client's doing",
        because=tuple(each.call for each in others),
    )


def _not_allowed(call: Exchange, client: Client, clients: Clients) -> Why | None:
    owner = next((each for each in (*clients.others(client), client) if _was_in_slave_mode(each, call)), None)
    what = name_of(call)

    def say(speech: Speech) -> str:
        who, when = speech.client(call.conversation), speech.at(call.request.time)
        if owner is None:
            whose = "while slave mode was on"
        elif owner is client:
            whose = "while it was in slave mode itself"
        else:
            whose = f"while {speech.client(owner.conversation)} was in slave mode"
        return (
            f"{who} ran {what} at {when} {whose}, which is not allowed (0x{call.hresult or 0:08X}), and "
            "this ends slave mode"
        )

    def then(speech: Speech, after: int) -> str:
        return f"{what} was refused, since slave mode was on, and ended it"

    return Why(say=say, then=then)


def _was_in_slave_mode(client: Client, call: Exchange) -> bool:
    entered, ended = client.mode_call, client.mode_end
    if client.mode:
        return True
    return (
        entered is not None
        and ended is not None
        and entered.call < ended.call
        and ended.request.time >= call.request.time
    )


def _mode_refused(call: Exchange, client: Client, clients: Clients) -> Why | None:
    parameter = argument(call, 2)
    if command_of(call.question) != "slvchangemode" or parameter is None:
        return None
    value = mode_value(parameter)
    return fixed(f"the mode is 0x{value:03X}") if value is not None else fixed("its parameter is no number")


REFUSALS: tuple[Refusal, ...] = (
    refusal(OUTSIDE, _NEEDS_IT, _outside),
    refusal(REFUSED, _NOT_ALLOWED, _not_allowed),
    refusal(MODE_REFUSED, (0x80070057, 0x80020005, 0x80010003, 0x83500127), _mode_refused),
)
