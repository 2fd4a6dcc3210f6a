"""Requests to a running proxy, and its answers. Each is one line of JSON.

    {"do": "rules"}                              the faults, their switches and counts
    {"do": "add", "rule": "loss=5% request"}     one line, or "fault" as in a file
    {"do": "remove", "name": "drop"}
    {"do": "on", "name": "drop"}                 also off
    {"do": "intercept", "if": "command == slvMove", "patience": "60s"}    without "if": hold nothing
    {"do": "held"}                               the held messages
    {"do": "forward", "number": 3}
    {"do": "edit", "number": 3, "hex": "01 …"}   or "rewrite": "set arg[2][0]=10"
    {"do": "drop", "number": 3}
    {"do": "clients"}                            clients, and their connections to the controller
    {"do": "stats"}

The answer has "ok": true and the result, or "ok": false and "error".
"""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from typing import Any, NamedTuple, TypeAlias

import msgspec
import orjson

from bcapscope.faults.document import convert_data, fault_from, to_plain_data
from bcapscope.faults.fault import RewriteFault
from bcapscope.faults.fault_notation import read_fault, write_fault
from bcapscope.faults.quantities import Duration, FrameCondition
from bcapscope.faults.rewriter import Rewriter
from bcapscope.protocol.codec.frame import Frame, parse_datagram
from bcapscope.protocol.tables.function_table import function_name
from bcapscope.proxy.direction_state import ClientActivity
from bcapscope.proxy.intercept import HeldMessage
from bcapscope.proxy.rule_policy import RulePolicy

LONGEST_LINE = 1 << 20
"""Bytes. A message in hexadecimal has 1006 digits on UDP, and seldom more than 20,000 on TCP."""


class _ControlRequest(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True, tag_field="do"):
    pass


class ListFaults(_ControlRequest, frozen=True, kw_only=True, tag="rules"):
    """List the faults."""


class AddFault(_ControlRequest, frozen=True, kw_only=True, tag="add"):
    """Add a fault, given as one line (`rule`) or as in a file (`fault`)."""

    rule: str = ""
    fault: dict[str, Any] = {}


class RemoveFault(_ControlRequest, frozen=True, kw_only=True, tag="remove"):
    """Remove a fault."""

    name: str


class EnableFault(_ControlRequest, frozen=True, kw_only=True, tag="on"):
    """Switch a fault on."""

    name: str


class DisableFault(_ControlRequest, frozen=True, kw_only=True, tag="off"):
    """Switch a fault off."""

    name: str


class SetIntercept(_ControlRequest, frozen=True, kw_only=True, tag="intercept", rename={"when": "if"}):
    """Hold messages that match another filter from now on, or none."""

    when: FrameCondition | None = None
    patience: Duration | None = None


class ListHeld(_ControlRequest, frozen=True, kw_only=True, tag="held"):
    """List the held messages."""


class ForwardHeld(_ControlRequest, frozen=True, kw_only=True, tag="forward"):
    """Send a held message on unchanged."""

    number: int


class EditHeld(_ControlRequest, frozen=True, kw_only=True, tag="edit"):
    """Send a held message on with other bytes, or rewritten as by a fault."""

    number: int
    hex: str = ""
    rewrite: str = ""


class DropHeld(_ControlRequest, frozen=True, kw_only=True, tag="drop"):
    """Drop a held message."""

    number: int


class ListClients(_ControlRequest, frozen=True, kw_only=True, tag="clients"):
    """List the clients."""


class GetStats(_ControlRequest, frozen=True, kw_only=True, tag="stats"):
    """Return the figures."""


ControlRequest: TypeAlias = (
    ListFaults
    | AddFault
    | RemoveFault
    | EnableFault
    | DisableFault
    | SetIntercept
    | ListHeld
    | ForwardHeld
    | EditHeld
    | DropHeld
    | ListClients
    | GetStats
)


class ControlResponse(NamedTuple):
    """An answer.

    Attributes:
        line: JSON and a line feed.
        is_json: True if the request was JSON. A program that sends anything else is not a control client.
    """

    line: bytes
    is_json: bool


