"""Rules about the start and the end of a session, and about calls that take long."""

from __future__ import annotations

import re
from collections.abc import Iterator

from bcapscope.analysis.call_arguments import text_argument
from bcapscope.analysis.client_state import MOTION_FUNCTIONS, ClientState
from bcapscope.analysis.finding_places import call_place, call_places, client_place
from bcapscope.analysis.rules.rule_checker import (
    SECOND,
    CallHealth,
    ClientEnd,
    Occurrence,
    Refusal,
    RefusalReason,
    RobotImpact,
    RuleChecker,
    last_frame_time,
    reason_from_call,
)
from bcapscope.analysis.slave.slave_session import ExitReason, SlaveSession
from bcapscope.messages import Message
from bcapscope.messages.message import PlaceValue
from bcapscope.messages.places import Count, Duration, Moment, Times, WireText
from bcapscope.protocol.tables.function_table import ID, function_name
from bcapscope.protocol.tables.hresult import (
    E_ACCESSDENIED,
    E_BUSY,
    E_CAO_COLLECTION_REGISTERED,
    E_FAIL,
    E_HANDLE,
    E_INVALIDARG,
    E_NOT_CONNECTED,
    E_UNEXPECTED,
    describe_hresult,
    is_rc7_code,
)
from bcapscope.traffic.call import Call
from bcapscope.traffic.call_kind import CallKind
from bcapscope.traffic.observation import Transport

_LONG_CALL_NS = SECOND
_SOON_NS = SECOND // 20
"""If the controller answered an attempt within this time in ns, the controller was not slow. The call took
long only because earlier attempts or their replies were lost.
"""

_SILENT_NS = 10 * SECOND
_REPLACED_AFTER_NS = 2 * SECOND
_USUAL_PAUSES = 2
"""A client counts as gone only if its silence is at least this many times its longest earlier pause."""

_SMALLEST_WDT_MS = 80

_OPTION = re.compile(r"(WDT|InvokeTimeout)\s*=\s*([0-9]{1,9})", re.IGNORECASE)

_NOT_STARTED_CODES = (E_NOT_CONNECTED, E_HANDLE, E_FAIL, E_UNEXPECTED, E_ACCESSDENIED, 0x80000903)


class SessionChecker(RuleChecker):
    def wants_call(self, call_kind: CallKind, health: CallHealth) -> bool:
        return health is not CallHealth.SMOOTH or call_kind.function_id == ID["Service_Start"]

    def on_call(self, call: Call, client: ClientState) -> None:
        if (
            call.kind.function_id == ID["Service_Start"]
            and client.service_start is not None
            and client.has_open_session
            and not client.last_call.evicted
        ):
            self._report_restart(client, call)
        if call.notices:
            if call.reply is None and call.surely_unanswered:
                self._report_executing_forever(call)
        elif client.service_start is not None and not _has_wdt(client.service_start):
            self._check_long_call(call, client.service_start)

    def session_occurrences(self, session: SlaveSession) -> Iterator[Occurrence]:
        if session.exit.reason is ExitReason.DISCONNECTED and not _may_have_left(session):
            yield _left_on(session)

    def end_occurrences(self, end: ClientEnd) -> Iterator[Occurrence]:
        client, session = end.client, end.silent_session
        if end.known_present or client.last_call.evicted:  # the evicted call may have ended the session
            return
        if session is not None and end.ended_at - session.exit.time >= _SILENT_NS:
            yield _left_on(session)
        if client.has_open_session and not client.controller_closing:
            yield from self._unclosed_session(client)

    def _unclosed_session(self, client: ClientState) -> Iterator[Occurrence]:
        silent = last_frame_time(client.last_call)
        follower = _successor(client, silent)
        conversation = client.conversation
        stays_connected = conversation.transport is Transport.TCP and conversation.connection_end is None
        if stays_connected and follower is None:
            return  # if the client program had ended, its computer would have closed the TCP connection
        quiet = max((last_frame_time(each.last_call) for each in self.clients), default=silent) - silent
        patience = max(_SILENT_NS, _USUAL_PAUSES * client.longest_pause_ns)
        if quiet < (_REPLACED_AFTER_NS if follower is not None else patience):
            return

        places = {"client": client_place(client.conversation), "at": Moment(silent)}
        if follower is None:
            fact = Message("finding.unclean-quit.silent", **places, quiet=Duration(quiet))
        else:
            after = Duration(follower.first_call.request.time - silent)
            successor = str(follower.conversation.client)
            fact = Message("finding.unclean-quit.replaced", **places, successor=successor, after=after)
        yield _unclean_quit(client.last_call, silent, fact, (client.last_call.last_attempt.number,))

    def _report_restart(self, client: ClientState, call: Call) -> None:
        fact = Message(
            "finding.unclean-quit.restarted",
            client=client_place(call.conversation),
            at=Moment(call.request.time),
            pause=Duration(call.request.time - last_frame_time(client.last_call)),
        )
        frames = (client.last_call.last_attempt.number, call.request.number)
        self.report_occurrence(_unclean_quit(client.last_call, call.request.time, fact, frames))

    def _report_executing_forever(self, call: Call) -> None:
        notices = call.notices
        fact = Message(
            "finding.executing-forever",
            **call_places(call),
            times=Times(len(notices)),
            lasted=Duration(notices[-1].time - call.request.time),
        )
        clause = Message("clause.executing-forever", call=call_place(call))
        self.report_call("executing-forever", call, fact, clause, completed=notices[-1].time)

    def _check_long_call(self, call: Call, service: Call) -> None:
        replies = call.late_replies if call.reply is None else (call.reply,) if call.retries else ()
        if not replies:
            return
        last = max(replies, key=lambda reply: reply.time)
        took, waited = last.time - call.request.time, last.time - call.attempt_answered_by(last).time
        if took < _LONG_CALL_NS or waited < _SOON_NS:
            return

        case = ".retried" if call.retries else ""
        fact = Message(
            f"finding.long-call-without-wdt{case}",
            **call_places(call),
            took=Duration(took),
            waited=Duration(waited),
            attempts=Count(len(call.attempts), "attempt"),
        )
        impact = RobotImpact.PREVENTED if call.kind.function_id in MOTION_FUNCTIONS else RobotImpact.NONE
        rule, ended = "long-call-without-wdt", call.request.time
        self.report_call(rule, call, fact, evidence_call=service, completed=ended, impact=impact)


