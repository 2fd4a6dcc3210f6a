"""Scenario files: what they say, and what is wrong with them."""

from __future__ import annotations

import re
from pathlib import Path
from typing import get_args

import pytest

from bcapscope.faults.document import DocumentError
from bcapscope.faults.fault_kinds import AnyFault, DropFault
from bcapscope.protocol.codec.variant import VT
from bcapscope.protocol.retry.responder import Defect
from bcapscope.simulator.kinematics import AXIS_LIMITS
from bcapscope.simulator.machine import Machine
from bcapscope.simulator.profile import NoArgument
from bcapscope.simulator.scenario import ScenarioTransport, load_scenario, read_scenario
from bcapscope.simulator.scenario_event import AnyEvent, EmergencyStop
from bcapscope.simulator.scenario_files import bundled_scenarios
from bcapscope.simulator.variable_memory import VariableMemory

WHOLE = """
title: All of it
story: Everything happens.
shows: retried
then: [underflow]
client: {session: motion, over: tcp, mode: 0x202, options: ",WDT=100"}
profile: cserver
defects: [serial-zero]
no_argument: always
start:
  joints: [1, 2, 93, 4, 5, 6]
  mode: teach-check
  token: false
  motor: true
  motor_time: 3s
  speed: 50
  type_name: VS-060
  errors: [0x84201482, E_FAIL]
  empty: ['@current_angle']
  emergency: true
  arm_taken: true
  udp_clients: 3
  tcp_clients: 20
variables: {I1: 5, F2: 1.5, P3: [1, 2, 3, 4, 5, 6, 5], S4: text, IO128: true, iob136: 255}
tasks: {loaded: [RobSlave, Pro7], running: [robslave]}
limits:
  J1: {low: 0, high: 10.5}
  J6: {speed: 20, acceleration: 30}
faults:
  - {action: drop, if: command == slvMove, probability: 10%, times: 3}
in_slave_mode:
  - {action: emergency-stop, after: 500ms}
seed: 42
"""


def test_everything_that_can_be_said() -> None:
    scenario = read_scenario(WHOLE)
    start = scenario.initial_state(epoch=7)
    assert (start.joints, start.epoch) == ((1, 2, 93, 4, 5, 6, 0, 0), 7)
    assert (start.mode, start.token, start.motor, start.motor_time) == (2, False, True, 3_000_000_000)
    assert start.empty == ("@CURRENT_ANGLE",)
    assert (start.speed, start.type_name, start.errors) == (50, "VS-060", (0x84201482, 0x80004005))
    assert (start.emergency, start.arm_taken, start.udp_clients, start.tcp_clients) == (True, True, 3, 20)
    assert (start.tasks, start.running) == (("RobSlave", "Pro7"), ("robslave",))
    assert start.limits[0] == AXIS_LIMITS[0]._replace(low=0, high=10.5)
    assert start.limits[1:5] == AXIS_LIMITS[1:5]
    assert start.limits[5] == AXIS_LIMITS[5]._replace(speed=20, acceleration=30)
    assert scenario.controller_profile.defects is Defect.SERIAL_ZERO
    assert scenario.controller_profile.no_argument is NoArgument.ALWAYS
    assert scenario.client.over is ScenarioTransport.TCP
    assert isinstance(scenario.faults[0], DropFault)
    assert isinstance(scenario.in_slave_mode[0], EmergencyStop)
    assert scenario.seed == 42


def test_variables_are_written() -> None:
    memory = VariableMemory(VT.R8)
    read_scenario(WHOLE).write_variables(memory)
    places = (("I", 1), ("F", 2), ("P", 3), ("S", 4), ("IO", 128), ("IOB", 136))
    values = [memory.read(*place).value for place in places]
    assert values == [5, 1.5, (1, 2, 3, 4, 5, 6, 5), "text", True, 255]


def test_a_machine_begins_as_it_is_told() -> None:
    scenario = read_scenario(WHOLE)
    machine = Machine(scenario.controller_profile, scenario.initial_state())
    assert [alarm.code for alarm in machine.active_alarms] == [0x8150101A, 0x80004005, 0x84201482]
    assert machine.tasks == {"robslave": 3, "pro7": 2}
    assert (machine.emergency, machine.owner, machine.speeds.external) == (True, 0, 50)


def test_a_title_is_enough() -> None:
    scenario = read_scenario("title: Nothing happens")
    assert scenario.initial_state().limits == AXIS_LIMITS
    assert scenario.controller_profile.defects is Defect.NONE


def _in(what: str) -> str:
    return f"title: x\n{what}"