class ControlApi:
    """Executes requests from the control socket, without sockets or clocks."""

    def __init__(
        self,
        rules: RulePolicy,
        figures: Callable[[], Mapping[str, object]] = dict,
        upstream: Callable[[int], str] = lambda number: "",
    ) -> None:
        """Use the rules of a proxy.

        Args:
            rules: Rules of the proxy.
            figures: Returns the figures of the relay, for `stats`.
            upstream: Returns the state of the connection to the controller, by number of the client.
        """
        self._rules = rules
        self._figures = figures
        self._upstream = upstream

    def handle_line(self, line: bytes, now: int) -> ControlResponse:
        """Execute a line of JSON. Return the answer; errors become answers as well."""
        try:
            asked = orjson.loads(line)
        except orjson.JSONDecodeError as error:
            return ControlResponse(_json_line({"ok": False, "error": f"no JSON: {error}"}), False)
        try:
            ask = convert_data(asked, ControlRequest)
            return ControlResponse(_json_line({"ok": True, **self._execute(ask, now)}), True)
        except KeyError as error:
            return ControlResponse(
                _json_line({"ok": False, "error": self._unknown_text(error.args[0])}), True
            )
        except ValueError as error:
            return ControlResponse(_json_line({"ok": False, "error": str(error)}), True)

    def _execute(self, request: ControlRequest, now: int) -> dict[str, object]:
        rules = self._rules
        match request:
            case ListFaults():
                return {"rules": [_fault_fields(rules, name) for name in rules.shaper.hit_counts]}
            case AddFault() | RemoveFault() | EnableFault() | DisableFault():
                return self._change_faults(request, now)
            case SetIntercept():
                rules.intercept.set_condition(request.when)
                if request.patience is not None:
                    rules.intercept.hold_time = request.patience
                rules.on_rules_changed(now)
            case ListHeld():
                return {"held": [_held_fields(each, now) for each in rules.intercept.held]}
            case ForwardHeld():
                rules.forward_held(request.number, now)
            case EditHeld():
                rules.forward_held(request.number, now, self._edited_bytes(request))
            case DropHeld():
                rules.drop_held(request.number, now)
            case ListClients():
                found = (_client_fields(each, self._upstream(each.number), now) for each in rules.clients())
                return {"clients": list(found)}
            case GetStats():
                return self._stats()
        return {}

    def _change_faults(
        self, request: AddFault | RemoveFault | EnableFault | DisableFault, now: int
    ) -> dict[str, object]:
        shaper = self._rules.shaper
        if isinstance(request, AddFault):
            if bool(request.rule) == bool(request.fault):
                raise ValueError("add takes a rule in one line, or a fault as in a file")
            name = shaper.add(read_fault(request.rule) if request.rule else fault_from(request.fault), now)
            return {"name": name}
        if isinstance(request, RemoveFault):
            shaper.remove(request.name)
        else:
            shaper.set_enabled(request.name, isinstance(request, EnableFault))
        self._rules.on_rules_changed(now)
        return {"name": request.name}

    def _edited_bytes(self, request: EditHeld) -> bytes:
        """Return the bytes that replace a held message."""
        held = next((each for each in self._rules.intercept.held if each.number == request.number), None)
        if held is None:
            raise KeyError(request.number)
        if bool(request.hex) == bool(request.rewrite):
            raise ValueError("edit takes the bytes in hex, or what to rewrite")
        if request.hex:
            return bytes.fromhex(request.hex)
        fault = read_fault(f"rewrite {request.rewrite}")
        assert isinstance(fault, RewriteFault)
        rewriter = Rewriter(fault)
        data = b"".join(
            rewriter.rewrite(item, held.flow) if isinstance(item, Frame) else item.raw
            for item in parse_datagram(held.data)
        )
        if data == held.data:  # a typing error must not let a motion pass unchanged
            raise ValueError(
                "that changes nothing: no such argument, a value that does not fit its type, "
                "or the one that it has"
            )
        return data

    def _stats(self) -> dict[str, object]:
        rules = self._rules
        intercept = rules.intercept
        return {
            "struck": rules.shaper.hit_counts,
            "refused": rules.refused_requests,
            "guard": rules.guard is not None,
            "intercept": intercept.condition.text if intercept.condition else None,
            "held": len(intercept.held),
            "held_so_far": intercept.held_so_far,
            "addon_errors": 0 if rules.scripts is None else rules.scripts.errors,
            "scripts": None if rules.scripts is None else rules.scripts.status,
            **self._figures(),
        }

    def _unknown_text(self, what: object) -> str:
        if isinstance(what, int):
            return f"no message {what} is held"
        known = ", ".join(self._rules.shaper.hit_counts) or "there are none"
        return f"there is no fault {what!r}: {known}"


def _fault_fields(rules: RulePolicy, name: str) -> dict[str, object]:
    striker = rules.shaper.find(name).matcher
    return {
        "name": name,
        "on": striker.enabled,
        "struck": striker.hit_count,
        "rule": write_fault(striker.fault),
        "fault": to_plain_data(striker.fault),
    }


def _client_fields(client: ClientActivity, upstream: str, now: int) -> dict[str, object]:
    conversation = client.conversation
    return {
        "number": client.number,
        "client": str(conversation.client),
        "server": str(conversation.server),
        "transport": conversation.transport,
        "upstream": upstream,
        "since_s": round((now - client.since) / 1e9, 3),
        "up": client.up,
        "heard_s": _seconds_ago(client.last_request_at, now),
        "down": client.down,
        "answered_s": _seconds_ago(client.last_reply_at, now),
    }


def _seconds_ago(then: int, now: int) -> float | None:
    """Return how many seconds ago something happened; None for never."""
    return round((now - then) / 1e9, 3) if then else None


def _held_fields(held: HeldMessage, now: int) -> dict[str, object]:
    question = held.call_kind
    return {
        "number": held.number,
        "client": str(held.flow.conversation.client),
        "server": str(held.flow.conversation.server),
        "transport": held.flow.conversation.transport,
        "direction": held.flow.direction,
        "function_id": question.function_id if question else None,
        "function": function_name(question.function_id) if question else None,
        "command": question.command if question else None,
        "waited_s": round((now - held.since) / 1e9, 3),
        "left_s": round((held.until - now) / 1e9, 3),
        "given_up": held.abandonment_reason(now),
        "more": held.repeats,
        "hex": held.data.hex(),
    }


def _json_line(answer: Mapping[str, object]) -> bytes:
    try:
        return orjson.dumps(answer, default=str) + b"\n"
    except TypeError:  # lone surrogate, from the wire or a file name, which UTF-8 cannot encode
        return json.dumps(answer, default=str, ensure_ascii=False).encode("utf-8", "replace") + b"\n"
