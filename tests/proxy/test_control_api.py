"""Questions from outside and their answers, line by line."""

from __future__ import annotations

import json
from typing import Any

import msgspec
import pytest
from hypothesis import given
from hypothesis import strategies as st

from bcapscope.protocol.codec.frame import Frame, encode_frame
from bcapscope.protocol.codec.variant import VT, Variant
from bcapscope.proxy import control_messages as control
from bcapscope.proxy.control_api import ControlApi
from bcapscope.proxy.control_messages import ProxyStats, RelayDelays
from bcapscope.proxy.policy import SendAction
from bcapscope.proxy.ring_buffer import DELAY_FIGURES, RelayCounter
from bcapscope.traffic.observation import Transport
from tests.faults.traffic import MS, request, talk
from tests.proxy.test_rule_policy import DOWN, UP, holding, rules, sent


def ask(api: ControlApi, at: int = 0, **question: object) -> dict[str, Any]:
    """Ask, and read the answer; `when` stands for the word if."""
    if "when" in question:
        question["if"] = question.pop("when")
    reply, is_json = api.handle_line(json.dumps(question).encode(), at)
    assert is_json
    assert reply.endswith(b"\n")
    found: dict[str, Any] = json.loads(reply)
    return found


def test_faults_are_listed_added_switched_and_removed() -> None:
    made = rules("loss=5%")
    api = ControlApi(made)
    assert ask(api, do="add", rule="drop reply name x") == {"ok": True, "name": "x"}
    assert ask(api, do="add", fault={"action": "delay", "time": "3ms"}) == {"ok": True, "name": "delay"}
    assert ask(api, do="off", name="x") == {"ok": True, "name": "x"}
    listed = ask(api, do="rules")["rules"]
    assert [(rule["name"], rule["on"], rule["injected"], rule["rule"]) for rule in listed] == [
        ("drop", True, 0, "drop 5%"),
        ("x", False, 0, "drop name x response"),
        ("delay", True, 0, "delay=3ms"),
    ]
    made.receive(1, DOWN, request(1), 0)
    assert [(rule["name"], rule["injected"], rule["struck"]) for rule in ask(api, do="rules")["rules"]] == [
        ("drop", 0, 0),
        ("x", 0, 0),
        ("delay", 1, 1),  # under both its names
    ]
    assert listed[0]["fault"] == {"action": "drop", "probability": "5%"}
    assert ask(api, do="on", name="x")["ok"]
    assert ask(api, do="remove", name="drop")["ok"]
    assert [rule["name"] for rule in ask(api, do="rules")["rules"]] == ["x", "delay"]


def test_a_fault_counts_its_time_from_when_it_was_added() -> None:
    made = rules()
    ask(ControlApi(made), 100 * MS, do="add", rule="drop for 10ms")
    assert made.receive(1, UP, request(1), 105 * MS).actions == []
    assert sent(made.receive(1, UP, request(1), 110 * MS).actions) == request(1)


def test_messages_are_held_listed_sent_on_edited_and_dropped() -> None:
    made = rules()
    api = ControlApi(made)
    assert ask(api, do="intercept", when="command == slvMove", patience="5s") == {"ok": True}
    for serial in (1, 2, 3, 4):
        made.receive(1, UP, request(serial), 0)
    held = ask(api, 1500 * MS, do="held")["held"]
    assert held[0] == {
        "number": 1,
        "client": "10.0.0.2:50001",
        "server": "10.0.0.1:5007",
        "transport": "udp",
        "direction": "request",
        "function_id": 64,
        "function": "Robot_Execute",
        "command": "slvMove",
        "waited_s": 1.5,
        "left_s": 3.5,
        "given_up": "its client has sent another request since",
        "retries": 0,
        "more": 0,
        "hex": request(1).hex(),
    }
    assert ask(api, do="forward", number=1)["ok"]
    assert ask(api, do="edit", number=2, hex="01 02")["ok"]
    assert ask(api, do="edit", number=3, rewrite="set arg[2][0]=9 serial 33")["ok"]
    assert ask(api, do="drop", number=4)["ok"]
    actions = made.pop_due_actions(0)
    assert [action.data for action in actions if isinstance(action, SendAction)][:2] == [
        request(1),
        b"\x01\x02",
    ]
    assert isinstance(actions[2], SendAction)
    edited = Frame(actions[2].data)
    assert (edited.serial, edited.arguments[2].variant.value) == (33, (9.0, 2.0, 3.0))
    assert len(actions) == 3
    assert ask(api, do="intercept") == {"ok": True}
    assert sent(made.receive(1, UP, request(5), 0).actions) == request(5)


