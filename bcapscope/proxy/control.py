"""What can be asked and told from outside while the proxy runs: lines of JSON in, lines of JSON out.

    {"do": "rules"}                              the faults, their switches and counts
    {"do": "add", "rule": "loss=5% request"}     in one line, or with "fault" as in a file
    {"do": "remove", "name": "drop"}
    {"do": "on", "name": "drop"}                 also off
    {"do": "intercept", "if": "command == slvMove", "patience": "60s"}    without "if": nothing more
    {"do": "held"}                               messages that wait
    {"do": "forward", "number": 3}
    {"do": "edit", "number": 3, "hex": "01 …"}   or "rewrite": "set arg[2][0]=10"
    {"do": "drop", "number": 3}
    {"do": "clients"}                            who is there, and how the way to the controller is
    {"do": "stats"}

The answer has "ok": true and what was asked for, or "ok": false and "error".
"""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from typing import Any, NamedTuple, TypeAlias

import msgspec
import orjson

from bcapscope.faults.document import convert, fault_of, plain
from bcapscope.faults.fault import Rewrite
from bcapscope.faults.notation import read_fault, write_fault
from bcapscope.faults.quantities import Condition, Duration
from bcapscope.faults.rewriting import Rewriter
from bcapscope.protocol.frame import Frame, parse_datagram
from bcapscope.protocol.functions import function_name
from bcapscope.proxy.intercept import Held
from bcapscope.proxy.rules import Rules
from bcapscope.proxy.way import Attendance

LONGEST_LINE = 1 << 20
"""Bytes; a message in hexadecimal digits has 1006 on UDP and seldom more than 20,000 on TCP."""


class _Ask(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True, tag_field="do"):
    pass


class ListRules(_Ask, frozen=True, kw_only=True, tag="rules"):
    """List the faults."""


class Add(_Ask, frozen=True, kw_only=True, tag="add"):
    """Set up a fault: in one line, or as in a file."""

    rule: str = ""
    fault: dict[str, Any] = {}


class Remove(_Ask, frozen=True, kw_only=True, tag="remove"):
    """Take a fault away."""

    name: str


class On(_Ask, frozen=True, kw_only=True, tag="on"):
    """Switch a fault on."""

    name: str


class Off(_Ask, frozen=True, kw_only=True, tag="off"):
    """Switch a fault off."""

    name: str


class SetIntercept(_Ask, frozen=True, kw_only=True, tag="intercept", rename={"when": "if"}):
    """Hold other messages from now on, or none."""

    when: Condition | None = None
    patience: Duration | None = None


class ListHeld(_Ask, frozen=True, kw_only=True, tag="held"):
    """List the messages that wait."""


class Forward(_Ask, frozen=True, kw_only=True, tag="forward"):
    """Send a message on as it came."""

    number: int


class Edit(_Ask, frozen=True, kw_only=True, tag="edit"):
    """Send a message on with other bytes, or rewritten as by a fault."""

    number: int
    hex: str = ""
    rewrite: str = ""


class DropHeld(_Ask, frozen=True, kw_only=True, tag="drop"):
    """Drop a message that waits."""

    number: int


class ListClients(_Ask, frozen=True, kw_only=True, tag="clients"):
    """List the clients."""


class Stats(_Ask, frozen=True, kw_only=True, tag="stats"):
    """Give figures."""


Ask: TypeAlias = (
    ListRules
    | Add
    | Remove
    | On
    | Off
    | SetIntercept
    | ListHeld
    | Forward
    | Edit
    | DropHeld
    | ListClients
    | Stats
)


class Reply(NamedTuple):
    """An answer.

    Attributes:
        line: JSON and a line feed.
        sound: the question was JSON; who sends anything else is no client of ours.
    """

    line: bytes
    sound: bool


