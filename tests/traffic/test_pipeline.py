"""Subscribers get each event once, in order, and the pipeline computes no more than they need."""

from __future__ import annotations

from collections.abc import Sequence

import pytest
from hypothesis import given

from bcapscope.analysis.diagnosis import Diagnosis
from bcapscope.analysis.rules.rule_checker import RuleChecker
from bcapscope.traffic import pipeline as pipeline_module
from bcapscope.traffic.call import Call, StrayReply
from bcapscope.traffic.call_verdict import Outcome
from bcapscope.traffic.handle_tracker import HandleTracker, TrackedObject
from bcapscope.traffic.joining.joiner import Joiner
from bcapscope.traffic.observation import Conversation, Observation
from bcapscope.traffic.pairing_windows import EXECUTION_NS
from bcapscope.traffic.pipeline import CallCollector, Pipeline, PipelineSubscriber
from bcapscope.traffic.slave_mode_tracker import SlaveModeChange, SlaveModeEffect, SlaveModeTracker
from tests.analysis.driving import ENTER, Plan, Step, joints, steps
from tests.traffic.playbook import CONNECT, MOVE, POSE, START_SERVICE, Script, i4, run_pipeline, text


class Singles(PipelineSubscriber):
    """Writes down all events, each call by itself."""

    def __init__(self) -> None:
        self.events: list[tuple[str, int]] = []
        self.targets: dict[int, str] = {}

    def on_frame(self, observation: Observation) -> None:
        self.events.append(("frame", observation.number))

    def on_call(self, call: Call, target: TrackedObject | None) -> None:
        self.events.append(("call", call.number))
        if target is not None:
            self.targets[call.number] = target.label

    def on_stray_reply(self, stray: StrayReply) -> None:
        self.events.append(("stray", stray.observation.number))

    def on_conversation_closed(self, conversation: Conversation) -> None:
        self.events.append(("closed", conversation.client.port))


class Runs(Singles):
    """Takes alike set points at once, and needs the objects of the handles."""

    needs_targets = True

    def __init__(self) -> None:
        super().__init__()
        self.runs: list[list[int]] = []
        self.changes: list[SlaveModeChange] = []

    def on_set_points(self, calls: Sequence[Call]) -> None:
        self.runs.append([call.number for call in calls])
        for call in calls:
            self.on_call(call, None)

    def on_slave_mode(self, change: SlaveModeChange) -> None:
        self.events.append(("mode", change.call.number))
        self.changes.append(change)


def driven() -> Plan:
    plan = Plan()
    driver = plan.driver()
    driver.change(0, ENTER)
    driver.moves(8.0 * n + 8 for n in range(20))
    driver.move(200, retries=(2.0,))
    driver.moves(8.0 * n + 208 for n in range(5))
    driver.execute(300, "CurJnt", result=joints(1.0))
    driver.moves(8.0 * n + 308 for n in range(5))
    driver.change(400, 0)
    plan.track()
    return plan


def test_frames_come_before_the_calls_that_they_complete() -> None:
    script = Script()
    client = script.client()
    client.ask(0, 1, 0, START_SERVICE)
    client.reply(1, 1)
    client.reply(2, 7)
    singles = Singles()
    run_pipeline(script.seen, singles)
    assert singles.events == [("frame", 1), ("frame", 2), ("frame", 3), ("stray", 3), ("call", 1)]


def test_alike_set_points_come_as_one_event() -> None:
    runs = Runs()
    run_pipeline(driven().script.seen, runs)
    grouped = [number for run in runs.runs for number in run]
    # 2 begins a run, 22 was sent twice, 28 follows another call.
    assert grouped == [*range(3, 22), *range(23, 28), *range(30, 34)]
    assert max(map(len, runs.runs)) > 1


def test_a_subscriber_that_takes_no_runs_gets_each_call_in_the_same_order() -> None:
    singles, runs = Singles(), Runs()
    run_pipeline(driven().script.seen, singles, runs)
    alone = Singles()
    run_pipeline(driven().script.seen, alone)
    without_modes = [event for event in runs.events if event[0] != "mode"]
    assert singles.events == without_modes == alone.events


