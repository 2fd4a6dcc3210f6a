"""Executes the control requests that a running proxy receives. This module uses no socket and no clock."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from typing import Any, TypeVar

from bcapscope.errors import InputError, message_of
from bcapscope.faults.document import DocumentError, fault_from, to_plain_data
from bcapscope.faults.fault_injector import ActiveFault
from bcapscope.faults.fault_notation import read_fault, rewrite_message, write_fault
from bcapscope.faults.quantities import DurationQuantity, FrameCondition
from bcapscope.messages import Message
from bcapscope.messages.message_codec import message_to_data
from bcapscope.protocol.tables.function_table import function_name
from bcapscope.proxy import control_messages as control
from bcapscope.proxy.direction_state import DirectionState
from bcapscope.proxy.intercept import HeldMessage
from bcapscope.proxy.rule_policy import RulePolicy

Q = TypeVar("Q", DurationQuantity, FrameCondition)


class ControlApi:
    def __init__(
        self,
        rules: RulePolicy,
        figures: Callable[[], Mapping[str, Any]] = dict,
        upstream: Callable[[int], str] = lambda number: "",
    ) -> None:
        """Control a proxy with these `rules`. `figures` returns the relay's figures under the names in
        `ProxyStats`. `upstream` returns the state of a client's connection to the controller.
        """
        self._rules = rules
        self._figures = figures
        self._upstream = upstream

    def handle_line(self, line: bytes, now: int) -> tuple[bytes, bool]:
        """Execute a request. Return the response, and whether the request was JSON. If the request is not
        JSON, the sender is not a control client.
        """
        is_json = True
        try:
            return control.encode_line(self._execute(control.decode_request(line), now)), True
        except json.JSONDecodeError as error:
            is_json, reason = False, Message("control.no-json", reason=str(error))
        except KeyError as error:
            reason = self._unknown(error.args[0])
        except ValueError as error:
            reason = message_of(error)
        refusal = control.ErrorResponse(False, str(reason), message_to_data(reason))
        return control.encode_line(refusal), is_json

    def _execute(self, request: control.ControlRequest, now: int) -> control.DoneResponse:
        rules = self._rules
        match request:
            case control.ListFaults():
                return control.FaultsResponse(rules=list(map(_fault_status, rules.shaper.active_faults)))
            case control.ListHeld():
                return control.HeldResponse(held=[_held_status(each, now) for each in rules.intercept.held])
            case control.ListClients():
                upstream = self._upstream
                clients = [_client_status(up, down, upstream(up.client), now) for up, down in rules.clients()]
                return control.ClientsResponse(clients=clients)
            case control.GetStats():
                return self._stats()
            case control.SetIntercept() | control.ForwardHeld() | control.EditHeld() | control.DropHeld():
                self._change_hold(request, now)
                return control.DoneResponse()
            case _:
                return control.FaultResponse(name=self._change_fault(request, now))

    def _change_fault(self, request: control.FaultChange, now: int) -> str:
        """Return the name of the fault."""
        shaper = self._rules.shaper
        if isinstance(request, control.AddFault):
            if bool(request.rule) == bool(request.fault):
                raise InputError(Message("control.add"))
            return shaper.add(read_fault(request.rule) if request.rule else fault_from(request.fault), now)
        if isinstance(request, control.RemoveFault):
            shaper.remove(request.name)
        else:
            shaper.set_enabled(request.name, isinstance(request, control.EnableFault))
        self._rules.on_rules_changed(now)
        return request.name

    def _change_hold(self, request: control.HoldChange, now: int) -> None:
        rules = self._rules
        match request:
            case control.SetIntercept():
                condition = _quantity("if", FrameCondition, request.condition)
                hold_time = _quantity("patience", DurationQuantity, request.patience)
                rules.intercept.set_condition(condition)
                if hold_time is not None:
                    rules.intercept.hold_time = hold_time
                rules.on_rules_changed(now)
            case control.ForwardHeld():
                rules.forward_held(request.number, now)
            case control.EditHeld():
                rules.forward_held(request.number, now, self._edited_bytes(request))
            case control.DropHeld():
                rules.drop_held(request.number, now)

    def _edited_bytes(self, request: control.EditHeld) -> bytes:
        held = next((each for each in self._rules.intercept.held if each.number == request.number), None)
        if held is None:
            raise KeyError(request.number)
        if bool(request.hex) == bool(request.rewrite):
            raise InputError(Message("control.edit"))
        if request.hex:
            return bytes.fromhex(request.hex)
        data = rewrite_message(held.data, held.flow, request.rewrite)
        # Probably a typing error. Do not forward the unchanged message, because it may request a motion.
        if data == held.data:
            raise InputError(Message("control.no-change"))
        return data

    def _stats(self) -> control.ProxyStats:
        rules = self._rules
        intercept = rules.intercept
        return control.ProxyStats(
            injected=rules.shaper.hit_counts,
            refused=rules.refused_requests,
            guard=rules.guard is not None,
            intercept=intercept.condition.text if intercept.condition else None,
            held=len(intercept.held),
            held_so_far=intercept.held_so_far,
            addon_errors=0 if rules.scripts is None else rules.scripts.errors,
            scripts=None if rules.scripts is None else rules.scripts.status,
            **self._figures(),
        )

    def _unknown(self, what: object) -> Message:
        if isinstance(what, int):
            return Message("control.no-message", number=what)
        known = ", ".join(self._rules.shaper.hit_counts)
        return Message("control.no-fault", name=f"{what!r}", known=known or Message("control.no-faults"))


def _quantity(field: str, kind: type[Q], text: str | None) -> Q | None:
    try:
        return None if text is None else kind.read(text)
    except ValueError as error:
        raise DocumentError((field,), 0, message_of(error)) from None


def _fault_status(active: ActiveFault) -> control.FaultStatus:
    rule, data = write_fault(active.fault), to_plain_data(active.fault)
    return control.FaultStatus(active.name, active.enabled, active.hit_count, rule, data)


def _client_status(up: DirectionState, down: DirectionState, upstream: str, now: int) -> control.ClientStatus:
    conversation = up.flow.conversation
    return control.ClientStatus(
        up.client,
        str(conversation.client),
        str(conversation.server),
        conversation.transport,
        upstream,
        _seconds(now - up.connected_at),
        up.piece_count,
        _seconds_ago(up.last_piece_at, now),
        down.piece_count,
        _seconds_ago(down.last_piece_at, now),
    )


def _seconds_ago(then: int, now: int) -> float | None:
    return _seconds(now - then) if then else None


def _seconds(nanoseconds: int) -> float:
    return round(nanoseconds / 1e9, 3)


def _held_status(held: HeldMessage, now: int) -> control.HeldStatus:
    kind, conversation = held.call_kind, held.flow.conversation
    abandoned = held.abandonment_reason(now)
    return control.HeldStatus(
        held.number,
        str(conversation.client),
        str(conversation.server),
        conversation.transport,
        held.flow.direction,
        kind.function_id if kind else None,
        function_name(kind.function_id) if kind else None,
        kind.command if kind else None,
        _seconds(now - held.since),
        _seconds(held.until - now),
        held.data.hex(),
        "" if abandoned is None else str(abandoned),
        held.repeats,
    )