class Desk:
    """Answers questions, without sockets or clocks."""

    def __init__(
        self,
        rules: Rules,
        figures: Callable[[], Mapping[str, object]] = dict,
        upstream: Callable[[int], str] = lambda number: "",
    ) -> None:
        """Take the rules that are asked for.

        Args:
            rules: of the proxy.
            figures: gives those of the relay, for `stats`.
            upstream: tells of a client's number how its way to the controller is.
        """
        self._rules = rules
        self._figures = figures
        self._upstream = upstream

    def answer(self, line: bytes, now: int) -> Reply:
        """Do what a line of JSON asks for."""
        try:
            asked = orjson.loads(line)
        except orjson.JSONDecodeError as error:
            return Reply(_line({"ok": False, "error": f"no JSON: {error}"}), False)
        try:
            ask = convert(asked, Ask)
            return Reply(_line({"ok": True, **self._do(ask, now)}), True)
        except KeyError as error:
            return Reply(_line({"ok": False, "error": self._unknown(error.args[0])}), True)
        except ValueError as error:
            return Reply(_line({"ok": False, "error": str(error)}), True)

    def _do(self, ask: Ask, now: int) -> dict[str, object]:
        rules = self._rules
        match ask:
            case ListRules():
                return {"rules": [_rule(rules, name) for name in rules.shaper.counts]}
            case Add() | Remove() | On() | Off():
                return self._change(ask, now)
            case SetIntercept():
                rules.intercept.set(ask.when)
                if ask.patience is not None:
                    rules.intercept.patience = ask.patience
                rules.changed(now)
            case ListHeld():
                return {"held": [_held(each, now) for each in rules.intercept.held]}
            case Forward():
                rules.send_on(ask.number, now)
            case Edit():
                rules.send_on(ask.number, now, self._edited(ask))
            case DropHeld():
                rules.drop(ask.number, now)
            case ListClients():
                found = (_client(each, self._upstream(each.number), now) for each in rules.clients())
                return {"clients": list(found)}
            case Stats():
                return self._stats()
        return {}

    def _change(self, ask: Add | Remove | On | Off, now: int) -> dict[str, object]:
        shaper = self._rules.shaper
        if isinstance(ask, Add):
            if bool(ask.rule) == bool(ask.fault):
                raise ValueError("add takes a rule in one line, or a fault as in a file")
            name = shaper.add(read_fault(ask.rule) if ask.rule else fault_of(ask.fault), now)
            return {"name": name}
        if isinstance(ask, Remove):
            shaper.remove(ask.name)
        else:
            shaper.switch(ask.name, isinstance(ask, On))
        self._rules.changed(now)
        return {"name": ask.name}

    def _edited(self, ask: Edit) -> bytes:
        """Make the bytes that go on in place of a message that is held."""
        held = next((each for each in self._rules.intercept.held if each.number == ask.number), None)
        if held is None:
            raise KeyError(ask.number)
        if bool(ask.hex) == bool(ask.rewrite):
            raise ValueError("edit takes the bytes in hex, or what to rewrite")
        if ask.hex:
            return bytes.fromhex(ask.hex)
        fault = read_fault(f"rewrite {ask.rewrite}")
        assert isinstance(fault, Rewrite)
        rewriter = Rewriter(fault)
        data = b"".join(
            rewriter.apply(item, held.flow) if isinstance(item, Frame) else item.raw
            for item in parse_datagram(held.data)
        )
        if data == held.data:  # a slip in what was typed is not to let a motion pass as it is
            raise ValueError(
                "that changes nothing: no such argument, a value that does not fit its type, "
                "or the one that it has"
            )
        return data

    def _stats(self) -> dict[str, object]:
        rules = self._rules
        intercept = rules.intercept
        return {
            "struck": rules.shaper.counts,
            "refused": rules.refused,
            "guard": rules.guard is not None,
            "intercept": intercept.condition.text if intercept.condition else None,
            "held": len(intercept.held),
            "held_so_far": intercept.count,
            "addon_errors": 0 if rules.scripts is None else rules.scripts.errors,
            "scripts": None if rules.scripts is None else rules.scripts.status,
            **self._figures(),
        }

    def _unknown(self, what: object) -> str:
        if isinstance(what, int):
            return f"no message {what} is held"
        known = ", ".join(self._rules.shaper.counts) or "there are none"
        return f"there is no fault {what!r}: {known}"


def _rule(rules: Rules, name: str) -> dict[str, object]:
    striker = rules.shaper.rule(name).striker
    return {
        "name": name,
        "on": striker.on,
        "struck": striker.struck,
        "rule": write_fault(striker.fault),
        "fault": plain(striker.fault),
    }


def _client(client: Attendance, upstream: str, now: int) -> dict[str, object]:
    conversation = client.conversation
    return {
        "number": client.number,
        "client": str(conversation.client),
        "server": str(conversation.server),
        "transport": conversation.transport,
        "upstream": upstream,
        "since_s": round((now - client.since) / 1e9, 3),
        "up": client.up,
        "heard_s": _ago(client.heard, now),
        "down": client.down,
        "answered_s": _ago(client.answered, now),
    }


def _ago(then: int, now: int) -> float | None:
    """Tell how many seconds ago something was; None for never."""
    return round((now - then) / 1e9, 3) if then else None


def _held(held: Held, now: int) -> dict[str, object]:
    question = held.question
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
        "given_up": held.given_up(now),
        "more": held.more,
        "hex": held.data.hex(),
    }


def _line(answer: Mapping[str, object]) -> bytes:
    try:
        return orjson.dumps(answer, default=str) + b"\n"
    except TypeError:  # half a character, from the wire or in a file's name, which UTF-8 has not
        return json.dumps(answer, default=str, ensure_ascii=False).encode("utf-8", "replace") + b"\n"
