"""The profile of a simulator for which nobody chose one."""

from __future__ import annotations

from pathlib import Path

from bcapscope.simulator.profile import DEFAULT_PROFILE, PROFILES
from bcapscope.simulator.scenario import Scenario
from bcapscope.tui.controller_access.builtin_simulator import run_builtin_simulator
from bcapscope.tui.screens import tester_screen
from tests.cli.run import run_here


def test_all_simulators_have_the_same_default() -> None:
    assert Scenario(title="").controller_profile is PROFILES[DEFAULT_PROFILE]
    assert tester_screen.TesterOptions(Path(), Path()).profile == DEFAULT_PROFILE
    help_ = " ".join(run_here("sim", "--help").out.split())
    assert f"without a scenario, {DEFAULT_PROFILE}." in help_
    assert "Default: as for `bcapscope sim`" in " ".join(run_here("tui", "--help").out.split())


def test_the_built_in_simulator_has_it_too() -> None:
    with run_builtin_simulator() as simulator:
        told = run_here("ping", f"{simulator.host}:{simulator.port}", "-n", "1").out
    versions = [name for name, profile in PROFILES.items() if f"version {profile.version}," in told]
    assert DEFAULT_PROFILE in versions
    assert len(versions) < len(PROFILES)