@pytest.mark.parametrize("change", [{"do": "off", "name": "drop"}, {"do": "remove", "name": "drop"}])
def test_bytes_that_a_fault_kept_go_on_when_it_is_switched_off(change: dict[str, str]) -> None:
    made = rules("drop if serial == 9", transport=Transport.TCP)
    made.receive(1, UP, request(1)[:30], 0)
    line = json.dumps(change).encode()
    assert json.loads(ControlApi(made).handle_line(line, 0)[0])["ok"]
    assert sent(made.pop_due_actions(0)) == request(1)[:30]


def test_bytes_that_the_intercept_kept_go_on_when_it_is_switched_off() -> None:
    made = rules(transport=Transport.TCP, intercept=holding("serial == 9"))
    made.receive(1, UP, request(1)[:30], 0)
    assert ask(ControlApi(made), do="intercept")["ok"]
    assert sent(made.pop_due_actions(0)) == request(1)[:30]


def test_messages_are_held_for_no_time_if_so_wished() -> None:
    made = rules()
    assert ask(ControlApi(made), do="intercept", when="serial == 1", patience="0s") == {"ok": True}
    assert made.receive(1, UP, request(1), 5).actions == []
    assert sent(made.pop_due_actions(5)) == request(1)


def test_figures_are_given() -> None:
    made = rules("drop", intercept=holding("serial == 5"))
    made.receive(1, UP, request(1), 0)
    delays = RelayDelays(*range(1, 10))
    stats = ask(ControlApi(made, lambda: {"clients": 1, "delays_ns": delays}), do="stats")
    assert {name: value for name, value in stats.items() if value} == {
        "ok": True,
        "injected": {"drop": 1},
        "struck": {"drop": 1},
        "intercept": "serial == 5",
        "clients": 1,
        "delays_ns": msgspec.to_builtins(delays),
        "held_up_ns": msgspec.to_builtins(delays),
    }
    assert list(stats["held_up_ns"].items())[3::4] == [("most_up", 4), ("most_down", 8)]
    assert (stats["refused"], stats["guard"], stats["held"], stats["scripts"]) == (0, False, 0, None)


def test_figures_that_nobody_has_given_yet_are_zero() -> None:
    stats = ask(ControlApi(rules()), do="stats")
    assert {*stats["delays_ns"].values(), *stats["held_up_ns"].values()} == {0}


def test_each_figure_of_the_relay_has_its_field() -> None:
    fields = ProxyStats.__struct_fields__
    assert {count.name.lower() for count in RelayCounter} <= set(fields)
    assert len(RelayDelays.__struct_fields__) == DELAY_FIGURES


def test_a_request_is_written_as_documented() -> None:
    lines: dict[control.ControlRequest, bytes] = {
        control.SetIntercept("serial == 1", "60s"): b'{"do":"intercept","if":"serial == 1","patience":"60s"}',
        control.SetIntercept(): b'{"do":"intercept"}',
        control.EditHeld(3, rewrite="serial 7"): b'{"do":"edit","number":3,"rewrite":"serial 7"}',
        control.ListHeld(): b'{"do":"held"}',
    }
    for message, line in lines.items():
        assert control.encode_line(message) == line + b"\n"
        assert control.decode_request(line) == message


