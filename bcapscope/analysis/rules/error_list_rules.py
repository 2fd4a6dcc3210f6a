"""Report errors from the controller's error list as causes of earlier refusals that name no cause.

For example, the code 84201486 says only that the controller abandoned set points because of an earlier error.
"""

from __future__ import annotations

from collections import deque
from typing import NamedTuple

from bcapscope.analysis.call_arguments import first_number
from bcapscope.analysis.client_state import ClientState
from bcapscope.analysis.finding_places import call_place, client_place, code_place
from bcapscope.analysis.rules.error_rules import ACTIVE_CODES, advice_on_code
from bcapscope.analysis.rules.refusal_checker import REFUSALS
from bcapscope.analysis.rules.rule_checker import (
    CallHealth,
    Occurrence,
    RuleChecker,
    frame_numbers,
    last_frame_time,
)
from bcapscope.messages import Message
from bcapscope.messages.places import Moment
from bcapscope.protocol.tables.function_table import ID
from bcapscope.protocol.tables.hresult import describe_hresult, ends_slave_mode, is_failure, is_rc7_code
from bcapscope.traffic.bounded_dict import BoundedDict
from bcapscope.traffic.call import Call
from bcapscope.traffic.call_kind import CallKind
from bcapscope.traffic.observation import Conversation
from bcapscope.traffic.slave_mode_tracker import SLAVE_MODE_OFF_CODES

_ABANDONED = 0x84201486
"""The controller abandoned set points because of an earlier error."""

_NAMES_NO_CAUSE = SLAVE_MODE_OFF_CODES | ACTIVE_CODES | {_ABANDONED}
"""Codes that say that another error occurred, without naming that error."""

_LASTING = (
    *("emergency-stop", "not-in-automatic-mode", "no-executable-token", "no-licence"),
    "manual-reset-missing",
)
"""Rules about problems that ClearError does not end. Only these problems explain `ACTIVE_CODES`."""

_MAX_CONTROLLERS = 256
_MAX_CLIENTS = 32
_MAX_READS = 64
_MAX_CLEARS = 16
_MAX_CODES = 64
_LARGEST_CALL = 8192
"""Maximum size in bytes of the frames of a remembered call; a real call has a few hundred bytes."""


class _ErrorRead(NamedTuple):
    code: int
    call: Call


class _RefusedCalls:
    """The refused calls of one client since errors were last cleared.

    Attributes:
        began: Earliest possible time of the error that caused the first refusal, ns since 1970. If the first
            refused call is a set point, `began` is the time of the previous set point.
        reported: For each reported error code, the call with which a client read this code.
    """

    def __init__(self, first: Call, code: int, client: ClientState) -> None:
        self.first = first
        points = client.recent_set_points
        follows_points = first.kind.folded_command == "slvmove" and points
        self.began = points[-1].request.time if follows_points else first.request.time
        self.codes = {code}
        self.names_no_cause = code in _NAMES_NO_CAUSE
        self.own_code_read = False
        self.reported: dict[int, Call] = {}

    def may_follow_from(self, rule: str, code: int) -> bool:
        """Return whether the error `code`, which `rule` reports, may explain the first refused call."""
        is_notice = not describe_hresult(code).level and rule == "controller-error"
        only_listed = self.first.hresult in ACTIVE_CODES and rule not in _LASTING
        return not is_notice and not only_listed and (self.names_no_cause or self.own_code_read)


class _ControllerErrors:
    def __init__(self) -> None:
        self.refused: BoundedDict[Conversation, _RefusedCalls] = BoundedDict(_MAX_CLIENTS)
        self.reads: deque[_ErrorRead] = deque(maxlen=_MAX_READS)
        self.clears: deque[int] = deque(maxlen=_MAX_CLEARS)

    def cleared_between(self, start: int, end: int) -> bool:
        return any(start < time < end for time in self.clears)