def _may_have_left(session: SlaveSession) -> bool:
    """Return whether the client called slvChangeMode after its last set point, but no reply was captured."""
    last = session.last_set_point
    return any(
        call.reply_frame is None and call.command is not None and call.command.casefold() == "slvchangemode"
        for call in session.other_calls
        if call.client == session.conversation.client and last is not None and call.time > last.time
    )


def _surely_on(session: SlaveSession) -> bool:
    """Return whether a captured reply shows that slave mode was on."""
    entry = session.entry_call
    entered = entry is not None and entry.hresult is not None
    return entered or session.counts.accepted > 0 or session.mode.known_by == "slvGetMode"


def _left_on(session: SlaveSession) -> Occurrence:
    end, mode = session.exit, session.mode.value
    name = Message("slave-mode") if mode is None else Message("slave-mode.mode", mode=f"0x{mode:03X}")
    places: dict[str, PlaceValue] = {
        "client": client_place(session.conversation),
        "at": Moment(end.time),
        "mode": name,
    }
    if end.by is None:
        fact = Message("finding.quit-in-slave-mode.silent", **places)
    else:
        command = WireText(end.by.command or function_name(end.by.function_id))
        fact = Message("finding.quit-in-slave-mode.call", **places, command=command)
    impact = RobotImpact.STOPPED
    if not _surely_on(session):
        fact = Message("finding.quit-in-slave-mode.guess", fact=fact, mode=name)
        impact = RobotImpact.NONE
    clause = Message("clause.quit-in-slave-mode", mode=name)
    last, entry = session.last_set_point, session.entry_call
    frames = end.frames
    if not frames and last is not None:
        frames = (last.frame,)
    elif not frames and entry is not None:
        frames = (entry.request_frame,)
    where = session.conversation
    return Occurrence("quit-in-slave-mode", end.time, end.time, where, frames, fact, clause, impact=impact)


def _unclean_quit(last: Call, time: int, fact: Message, frames: tuple[int, ...]) -> Occurrence:
    client, causes = last.conversation, (last.number,)
    clause = Message("clause.unclean-quit", client=client_place(client))
    return Occurrence("unclean-quit", time, time, client, frames, fact, clause, explaining_calls=causes)


