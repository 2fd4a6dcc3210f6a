"""Beginning and end of a session, and calls that take long."""

from __future__ import annotations

import re
from collections.abc import Callable

from bcapscope.analysis.client import Client, Clients, text_argument
from bcapscope.analysis.finding import Severity
from bcapscope.analysis.rules.refusal import Refusal, Why, fixed, refusal
from bcapscope.analysis.rules.rule import SECOND, Incident, Kind, Report, Rule, Watcher, last_time
from bcapscope.analysis.speech import Speech, called, name_of, shown, span, times
from bcapscope.analysis.stay import ExitReason, Stay
from bcapscope.protocol.functions import ID, function_name
from bcapscope.protocol.hresult import E_BUSY, E_CAO_COLLECTION_REGISTERED, E_INVALIDARG
from bcapscope.traffic.exchange import Exchange
from bcapscope.traffic.observation import Conversation, Transport
from bcapscope.traffic.question import Question

_SERVER = "orin_bcap C/src/bCAPServer/bcap_server.c"
_SEED = "DENSO Wave 2009, How to use the Slave mode"
_LONG = SECOND
_SOON = SECOND // 20
"""A reply that comes so soon after a try tells of lost packets before it, not of a long call."""

_FORGOTTEN = 10 * SECOND
_REPLACED = 2 * SECOND
_USUAL_PAUSES = 2
"""A client that was silent before, and went on, has vanished only after so many times as long."""

_SMALLEST_WDT = 80

NOT_STARTED = Rule(
    "service-not-started",
    Severity.ERROR,
    "the first call of a session is not Service_Start, and it is refused",
    "Call Service_Start first, then Controller_Connect, then get the robot.",
    "DENSORobot/denso_robot_ros2 issues 8 and 50; ShoheiKobata/orin_bcap_python_samples",
)
PROVIDER = Rule(
    "provider-refused",
    Severity.ERROR,
    "Controller_Connect is refused for its provider",
    "Use CaoProv.DENSO.VRC for RC8 and COBOTTA, CaoProv.DENSO.VRC9 for RC9 and COBOTTA PRO, with machine "
    "localhost; CaoProv.DENSO.RC8 is a provider for the PC and not for b-CAP.",
    "ShoheiKobata/orin_bcap_python_samples; DENSORobot/denso_robot_ros2 denso_controller",
)
NAME_IN_USE = Rule(
    "name-in-use",
    Severity.ERROR,
    "Controller_Connect is refused since the name is in use",
    "Connect with another name, an empty one, or the option @IfNotMember; the name stays in use until the "
    "client that has it disconnects or is dropped.",
    "orin_bcap C/include/dn_common.h (E_CAO_COLLECTION_REGISTERED)",
    ("unclean-quit",),
    3600 * SECOND,
)
UNCLEAN = Rule(
    "unclean-quit",
    Severity.WARNING,
    "a client vanished or began anew without closing its session",
    "Release all objects, then Controller_Disconnect and Service_Stop on every way out of the "
    "program, also after an "
    "error; a client that is left open can keep its place for hours (on an RC7 press Reset on the pendant).",
    f"{_SEED}, Setting up your RC7; start-jsk/denso issue 93; {_SERVER}",
    ("client-stopped", "no-reply", "client-gave-up"),
    60 * SECOND,
)
IN_SLAVE_MODE = Rule(
    "quit-in-slave-mode",
    Severity.WARNING,
    "a client let go, or vanished, while slave mode was on",
    "Call slvChangeMode 0 before anything is released and before the program ends.",
    f"{_SEED}, Quitting or stopping your client application",
    ("controller-hung-up", "client-stopped", "no-reply", "client-gave-up"),
)
BUSY = Rule(
    "busy",
    Severity.ERROR,
    "calls are refused since an earlier call is still running",
    "Wait for the reply to the long call (S_EXECUTING says that it goes on) before the next one; after "
    "InvokeTimeout none comes, and only a new connection helps.",
    _SERVER,
    ("executing-forever", "no-reply", "client-gave-up", "long-call-without-wdt", "late-reply"),
    600 * SECOND,
)
FOREVER = Rule(
    "executing-forever",
    Severity.ERROR,
    "the controller said S_EXECUTING and then never answered",
    "Look for what the call waits for; raise InvokeTimeout in Service_Start if it is only slow: when that "
    "expires no answer is ever sent.",
    _SERVER,
)
NO_WDT = Rule(
    "long-call-without-wdt",
    Severity.WARNING,
    "a long call outlived the client's patience, and no WDT was asked for",
    "Put ,WDT=400 into the option of Service_Start: the controller then says S_EXECUTING every 400 ms while "
    "a call runs, and the client keeps waiting.",
    _SERVER,
)
SMALL_WDT = Rule(
    "wdt-too-small",
    Severity.ERROR,
    "Service_Start is refused for a WDT or InvokeTimeout below 80 ms",
    "Ask for WDT=80 or more; 400 is usual.",
    _SERVER,
)