class ErrorListChecker(RuleChecker):
    """Reports errors that a client read with GetCurErrorInfo or @ERROR_CODE and that explain a refusal.

    `on_call` may get a refused call after it got another client's call that read the error. Therefore the
    checker also compares each new refusal with the latest errors that clients read.
    """

    def set_up(self) -> None:
        self._controllers: BoundedDict[str, _ControllerErrors] = BoundedDict(_MAX_CONTROLLERS)

    def wants_call(self, call_kind: CallKind, health: CallHealth) -> bool:
        if health is CallHealth.REFUSED:
            return True
        reads = call_kind.function_id == ID["Variable_GetValue"]
        return reads or call_kind.folded_command in ("getcurerrorinfo", "clearerror")

    def on_call(self, call: Call, client: ClientState) -> None:
        code = call.hresult
        if code is None or call.memory_bytes > _LARGEST_CALL:
            return
        errors = self._errors_of(call.conversation.server.host)
        if is_failure(code):
            self._add_refusal(errors, call, code, client)
        elif call.kind.folded_command == "clearerror":
            errors.clears.append(call.request.time)
        else:
            read = _read_error(call, client)
            if read is not None:
                errors.reads.append(read)
                for refused in list(errors.refused.values()):
                    self._compare(errors, refused, read)

    def _errors_of(self, host: str) -> _ControllerErrors:
        errors = self._controllers.get(host)
        if errors is None:
            errors = self._controllers[host] = _ControllerErrors()
        return errors

    def _add_refusal(self, errors: _ControllerErrors, call: Call, code: int, client: ClientState) -> None:
        if code not in _NAMES_NO_CAUSE and not ends_slave_mode(code):
            return
        refused = errors.refused.get(call.conversation)
        if refused is not None and not errors.cleared_between(refused.first.request.time, call.request.time):
            if len(refused.codes) < _MAX_CODES:
                refused.codes.add(code)
            return
        refused = errors.refused[call.conversation] = _RefusedCalls(call, code, client)
        for read in errors.reads:
            self._compare(errors, refused, read)

    def _compare(self, errors: _ControllerErrors, refused: _RefusedCalls, read: _ErrorRead) -> None:
        """Report the error `read.code` if this error explains the first refusal.

        Clients read the newest error first. If clients read the code of the refused call and then read
        further errors, these further errors are older than the refusal.
        """
        first, code = refused.first, read.code
        read_at = read.call.request.time
        if read_at <= last_frame_time(first) or errors.cleared_between(first.request.time, read_at):
            return
        if code in refused.codes or code in _NAMES_NO_CAUSE:
            refused.own_code_read = refused.own_code_read or code in refused.codes
            return
        rule = _rule_of(code)
        is_new = code not in refused.reported and len(refused.reported) < _MAX_CODES
        if is_new and refused.may_follow_from(rule, code):
            self._report(refused, read, rule)

    def _report(self, refused: _RefusedCalls, read: _ErrorRead, rule: str) -> None:
        first, code = refused.first, read.code
        case = "" if refused.names_no_cause else ".older"
        fact = Message(
            f"finding.error-list{case}",
            client=client_place(read.call.conversation),
            read_at=Moment(read.call.request.time),
            at=Moment(first.request.time),
            code=code_place(code),
            read=call_place(read.call),
            failed=call_place(first),
        )
        self.report_occurrence(
            Occurrence(
                rule_id=rule,
                began=refused.began,
                completed=refused.began + 1,
                conversation=first.conversation,
                frames=frame_numbers(first, read.call),
                fact=fact,
                call=read.call.number,
                explains=(first.number, *(each.number for each in refused.reported.values())),
                group_key=f"{code:08X}" if rule == "controller-error" else "",
                advice=advice_on_code(code) if rule == "controller-error" else None,
            )
        )
        refused.reported[code] = read.call


def _read_error(call: Call, client: ClientState) -> _ErrorRead | None:
    if call.kind.folded_command != "getcurerrorinfo":
        name = "" if client.target_object is None else client.target_object.name
        if name.casefold() != "@error_code":
            return None
    results = () if call.reply is None else call.reply.item.arguments
    number = first_number(results[0].variant) if results else None
    code = 0 if number is None else number & 0xFFFFFFFF
    level = describe_hresult(code).level
    return _ErrorRead(code, call) if level is not None or is_rc7_code(code) else None


def _rule_of(code: int) -> str:
    rules = (each.rule for each in REFUSALS if code in each.codes)
    return next((rule for rule in rules if rule != "arm-taken-by-other"), "controller-error")
