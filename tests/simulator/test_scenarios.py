"""The scenarios that come with bcapscope: each played, recorded, and its first cause named."""

from __future__ import annotations

import pytest

from bcapscope.analysis.rules.rule_table import RULES
from bcapscope.simulator.scenario import Scenario, read_scenario
from bcapscope.simulator.scenario_files import bundled_scenarios
from tests.analysis.scenes import diagnose_bytes
from tests.simulator.theatre import perform, rehearse

_SCENARIOS = {name: read_scenario(text) for name, text in bundled_scenarios().items()}

every = pytest.mark.parametrize(
    "scenario", [pytest.param(scenario, id=name) for name, scenario in _SCENARIOS.items()]
)


@every
def test_the_first_cause_is_what_the_scenario_shows(scenario: Scenario) -> None:
    findings, _ = diagnose_bytes(perform(scenario))
    assert findings[0].rule == scenario.shows
    assert set(scenario.then) <= {finding.rule for finding in findings[1:]}


@every
def test_without_the_scenario_nothing_is_wrong_with_its_client(scenario: Scenario) -> None:
    findings, seen = diagnose_bytes(rehearse(scenario))
    assert findings == ()
    assert seen.calls > 10


@every
def test_a_scenario_says_what_it_is_about(scenario: Scenario) -> None:
    assert len(scenario.title) <= 110
    assert not scenario.title.endswith(".")
    assert scenario.story.endswith((".", ")"))
    assert {scenario.shows, *scenario.then} <= set(RULES)


def test_many_rules_are_shown() -> None:
    assert len(_SCENARIOS) >= 12
    assert len({scenario.shows for scenario in _SCENARIOS.values()}) >= 20


def test_the_same_seed_gives_the_same_traffic() -> None:
    scenario = _SCENARIOS["lost-requests"]
    assert perform(scenario) == perform(scenario)
    assert perform(scenario, seed=8) != perform(scenario)


def test_the_first_defect_of_the_c_server_can_be_switched_off() -> None:
    scenario = read_scenario(bundled_scenarios()["forgetful-server"] + "defects: []\n")
    findings, _ = diagnose_bytes(perform(scenario))
    assert [finding.rule for finding in findings] == ["retried"]


@pytest.mark.parametrize("over", ["udp", "tcp"])
@pytest.mark.parametrize(
    ("profile", "mode"),
    [("rc7", mode) for mode in (0x002, 0x102)] + [("rc8", mode) for mode in (0x002, 0x102, 0x202)],
)
def test_a_session_in_any_slave_mode_has_nothing_wrong(profile: str, mode: int, over: str) -> None:
    scenario = read_scenario(f"title: x\nprofile: {profile}\nclient: {{mode: {mode}, over: {over}}}")
    findings, seen = diagnose_bytes(perform(scenario))
    assert findings == ()
    assert seen.calls > 150