_OPTION = re.compile(r"(WDT|InvokeTimeout)\s*=\s*([0-9]{1,9})", re.IGNORECASE)


class Session(Watcher):
    """Looks at how sessions end and how long calls take."""

    rules = (UNCLEAN, IN_SLAVE_MODE, FOREVER, NO_WDT)

    def __init__(self, report: Report, clients: Clients) -> None:
        super().__init__(report, clients)
        self._silent: dict[Conversation, Stay] = {}

    def heeds(self, question: Question, kind: Kind) -> bool:
        return kind is not Kind.SMOOTH or question.function_id == ID["Service_Start"]

    def call(self, call: Exchange, client: Client) -> None:
        if (
            call.question.function_id == ID["Service_Start"]
            and client.service is not None
            and client.open_session
            and not client.last.let_go
        ):
            self._restarted(client, call)
        if call.notices:
            if call.reply is None and call.given_up:
                self._forever(call)
        elif client.service is not None and not _has_wdt(client.service):
            self._look_for_long(call, client.service)

    def stay(self, stay: Stay) -> None:
        if stay.exit.reason is ExitReason.DISCONNECTED:
            self._left_on(stay)
        elif stay.exit.reason is ExitReason.SILENT and self.clients.find(stay.conversation) is not None:
            self._silent[stay.conversation] = stay  # until that client is said goodbye to

    def _left_on(self, stay: Stay) -> None:
        exit_ = stay.exit
        mode = f" 0x{stay.mode.value:03X}" if stay.mode.value is not None else ""

        def say(speech: Speech) -> str:
            who, when = speech.client(stay.conversation), speech.at(exit_.time)
            if exit_.by is not None:
                what = f"called {shown(exit_.by.command or function_name(exit_.by.function_id))}"
                return f"{who} {what} at {when} while slave mode{mode} was on"
            return f"{who} sent no more set points after {when} and left slave mode{mode} on"

        def then(speech: Speech, after: int) -> str:
            return f"slave mode{mode} was left on"

        frames = exit_.frames or ((stay.last.frame,) if stay.last is not None else ())
        self.report(Incident(IN_SLAVE_MODE, exit_.time, exit_.time, stay.conversation, frames, say, then))

    def gone(self, client: Client, ended: int) -> None:
        stay = self._silent.pop(client.conversation, None)
        if client.present or client.last.let_go:  # it may have ended in order
            return
        if stay is not None and ended - stay.exit.time >= _FORGOTTEN:
            self._left_on(stay)
        if client.hung_up or not client.open_session:
            return
        silent = last_time(client.last)
        follower = _follower(client, self.clients, silent)
        quiet = max((last_time(each.last) for each in self.clients), default=silent) - silent
        patience = max(_FORGOTTEN, _USUAL_PAUSES * client.longest_pause)
        if quiet < (_REPLACED if follower is not None else patience):
            return

        def say(speech: Speech) -> str:
            text = (
                f"{speech.client(client.conversation)} said nothing after {speech.at(silent)} and had "
                "not closed its session"
            )
            if follower is not None:
                came = span(follower.first.request.time - silent)
                return f"{text}; {follower.conversation.client} began a new one {came} later"
            return f"{text}, while others went on for {span(quiet)}"

        frames = (client.last.last.number,)
        self._unclean(client.last, silent, say, frames)

    def _restarted(self, client: Client, call: Exchange) -> None:
        pause = call.request.time - last_time(client.last)

        def say(speech: Speech) -> str:
            who, when = speech.client(call.conversation), speech.at(call.request.time)
            return (
                f"{who} began a new session at {when}, {span(pause)} after its last call, without "
                "closing the one before"
            )

        frames = (client.last.last.number, call.request.number)
        self._unclean(client.last, call.request.time, say, frames)

    def _unclean(
        self, last: Exchange, time: int, say: Callable[[Speech], str], frames: tuple[int, ...]
    ) -> None:
        def then(speech: Speech, after: int) -> str:
            return f"{speech.client(last.conversation)} did not close its session"

        self.report(Incident(UNCLEAN, time, time, last.conversation, frames, say, then, because=(last.call,)))

    def _forever(self, call: Exchange) -> None:
        notices = call.notices

        def say(speech: Speech) -> str:
            lasted = span(notices[-1].time - call.request.time)
            return (
                f"at {speech.at(call.request.time)} {called(call)} of "
                f"{speech.client(call.conversation)} was never answered: the controller said S_EXECUTING "
                f"{times(len(notices))}, the last time {lasted} after the request"
            )

        def then(speech: Speech, after: int) -> str:
            return f"{called(call)} was never answered"

        self.tell(FOREVER, call, say, then, time=notices[-1].time)

    def _look_for_long(self, call: Exchange, service: Exchange) -> None:
        replies = call.late_replies if call.reply is None else (call.reply,) if call.retries else ()
        if not replies:
            return
        last = max(replies, key=lambda reply: reply.time)
        took, waited = last.time - call.request.time, last.time - call.answered_by(last).time
        if took < _LONG or waited < _SOON:
            return

        def say(speech: Speech) -> str:
            when, who = speech.at(call.request.time), speech.client(call.conversation)
            if not call.retries:
                return (
                    f"at {when} {name_of(call)} was answered after {span(took)}, when {who} had given "
                    f"{called(call)} up, and Service_Start asked for no WDT"
                )
            return (
                f"at {when} {name_of(call)} was answered after {span(took)}, {span(waited)} after the try "
                f"that was answered, {who} sent {called(call)} {times(len(call.requests))} meanwhile, and "
                "Service_Start asked for no WDT"
            )

        self.tell(NO_WDT, call, say, before=service, began=call.request.time, time=call.request.time)


