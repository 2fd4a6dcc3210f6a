"""Calls as JSON."""

from __future__ import annotations

import json
from collections.abc import Callable

import pytest
from hypothesis import given
from hypothesis import strategies as st

from bcapscope.protocol.tables.function_table import ObjectClass
from bcapscope.render import call_record
from bcapscope.render.call_record import CallRecordRenderer
from bcapscope.traffic.call import Call
from bcapscope.traffic.filter.field_table import RecordKind, fields_of
from bcapscope.traffic.handle_tracker import TrackedObject
from tests.render.calls import settled
from tests.traffic.playbook import MOVE, POSE, Script, calls_of, execute
from tests.traffic.sessions import Capture, Profile, Session

KEYS = [
    *("call", "function", "function_id", "command", "transport", "client", "server", "object", "started"),
    *(
        "requests",
        "serials",
        "retries",
        "unseen_retries",
        "replies",
        "late_replies",
        "lost_replies",
        "executing",
        "duplicates",
    ),
    "outcome",
    *("hresult", "hresult_name", "hresult_text", "latency_ms", "rtt_ms", "convention", "verdict"),
    *("captured_again", "places"),
]


def lines() -> list[bytes]:
    renderer = CallRecordRenderer()
    return [renderer.record(call, subject) for call, subject in settled() if isinstance(call, Call)]


def test_all_calls(golden: Callable[[str, bytes], None]) -> None:
    golden("call-records.json", b"".join(line + b"\n" for line in lines()))


def test_keys_are_the_same_for_all_but_the_meaning_of_a_result() -> None:
    for record in map(json.loads, lines()):
        keys = [key for key in KEYS if key != "hresult_text" or record["hresult"] is not None]
        assert list(record) == keys


def test_filters_ask_for_calls_by_the_same_names() -> None:
    """But for `object`, which needs the handles, and `places`, a list of objects."""
    assert set(KEYS) - fields_of(RecordKind.CALL).keys() == {"object", "places"}


def test_a_call_without_trouble() -> None:
    play = Script()
    client = play.client()
    client.ask(0, 7, 0, MOVE)
    client.reply(1.25, 7, 0, 0, POSE)
    (call,) = calls_of(play.track())
    assert json.loads(CallRecordRenderer().record(call)) == {
        "call": 1,
        "function": "Robot_Execute",
        "function_id": 64,
        "command": "slvMove",
        "transport": "udp",
        "client": "10.0.0.2:50001",
        "server": "10.0.0.1:5007",
        "object": None,
        "started": 1700000000.0,
        "requests": [1],
        "serials": [7],
        "retries": 0,
        "unseen_retries": 0,
        "replies": [2],
        "late_replies": [],
        "lost_replies": [],
        "executing": 0,
        "duplicates": [],
        "outcome": "answered",
        "hresult": 0,
        "hresult_name": "S_OK",
        "hresult_text": "done",
        "latency_ms": 1.25,
        "rtt_ms": 1.25,
        "convention": "unknown",
        "verdict": "answered",
        "captured_again": [],
        "places": [],
    }


def plain(call: Call) -> dict[str, object]:
    """Say what a record should, by the properties of the call alone."""
    return {
        "call": call.number,
        "requests": [seen.number for seen in call.attempts],
        "serials": list(call.serials),
        "retries": call.retries,
        "unseen_retries": call.unseen_retries,
        "replies": [] if call.reply is None else [call.reply.number],
        "late_replies": [seen.number for seen in call.late_replies],
        "lost_replies": [seen.number for seen in call.lost_replies],
        "executing": len(call.notices),
        "duplicates": [seen.number for seen in call.duplicates],
        "outcome": call.outcome.value,
        "hresult": call.hresult,
        "latency_ms": None if call.latency is None else call.latency / 1e6,
        "rtt_ms": None if call.rtt is None else call.rtt / 1e6,
        "convention": call.convention.value,
        "verdict": call.verdict.value,
    }


@given(st.integers(0, 10**6), st.sampled_from(("seed", "own", "chain", "tcp0")))
def test_what_is_kept_ready_made_agrees_with_the_call(seed: int, convention: str) -> None:
    profile = Profile(convention=convention, copies=0.1, slow=0.1)
    session = Session(profile, 30, seed)
    script = Script()
    script.seen = Capture([(profile, session.records)]).observations
    renderer = CallRecordRenderer()
    for call in calls_of(script.track()):
        record = json.loads(renderer.record(call))
        assert {key: record[key] for key in plain(call)} == plain(call)


def test_percent_signs_and_quotes_are_kept() -> None:
    name = '100%d %b %% "x"'
    play = Script()
    client = play.client()
    for serial in (1, 2):
        client.ask(serial, serial, 0, execute(name))
        client.reply(serial + 0.5, serial)
    renderer = CallRecordRenderer()
    thing = TrackedObject(ObjectClass.ROBOT, 1, name, "", 1, True)
    for call in calls_of(play.track()):
        record = json.loads(renderer.record(call, thing))
        assert (record["command"], record["object"]) == (name, name)


def test_forms_are_forgotten_in_time(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(call_record, "MAX_TEMPLATES", 3)
    play = Script()
    client = play.client()
    for serial in range(1, 11):
        client.ask(serial, serial, 0, execute(f"c{serial}"))
        client.reply(serial + 0.5, serial)
    renderer = CallRecordRenderer()
    commands = []
    for call in calls_of(play.track()):
        commands.append(json.loads(renderer.record(call))["command"])
        assert len(renderer._templates) <= 3
    assert commands == [f"c{serial}" for serial in range(1, 11)]


@given(st.text())
def test_names_from_the_wire_are_only_seen_escaped(name: str) -> None:
    play = Script()
    play.client().ask(0, 1, 0, execute(name))
    play.client().ask(0, 1, 0, execute(name))
    play.seen[1:] = []
    (call,) = calls_of(play.track())
    text = CallRecordRenderer().record(call, TrackedObject(ObjectClass.ROBOT, 1, name, "", 1, True)).decode()
    assert text.isprintable() or name.isprintable()
    assert json.loads(text)["command"] == name