@pytest.mark.parametrize(
    ("text", "error"),
    [
        ("", "line 1: Expected object, got null"),
        ("- 1", "line 1: Expected object, got array"),
        ("title: x: y", "line 1: this is not YAML: mapping values are not allowed"),
        ("shows: retried", "line 1: title is missing"),
        ("title: ''", "line 1: title: Expected str of length >= 1"),
        (_in("titel: y"), "line 2: there is no field 'titel', did you mean 'title'?"),
        (_in("profile: rc6"), "line 2: profile: 'rc6' is not one of rc7, rc8, rc9, cserver"),
        (_in("defects: [all]"), "line 2: defects[0]: 'all' is not one of forgets-first, serial-zero"),
        (_in("client: {over: tpc}"), "line 2: client.over: 'tpc' is not one of udp, tcp"),
        (_in("start:\n  motr: true"), "line 3: start: there is no field 'motr', did you mean 'motor'?"),
        (_in("start:\n  motor: 1"), "line 3: start.motor: Expected bool, got int"),
        (
            _in("start: {mode: auto}"),
            "line 2: start.mode: 'auto' is not one of manual, teach-check, automatic",
        ),
        (_in("start:\n  motor_time: 3"), "line 3: start.motor_time: 3 is not a duration"),
        (_in("start: {speed: 0}"), "line 2: start.speed: Expected float >= 0.1"),
        (_in("start: {udp_clients: 21}"), "line 2: start.udp_clients: Expected int <= 20"),
        (_in("start:\n  errors: [E_FAIL,\n   S_OK]"), "line 4: start.errors[1]: S_OK is not an error"),
        (
            _in("start: {empty: ['@CURRENT_ANGEL']}"),
            "line 2: start.empty[0]: the robot has no variable @CURRENT_ANGEL",
        ),
        (_in("start: {errors: [E_FIAL]}"), "line 2: start.errors[0]: 'E_FIAL' is not an HRESULT"),
        (_in("start: {joints: [1, 2]}"), "line 2: start.joints: Expected array of length >= 6"),
        (
            _in("start:\n  joints: [0, 0, 0, 0, 130, 0]"),
            "line 3: start.joints[4]: J5 is beyond its limits",
        ),
        (_in("variables:\n  Q1: 3"), "line 3: variables.Q1: there is no such variable"),
        (_in("variables:\n  I100: 3"), "line 3: variables.I100: no variable has that number"),
        (_in("variables:\n  I1: [1, 2]"), "line 3: variables.I1: the value does not fit"),
        (_in("variables:\n  P1: [.nan]"), "line 2: variables: Expected float"),
        (_in("tasks: {running: [Pro9]}"), "line 2: tasks.running[0]: Pro9 is not loaded"),
        (_in("limits:\n  J7: {}"), "line 3: limits: there is no field 'J7'"),
        (_in("limits:\n  J1: {low: 3, high: 2}"), "line 3: limits.J1.low: is above high"),
        (_in("limits: {J2: {speed: 0}}"), "line 2: limits.J2.speed: Expected float > 0.0"),
        (_in("faults: [{times: 3}]"), "line 2: faults[0]: action is missing, such as"),
        (
            _in("faults:\n- {action: emergency-stp}"),
            "line 3: faults[0].action: there is no action 'emergency-stp', did you mean 'emergency-stop'?",
        ),
        (
            _in("faults:\n- {action: drop, if: comand == a}"),
            "line 3: faults[0].if: there is no field 'comand'",
        ),
        (_in("faults: [{action: error}]"), "line 2: faults[0]: code is missing"),
        (_in("faults: [{action: error, code: S_OK}]"), "line 2: faults[0].code: S_OK is not an error"),
        (_in("faults: [{action: mode, to: auto}]"), "line 2: faults[0].to: 'auto' is not one of manual,"),
        (_in("faults: [{action: reset, times: 2}]"), "line 2: faults[0].times: needs if or try"),
        (_in("faults: [{action: error, code: E_FAIL, for: 2s}]"), "line 2: faults[0].for: needs if or try"),
        (_in("faults: [{action: reset, probability: 5%}]"), "line 2: faults[0].probability: needs if or try"),
        (_in("faults: [{action: reset, direction: response}]"), "line 2: faults[0].direction: events happen"),
        (
            _in("faults: [{action: move, joints: [0, 0, 0, 0, 0, 0], sped: 3}]"),
            "line 2: faults[0]: there is no field 'sped', did you mean 'speed'?",
        ),
        (
            _in("faults: [{action: drop, name: a}]\nin_slave_mode:\n- {action: drop, name: a}"),
            "line 4: in_slave_mode[0].name: another entry is also named a",
        ),
        (_in("seed: x"), "line 2: seed: Expected int, got str"),
    ],
)
def test_an_error_names_line_and_field(text: str, error: str) -> None:
    with pytest.raises(DocumentError) as caught:
        read_scenario(text)
    assert str(caught.value).startswith(error)


def test_scenarios_by_name_and_from_files(tmp_path: Path) -> None:
    assert load_scenario("emergency-stop") == read_scenario(bundled_scenarios()["emergency-stop"])
    path = tmp_path / "own.yaml"
    path.write_text("title: Täglich", encoding="utf-8")
    assert load_scenario(str(path)).title == "Täglich"
    path.write_bytes(b"title: \xff")
    with pytest.raises(DocumentError, match="this is not text in UTF-8"):
        load_scenario(str(path))
    with pytest.raises(LookupError, match="did you mean 'emergency-stop'"):
        load_scenario("emergency-step")
    with pytest.raises(FileNotFoundError):
        load_scenario(str(tmp_path / "none.yaml"))


def test_the_examples_in_the_documentation_can_be_read() -> None:
    page = (Path(__file__).parents[2] / "docs" / "simulator.md").read_text(encoding="utf-8")
    examples = re.findall(r"^```yaml\n(title:.*?)^```", page, re.DOTALL | re.MULTILINE)
    scenarios = [read_scenario(example) for example in examples]
    assert len(scenarios) > 1
    actions = {kind.__struct_config__.tag for part in (AnyFault, AnyEvent) for kind in get_args(part)}
    assert {each.action for scenario in scenarios for each in scenario.faults} <= actions
    assert actions - {"pass"} <= set(re.findall(r"`([a-z-]+)`", page))


@pytest.mark.skipif(not Path("/dev/zero").exists(), reason="there is no file without an end")
def test_a_file_without_an_end_is_not_read_to_its_end(tmp_path: Path) -> None:
    path = tmp_path / "endless.yaml"
    path.symlink_to("/dev/zero")
    with pytest.raises(DocumentError, match="longer than the limit of 1048576 characters"):
        load_scenario(str(path))