def _has_wdt(service: Exchange) -> bool:
    return any(match[1].casefold() == "wdt" for match in _OPTION.finditer(text_argument(service, 0)))


def _follower(client: Client, clients: Clients, since: int) -> Client | None:
    """Return a client of the same machine that began a session after this one fell silent."""
    host = client.conversation.client.host
    for other in clients.others(client):
        first = other.first
        if (
            other.conversation.client.host == host
            and first.request.time > since
            and first.question.function_id == ID["Service_Start"]
        ):
            return other
    return None


def _not_started(call: Exchange, client: Client, clients: Clients) -> Why | None:
    is_first = not client.calls and call.request.item.serial <= 2
    if not is_first or call.question.function_id == ID["Service_Start"]:
        return None
    return fixed("it is the first call of the session, and that should be Service_Start")


def _small_wdt(call: Exchange, client: Client, clients: Clients) -> Why | None:
    if call.question.function_id != ID["Service_Start"]:
        return None
    small = [match for match in _OPTION.finditer(text_argument(call, 0)) if int(match[2]) < _SMALLEST_WDT]
    return fixed(f"its option asks for {small[0][0]}, and 80 ms is the least") if small else None


def _provider(call: Exchange, client: Client, clients: Clients) -> Why | None:
    if call.question.function_id != ID["Controller_Connect"]:
        return None
    provider, machine = text_argument(call, 1), text_argument(call, 2)
    return fixed(f"provider '{shown(provider)}', machine '{shown(machine)}'")


def _name_in_use(call: Exchange, client: Client, clients: Clients) -> Why | None:
    if call.question.function_id != ID["Controller_Connect"]:
        return None
    name = text_argument(call, 0)
    for other in (client, *clients.others(client)):
        connected = other.connected
        if connected is not None and text_argument(connected, 0) == name:
            return _held_by(other, connected, name)
    return fixed(f"the name is '{shown(name)}', perhaps left by a client that is gone")


def _held_by(client: Client, connected: Exchange, name: str) -> Why:
    def text(speech: Speech) -> str:
        who, when = speech.client(client.conversation), speech.at(connected.request.time)
        return f"{who} connected as '{shown(name)}' at {when} and did not disconnect"

    return Why(text, before=connected)


def _busy(call: Exchange, client: Client, clients: Clients) -> Why | None:
    running = _running(client, call)
    if running is not None:
        since = span(call.request.time - running.request.time)
        return Why(
            lambda speech: f"{called(running)}, sent {since} before, had no answer yet",
            because=(running.call,),
            before=running,
        )
    for each in clients.others(client):
        other = _running(each, call)
        if other is not None and _share_a_slot(other, call):
            return _busy_for(other, call)
    return fixed("which one was not seen")


def _busy_for(other: Exchange, call: Exchange) -> Why:
    since = span(call.request.time - other.request.time)
    return Why(
        lambda speech: (
            f"perhaps since {called(other)} of {speech.client(other.conversation)}, sent {since} before, had "
            "no answer yet: over UDP the official server runs one call at a time for all clients"
        ),
        because=(other.call,),
        before=other,
    )


def _share_a_slot(one: Exchange, other: Exchange) -> bool:
    """Tell whether a call can hold up one of another client: each TCP connection has a slot of its own."""
    ends = one.conversation, other.conversation
    return all(each.transport is Transport.UDP for each in ends) and ends[0].server == ends[1].server


def _running(client: Client, call: Exchange) -> Exchange | None:
    """Return the latest slow call of a client, if it may still have been running when another was sent."""
    slow = client.unanswered
    return slow if slow is not None and _runs(slow, call) else None


def _runs(earlier: Exchange, call: Exchange) -> bool:
    """Tell whether a call may still have been running when another was sent."""
    begun = earlier.request.time <= call.request.time
    return begun and (earlier.reply is None or earlier.reply.time > call.request.time)


REFUSALS: tuple[Refusal, ...] = (
    refusal(SMALL_WDT, (E_INVALIDARG,), _small_wdt),
    refusal(NAME_IN_USE, (E_CAO_COLLECTION_REGISTERED,), _name_in_use),
    refusal(PROVIDER, (E_INVALIDARG, 0x80000201, 0x80000202, 0x80000208, 0x80000209), _provider),
    refusal(NOT_STARTED, (), _not_started),
    refusal(BUSY, (E_BUSY,), _busy),
)