def test_a_run_holds_set_points_of_one_robot() -> None:
    script = Script()
    client = script.client()
    for n in range(12):
        client.ask(8 * n, n + 1, 0, (64, (i4(1 + n % 2), text("slvMove"), POSE)))
        client.reply(8 * n + 1, n + 1, 0, 0, POSE)
    runs = Runs()
    run_pipeline(script.seen, runs)
    assert runs.runs == []


def test_changes_of_slave_mode_follow_their_calls() -> None:
    runs = Runs()
    run_pipeline(driven().script.seen, runs)
    assert [(each.call.number, each.effect, each.mode) for each in runs.changes] == [
        (1, SlaveModeEffect.MODE_CHANGED, ENTER),
        (34, SlaveModeEffect.MODE_CHANGED, 0),
    ]
    places = [runs.events.index((name, 34)) for name in ("call", "mode")]
    assert places[1] == places[0] + 1


@pytest.mark.parametrize(("cycle", "expected"), [(8, [[4, 5, 6]]), (8000, [[4], [5], [6]])])
def test_targets_are_the_objects_of_the_handles(cycle: int, expected: list[list[int]]) -> None:
    script = Script()
    client = script.client()
    client.ask(0, 1, 0, (CONNECT, (text("ctrl"), text(""), text(""), text(""))))
    client.reply(1, 1, 0, 0, i4(9))
    client.ask(2, 2, 0, (7, (i4(9), text("Arm"), text(""))))
    client.reply(3, 2, 0, 0, i4(1))
    for n in range(4):
        client.ask(10 + cycle * n, 3 + n, 0, MOVE)
        client.reply(11 + cycle * n, 3 + n, 0, 0, POSE)
    singles, runs = Singles(), Runs()
    run_pipeline(script.seen, singles, runs)
    assert runs.targets == {2: "ctrl", 3: "Arm"}
    assert runs.runs == expected
    assert singles.targets == {**runs.targets, 4: "Arm", 5: "Arm", 6: "Arm"}


def test_nothing_is_followed_that_nobody_needs(monkeypatch: pytest.MonkeyPatch) -> None:
    def fail(*_: object, **__: object) -> None:
        raise AssertionError

    for name in ("HandleTracker", "SlaveModeTracker", "AlikeSetPoints"):
        monkeypatch.setattr(pipeline_module, name, fail)
    calls = CallCollector()
    run_pipeline(driven().script.seen, calls)
    assert len(calls.calls) == 34


def test_a_closed_conversation_gives_its_calls_first_and_is_forgotten() -> None:
    script = Script()
    client = script.client()
    client.ask(0, 1, 0, START_SERVICE)
    client.reply(1, 1)
    runs, handles = Runs(), HandleTracker()
    pipeline = Pipeline(runs, handles=handles)
    for seen in script.seen:
        pipeline.add(seen)
    assert pipeline.has_open_calls
    pipeline.close_conversation(client.conversation)
    assert not pipeline.has_open_calls
    assert runs.events[-3:] == [("call", 1), ("mode", 1), ("closed", 50001)]
    (session,) = handles.sessions()
    assert session.started_by_call == 1


@pytest.mark.parametrize(("is_closed", "targets"), [(False, {2: "ctrl"}), (True, {})])
def test_a_client_that_comes_again_has_no_handles_yet(is_closed: bool, targets: dict[int, str]) -> None:
    script = Script()
    client = script.client()
    client.ask(0, 1, 0, (CONNECT, (text("ctrl"), text(""), text(""), text(""))))
    client.reply(1, 1, 0, 0, i4(9))
    client.ask(200, 2, 0, (7, (i4(9), text("Arm"), text(""))))
    client.reply(201, 2, 0, 0, i4(1))
    singles = Singles()
    pipeline = Pipeline(singles, handles=HandleTracker())
    for seen in script.seen[:2]:
        pipeline.add(seen)
    if is_closed:
        pipeline.close_conversation(client.conversation)
    for seen in script.seen[2:]:
        pipeline.add(seen)
    pipeline.finish()
    assert singles.targets == targets


@pytest.mark.parametrize(
    ("after", "outcome"), [(0, Outcome.CAPTURE_ENDED), (EXECUTION_NS, Outcome.UNANSWERED)]
)
def test_traffic_may_end_after_the_last_frame(after: int, outcome: Outcome) -> None:
    script = Script()
    script.client().ask(0, 1, 0, MOVE)
    calls = CallCollector()
    pipeline = Pipeline(calls)
    pipeline.add(script.seen[0])
    pipeline.finish(script.seen[0].time + after if after else 0)
    assert [call.outcome for call in calls.calls] == [outcome]