@pytest.mark.parametrize(
    ("question", "error"),
    [
        ({"do": "nothing"}, "do: Invalid value 'nothing'"),
        ({}, "do is missing"),
        ([], "Expected object, got array"),
        ({"do": "rules", "x": 1}, "there is no field 'x'"),
        ({"do": "on"}, "name is missing"),
        ({"do": "on", "name": "x"}, "no fault is named 'x': drop"),
        ({"do": "add"}, "add takes a rule in one line, or a fault as in a file"),
        ({"do": "add", "rule": "drp"}, "there is no action 'drp', did you mean 'drop'?\n  drp\n  ^"),
        ({"do": "add", "rule": "drop name drop"}, "a fault named drop exists already"),
        ({"do": "add", "fault": {"action": "delay", "time": 5}}, "time: 5 is not a duration"),
        ({"do": "intercept", "if": "x == 1"}, "if: there is no field 'x'"),
        ({"do": "intercept", "patience": "5"}, "patience: '5' is not a duration"),
        ({"do": "forward", "number": 8}, "no message 8 is held"),
        ({"do": "edit", "number": 8, "hex": "00"}, "no message 8 is held"),
        ({"do": "edit", "number": 1}, "edit takes all bytes in hex, or changes such as set arg[2]=0"),
        ({"do": "edit", "number": 1, "hex": "0"}, "non-hexadecimal number found"),
        ({"do": "edit", "number": 1, "rewrite": "sett"}, "'sett' is not allowed here"),
        (
            {"do": "edit", "number": 1, "rewrite": "set arg[9]=1"},
            "this changes nothing: the argument does not exist",
        ),
        (
            {"do": "edit", "number": 1, "rewrite": "set arg[2][0]=x"},
            "this changes nothing: the argument does not exist",
        ),
        ({"do": "drop", "number": 8}, "no message 8 is held"),
    ],
    ids=str,
)
def test_what_makes_no_sense_is_refused_and_changes_nothing(question: object, error: str) -> None:
    made = rules("drop if serial == 2", intercept=holding("serial == 1"))
    made.receive(1, UP, request(1), 0)
    reply, is_json = ControlApi(made).handle_line(json.dumps(question).encode(), 0)
    answer = json.loads(reply)
    assert is_json
    assert not answer["ok"]
    assert answer["error"].startswith(error)
    assert list(made.shaper.hit_counts) == ["drop"]
    assert len(made.intercept.held) == 1


def test_who_does_not_speak_json_is_no_client_of_ours() -> None:
    reply, is_json = ControlApi(rules()).handle_line(b"GET / HTTP/1.1", 0)
    assert not is_json
    assert json.loads(reply)["error"].startswith("this is not JSON: ")


@given(
    st.binary(max_size=60)
    | st.dictionaries(
        st.sampled_from(["do", "rule", "name", "number", "hex", "if"]),
        st.none()
        | st.integers()
        | st.text(max_size=8)
        | st.sampled_from(["rules", "add", "edit", "drop", "on", "intercept", "loss=5%"]),
    ).map(lambda each: json.dumps(each).encode())
)
def test_any_line_is_answered(line: bytes) -> None:
    assert "ok" in json.loads(ControlApi(rules()).handle_line(line, 0)[0])


def test_half_a_character_in_what_is_held_is_told_as_well_as_can_be() -> None:
    made = rules(intercept=holding("serial == 1"))
    command = Variant(VT.BSTR, "slv\ud800Move")
    made.receive(1, UP, encode_frame(1, 0, 64, (Variant(VT.I4, 1), command, Variant(VT.EMPTY, None))), 0)
    (held,) = ask(ControlApi(made), do="held")["held"]
    assert held["command"] == "slv?Move"
    assert "\ud800".encode("utf-16-le", "surrogatepass").hex() in held["hex"]


def test_who_is_there_is_told() -> None:
    made = rules(clients=0)
    made.add_client(1, talk().up.conversation, 301_234_000)
    api = ControlApi(made, upstream={1: "open"}.__getitem__)
    made.receive(1, UP, request(1), 501_234_000)
    (client,) = ask(api, 2000 * MS, do="clients")["clients"]
    assert client == {
        "number": 1,
        "client": "10.0.0.2:50001",
        "server": "10.0.0.1:5007",
        "transport": "udp",
        "upstream": "open",
        "since_s": 1.699,
        "up": 1,
        "heard_s": 1.499,
        "down": 0,
        "answered_s": None,
    }
    made.remove_client(1, 0)
    assert ask(api, do="clients") == {"ok": True, "clients": []}
