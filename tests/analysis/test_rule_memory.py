"""What rules remember does not grow with hostile traffic."""

from __future__ import annotations

import pytest

from bcapscope.analysis.client_state import MAX_CLOSED_CLIENTS, ClientRegistry
from bcapscope.analysis.diagnosis import Diagnosis
from bcapscope.analysis.rules import object_rules
from bcapscope.analysis.rules.object_rules import ObjectChecker
from bcapscope.analysis.rules.rule_checker import Occurrence
from bcapscope.analysis.slave.slave_session import ExitReason
from bcapscope.traffic.call import Call
from bcapscope.traffic.call_kind import LONGEST_NAME
from bcapscope.traffic.handle_tracker import HandleTracker
from bcapscope.traffic.pipeline import Pipeline
from tests.analysis.driving import ENTER, Plan, i4
from tests.traffic.playbook import GET_VARIABLE, VARIABLE_RELEASE, run_pipeline, text


def opened(watcher: ObjectChecker, clients: ClientRegistry, names: list[str]) -> None:
    """Let a client open an object by each of the names."""
    plan, handles = Plan(), HandleTracker()
    driver = plan.driver()
    for number, name in enumerate(names):
        arguments = i4(1), text(name), text("")
        driver.call(number * 10.0, GET_VARIABLE, *arguments, results=(i4(number + 1),))
    for call in plan.track():
        assert isinstance(call, Call)
        client = clients.client_of(call)
        client.target_object = handles.on_call(call)
        watcher.on_call(call, client)


def test_names_that_are_opened_twice_do_not_pile_up(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(object_rules, "_MAX_NAMES", 8)
    clients = ClientRegistry(lambda client: None)
    watcher = ObjectChecker(lambda incident: None, clients)
    opened(watcher, clients, [f"I{number // 2}" for number in range(100)])
    assert len(watcher._tallies) == 8


def test_a_leak_is_found_among_many_names(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(object_rules, "_MAX_NAMES", 8)
    found: list[Occurrence] = []
    clients = ClientRegistry(lambda client: None)
    watcher = ObjectChecker(found.append, clients)
    names = [name for number in range(30) for name in ("leaks", f"I{number}", f"F{number}")]
    opened(watcher, clients, names)
    assert {occurrence.rule.id for occurrence in found} == {"handle-leak"}
    assert [occurrence.is_update for occurrence in found] == [False] + [True] * 10


def test_an_object_with_a_long_name_that_is_released_is_no_leak() -> None:
    plan = Plan()
    driver = plan.driver()
    for number in range(40):
        arguments = i4(1), text("I" * (LONGEST_NAME + 1)), text("")
        driver.call(number * 20.0, GET_VARIABLE, *arguments, results=(i4(number + 2),))
        driver.call(number * 20.0 + 10, VARIABLE_RELEASE, i4(number + 2))
    plan.track()
    diagnosis = Diagnosis()
    run_pipeline(plan.script.seen, diagnosis)
    assert "handle-leak" not in [finding.rule for finding in diagnosis.findings()]


def left_on(until: float) -> Plan:
    """A client falls silent in slave mode; another one is heard at a later time, in ms."""
    plan = Plan()
    silent, other = plan.driver(), plan.driver(50002)
    silent.change(0, ENTER)
    silent.moves([8.0, 16.0])
    other.execute(until, "CurJnt")
    return plan


def test_stays_of_clients_that_are_forgotten_are_not_kept() -> None:
    (stay,) = left_on(9000).stays()
    assert stay.exit.reason is ExitReason.SILENT
    diagnosis = Diagnosis()
    diagnosis._on_slave_sessions([stay])
    assert list(diagnosis._clients) == []
    assert diagnosis.findings() == ()


def test_of_clients_that_are_gone_the_latest_few_are_remembered() -> None:
    gone: list[str] = []
    clients = ClientRegistry(lambda client: gone.append(str(client.conversation.client)))
    plan = Plan()
    for port in range(1, MAX_CLOSED_CLIENTS + 4):
        plan.driver(port).execute(port * 10.0, "CurJnt")
    for call in plan.track():
        assert isinstance(call, Call)
        clients.client_of(call)
        clients.on_conversation_closed(call.conversation)
    assert len(list(clients)) == MAX_CLOSED_CLIENTS
    assert gone == ["10.0.0.2:1", "10.0.0.2:2", "10.0.0.2:3"]


def test_a_diagnosis_lets_go_of_a_client_that_is_gone_and_tells_what_it_left_on() -> None:
    diagnosis = Diagnosis()
    pipeline = Pipeline(diagnosis)
    script = left_on(60_000)
    script.track()
    for seen in script.script.seen:
        pipeline.add(seen)
    for conversation in dict.fromkeys(seen.flow.conversation for seen in script.script.seen):
        pipeline.close_conversation(conversation)
    found = diagnosis.findings(script.script.seen[-1].time)
    assert "quit-in-slave-mode" in [finding.rule for finding in found]