def test_later_traffic_of_another_client_shows_that_a_client_gave_up() -> None:
    script = Script()
    client, other = script.client(50001), script.client(50002)
    client.ask(0, 1, 0, MOVE)
    client.ask(8, 2, 1, MOVE)
    other.ask(1000, 1, 0, MOVE)
    calls = CallCollector()
    pipeline = Pipeline(calls)
    for seen in script.seen:
        pipeline.add(seen)
    pipeline.finish()
    assert [call.outcome for call in calls.calls] == [Outcome.UNANSWERED, Outcome.CAPTURE_ENDED]


@given(steps)
def test_runs_change_the_order_of_nothing(played: list[Step]) -> None:
    plan = Plan()
    drivers = [plan.driver(50001), plan.driver(50002, handle=2), plan.driver(50003)]
    now = 0.0
    for step in played:
        now += step.after
        drivers[step.who].execute(
            now, step.command, step.parameter, code=step.code, result=step.result, takes=step.takes
        )
    plan.track()
    singles, runs = Singles(), Runs()
    run_pipeline(plan.script.seen, singles)
    run_pipeline(plan.script.seen, runs)
    assert [event for event in runs.events if event[0] != "mode"] == singles.events


def test_a_checker_that_needs_every_set_point_gets_each_one(monkeypatch: pytest.MonkeyPatch) -> None:
    seen: dict[str, list[int]] = {}

    class EveryChecker(RuleChecker):
        needs_every_set_point = True

        def wants_call(self, *_: object) -> bool:
            return True

        def on_call(self, call: Call, client: object) -> None:
            seen.setdefault(type(self).__name__, []).append(call.number)

    class OtherChecker(EveryChecker):
        needs_every_set_point = False

    monkeypatch.setattr("bcapscope.analysis.diagnosis.CHECKERS", (EveryChecker, OtherChecker))
    run_pipeline(driven().script.seen, Diagnosis())
    assert seen["EveryChecker"] == list(range(1, 35))
    assert seen["OtherChecker"] == [1, 2, 22, 28, 29, 34]


def test_a_closed_conversation_begins_a_new_series_and_has_no_slave_mode() -> None:
    runs, slave_mode = Runs(), SlaveModeTracker()
    pipeline = Pipeline(runs, slave_mode=slave_mode)
    plan = Plan()
    driver = plan.driver()
    driver.change(0, ENTER)
    driver.moves(8.0 * n + 8 for n in range(4))
    plan.track()
    for seen in plan.script.seen:
        pipeline.add(seen)
    pipeline.close_conversation(plan.script.seen[0].flow.conversation)
    assert runs.runs == [[3, 4, 5]]
    assert slave_mode.find(plan.script.seen[0].flow.conversation).mode is None
    for seen in plan.script.seen[2:]:
        pipeline.add(seen._replace(time=seen.time + 10**9))
    pipeline.finish()
    assert runs.runs == [[3, 4, 5], [7, 8, 9]]


def test_a_run_holds_set_points_of_one_client() -> None:
    script = Script()
    clients = [script.client(port) for port in (50001, 50002)]
    for number in range(1, 5):
        for offset, client in enumerate(clients):
            client.ask(8 * number + 4 * offset, number, 0, MOVE)
            client.reply(8 * number + 4 * offset + 1, number, 0, 0, POSE)
    runs = Runs()
    run_pipeline(script.seen, runs)
    assert [number for name, number in runs.events if name == "call"] == list(range(1, 9))
    assert sorted(number for run in runs.runs for number in run) == list(range(3, 9))
    assert all(len({number % 2 for number in run}) == 1 for run in runs.runs)


def test_a_joiner_changes_nothing_about_a_conversation_with_one_leg() -> None:
    script = driven().script
    singles, joined = Singles(), Singles()
    run_pipeline(script.seen, singles)
    joiner = Joiner()
    pipeline = Pipeline(joined, joiner=joiner)
    for seen in script.seen:
        pipeline.add(seen)
    assert joiner.passing == {seen.flow for seen in script.seen}
    pipeline.finish()
    for name in ("frame", "call"):
        events = [[event for event in each.events if event[0] == name] for each in (singles, joined)]
        assert events[0] == events[1]