def _has_wdt(service: Call) -> bool:
    return any(match[1].casefold() == "wdt" for match in _OPTION.finditer(text_argument(service, 0)))


def _successor(client: ClientState, since: int) -> ClientState | None:
    """Return another client with the same IP address that began a session after this client fell silent."""
    host = client.conversation.client.host
    for other in client.other_clients():
        first = other.first_call
        if (
            other.conversation.client.host == host
            and first.request.time > since
            and first.kind.function_id == ID["Service_Start"]
        ):
            return other
    return None


def _explain_not_started(call: Call, client: ClientState) -> RefusalReason | None:
    code = call.hresult or 0
    if call.kind.function_id == ID["Service_Start"] or is_rc7_code(code):
        return None
    if describe_hresult(code).level is not None:
        return None  # the controller sends codes with an error level only in an open session
    start = client.failed_start
    if start is not None:
        case = "refused" if start.hresult else "serial-zero"
        return reason_from_call(f"reason.start.{case}", start)
    is_first = not client.call_count and call.request.item.serial <= 2 and code in _NOT_STARTED_CODES
    return RefusalReason(Message("reason.first-call")) if is_first else None


def _explain_small_wdt(call: Call, client: ClientState) -> RefusalReason | None:
    if call.kind.function_id != ID["Service_Start"]:
        return None
    small = [match for match in _OPTION.finditer(text_argument(call, 0)) if int(match[2]) < _SMALLEST_WDT_MS]
    return RefusalReason(Message("reason.wdt", option=small[0][0])) if small else None


def _explain_provider(call: Call, client: ClientState) -> RefusalReason | None:
    if call.kind.function_id != ID["Controller_Connect"]:
        return None
    provider, machine = text_argument(call, 1), text_argument(call, 2)
    return RefusalReason(Message("reason.provider", provider=WireText(provider), machine=WireText(machine)))


def _explain_name_in_use(call: Call, client: ClientState) -> RefusalReason | None:
    if call.kind.function_id != ID["Controller_Connect"]:
        return None
    name = text_argument(call, 0)
    for other in (client, *client.other_clients()):
        connected = other.connect_call if other.session_end is None else None
        if connected is not None and text_argument(connected, 0) == name:
            reason = Message(
                "reason.name-in-use",
                holder=client_place(other.conversation),
                name=WireText(name),
                at=Moment(connected.request.time),
            )
            return RefusalReason(reason, evidence_call=connected)
    return RefusalReason(Message("reason.name-left", name=WireText(name)))


def _explain_busy(call: Call, client: ClientState) -> RefusalReason | None:
    running = _running_call(client, call)
    if running is not None:
        return _busy_with(running, call, "reason.busy")
    for each in client.other_clients():
        other = _running_call(each, call)
        if other is not None and _share_call_slot(other, call):
            return _busy_with(other, call, "reason.busy-with-other-client")
    return RefusalReason(Message("reason.busy-unseen"))


def _busy_with(running: Call, call: Call, id: str) -> RefusalReason:
    reason = Message(
        id,
        running=call_place(running),
        owner=client_place(running.conversation),
        before=Duration(call.request.time - running.request.time),
    )
    return RefusalReason(reason, explaining_calls=(running.number,), evidence_call=running)


def _share_call_slot(one: Call, other: Call) -> bool:
    """Return whether two calls go over UDP to the same address, so that one can delay the other."""
    ends = one.conversation, other.conversation
    return all(each.transport is Transport.UDP for each in ends) and ends[0].server == ends[1].server


def _running_call(client: ClientState, call: Call) -> Call | None:
    """Return the latest slow call of `client` if `call` began, or may have begun, during this slow call."""
    slow = client.slow_call
    if slow is None or slow.request.time > call.request.time:
        return None
    return slow if slow.reply is None or slow.reply.time > call.request.time else None


_PROVIDER_CODES = (E_INVALIDARG, 0x80000201, 0x80000202, 0x80000208, 0x80000209)

REFUSALS: tuple[Refusal, ...] = (
    Refusal("wdt-too-small", (E_INVALIDARG,), _explain_small_wdt),
    Refusal("name-in-use", (E_CAO_COLLECTION_REGISTERED,), _explain_name_in_use),
    Refusal("provider-refused", _PROVIDER_CODES, _explain_provider),
    Refusal("service-not-started", (), _explain_not_started),
    Refusal("busy", (E_BUSY,), _explain_busy),
)
