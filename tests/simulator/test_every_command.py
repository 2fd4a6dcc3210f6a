"""Every command of the catalogue is answered on every profile that documents it."""

from __future__ import annotations

from collections.abc import Mapping

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from bcapscope.protocol.codec.frame import Frame
from bcapscope.protocol.codec.variant import EMPTY, VT, Variant, vt_name
from bcapscope.protocol.tables.command_catalogue import CommandSpec, commands_of
from bcapscope.protocol.tables.hresult import E_NOTIMPL, S_EXECUTING
from bcapscope.simulator.argument_values import boolean, bstr, float_array, i4, r8, variant_array
from bcapscope.simulator.behaviours import Certainty, read_behaviours
from bcapscope.simulator.call_context import accept_without_effect
from bcapscope.simulator.call_outcome import RefusalCode
from bcapscope.simulator.function_handlers import CONTROLLER_COMMANDS, TASK_COMMANDS
from bcapscope.simulator.machine import InitialState
from bcapscope.simulator.robot_commands import ROBOT_COMMANDS
from tests.simulator.simulation import Operator, Simulation, ints
from tests.strategies import variants as any_variant

CONTROLLER, EXTENSION, ROBOT, TASK = 17, 28, 64, 87

ALL, LATER = ("rc7", "rc8", "rc9", "cserver"), ("rc8", "rc9", "cserver")
DOCUMENTED: Mapping[str, tuple[str, ...]] = {
    "": ALL,
    "RC7": ("rc7",),
    "RC8 and later": LATER,
    "RC8 from 1.4.0": LATER,
    "RC9": ("rc9",),
    "COBOTTA": ("rc8", "cserver"),
    "COBOTTA PRO": ("rc9",),
    "Hand0": LATER,
    "Comm": LATER,
    "Pallet": LATER,
}
"""Profiles of each text in a row's `controllers`."""

NOT_ON_RC7 = frozenset(("StoState", "ManualReset", "TakeArmState", "ManualResetPreparation"))
"""Named for no controller, but by the sources of RC8 and later only."""

OTHER_PROVIDERS = frozenset(("EVP2", "ESC11"))
"""Rows that another provider answers, which Controller_Connect refuses."""

HOME = "J(0, 0, 90, 0, 90, 0)"
POSE = "P(400, 100, 500, 180, 0, 90)"
CORNERS = tuple(bstr(f"P({x}, {y}, 50, 180, 0, 180, 5)") for x in (600, 400) for y in (-100, 100))
SIX = float_array(VT.R8, (0.0,) * 6)

PARAMETERS: Mapping[str, Variant] = {
    "slvChangeMode": i4(0),
    "slvSendFormat": i4(0x20),
    "slvRecvFormat": i4(0x14),
    "TakeArm": ints(0, 1),
    "TakeArmState": i4(-1),
    "Motor": ints(1, 0),
    "ExtSpeed": r8(50),
    "GetToolDef": i4(1),
    "SetToolDef": variant_array(i4(1), bstr(POSE)),
    "SetWorkDef": variant_array(i4(1), bstr(POSE)),
    "ConvertPosWork": variant_array(bstr(POSE), i4(0), i4(1)),
    "Dev": Variant.array(VT.BSTR, (POSE, "P(10, 0, 0, 0, 0, 0)")),
    "DevH": variant_array(
        variant_array(float_array(VT.R8, (400, 0, 500, 180, 0, 90, 5)), bstr("P")),
        bstr("P(1, 2, 3, 0, 0, 0)"),
    ),
    "J2P": bstr(HOME),
    "P2T": bstr(POSE),
    "T2J": variant_array(float_array(VT.R8, (400, 0, 500, 0, 1, 0, 0, 0, -1, 5)), bstr("T")),
    "OutRange": variant_array(bstr(HOME), i4(-1), i4(-1)),
    "CheckVirtualFence": bstr(HOME),
    "MotionComplete": ints(-1, 1),
    "MotionSkip": ints(-1, 0),
    "Approach": variant_array(i4(1), bstr(HOME), bstr("@P 0")),
    "Depart": variant_array(i4(1), bstr("@P 0")),
    "DriveEx": Variant.array(VT.BSTR, ("(1, 5)", "")),
    "DriveAEx": Variant.array(VT.BSTR, ("(1, 5)", "")),
    "GetSrvData": i4(4),
    "RobInfo": i4(1),
    "GetLogRecord": i4(0),
    "PayLoad": variant_array(i4(500), float_array(VT.R8, (0, 0, 50)), float_array(VT.R8, (0, 0, 0))),
    "SpeedMode": i4(1),
    "HighPathAccuracy": boolean(True),
    "GrvOffset": boolean(True),
    "GetMechaButtonState": i4(0),
    "ClearMechaButtonState": i4(0),
    "SceneInfo": ints(0, 0),
    "SetAreaEnabled": variant_array(i4(1), boolean(True)),
    "GetAreaEnabled": ints(1),
    "ForceCtrl": ints(1, 1, 1),
    "ForceParam": variant_array(i4(1), i4(1), SIX, *(SIX,) * 7, i4(0), SIX, r8(5.5), r8(5.6)),
    "ForceValue": ints(13, 0),
    "ForceSensor": ints(0),
    "ForceWaitCondition": variant_array(SIX, SIX),
    "TwofgGrip": variant_array(r8(5), i4(20), i4(50), i4(1)),
    "TwofgRelease": variant_array(r8(30), i4(1)),
    "GetErrorDescription": i4(0x84201482 - (1 << 32)),
    "GetCurErrorInfo": i4(0),
    "GetErrorLog": i4(0),
    "SysInfo": i4(0),
    "PutAutoMode": i4(2),
    "HandMoveA": ints(20, 100),
    "HandMoveR": ints(-5, 100),
    "HandMoveH": variant_array(i4(10), boolean(True)),
    "HandMoveAH": variant_array(r8(5), i4(100), r8(10)),
    "HandMoveRH": variant_array(r8(-5), i4(100), r8(10)),
    "HandMoveVH": variant_array(r8(60), boolean(True)),
    "open": i4(4),
    "close": i4(4),
    "clear": i4(4),
    "State": i4(4),
    "count": i4(4),
    "input": i4(4),
    "CalcPos": variant_array(i4(3), i4(5), i4(20), *CORNERS, i4(2), i4(1)),
}
"""What a command is called with that does not take EMPTY, in the shape that samples use."""

FIRST: Mapping[str, str] = {"SyncTimeEnd": "SyncTimeStart", "SyncMoveEnd": "SyncMoveStart"}
"""What must be called before."""


def _is_documented(known: CommandSpec, profile: str) -> bool:
    if profile == "rc7" and known.name in NOT_ON_RC7:
        return False
    return profile in DOCUMENTED[known.controllers]


CASES = [
    (profile, known)
    for profile in ALL
    for function_id in (CONTROLLER, EXTENSION, ROBOT, TASK)
    for known in commands_of(function_id)
    if known.controllers not in OTHER_PROVIDERS and _is_documented(known, profile)
]


def _ready(profile: str, known: CommandSpec) -> Operator:
    """Return a client that is ready for a command: an object lies between the fingers."""
    operator = Operator(Simulation(profile, InitialState(object_width=12.0)), tcp=True)
    operator.ready()
    if known.name in ("GetCurErrorInfo", "GetErrorLog"):
        operator.simulation.machine.raise_error(0x84204051, operator.simulation.now)
    if known.name == "GetLogRecord":
        operator.robot("StartLog")
        operator.simulation.wait(20)
    if known.name == "slvMove":
        assert operator.slave(0x001).hresult == 0
    return operator


def _parameter(operator: Operator, known: CommandSpec) -> Variant:
    if known.name == "slvMove":
        here = operator.robot("CurPos").value
        assert isinstance(here, tuple)
        return float_array(VT.R8, [float(str(each)) for each in here])
    return PARAMETERS.get(known.name, EMPTY)


def _target(operator: Operator, known: CommandSpec) -> tuple[str, Variant]:
    """Return the function that takes a command, and the object to call it on."""
    if known.function_id == CONTROLLER:
        return "Controller_Execute", operator.controller
    if known.function_id == ROBOT:
        return "Robot_Execute", operator.arm
    if known.function_id == TASK:
        return "Task_Execute", operator.get("Controller_GetTask", operator.controller, "RobSlave")
    return "Extension_Execute", operator.get(
        "Controller_GetExtension", operator.controller, known.controllers
    )


@pytest.mark.parametrize(
    ("profile", "known"),
    CASES,
    ids=[f"{profile}-{known.function_id}-{known.name}" for profile, known in CASES],
)
def test_a_documented_command_is_answered(profile: str, known: CommandSpec) -> None:
    operator = _ready(profile, known)
    function, target = _target(operator, known)
    if known.name in FIRST:
        assert operator.call(function, target, bstr(FIRST[known.name]), EMPTY).hresult == 0
    reply = operator.call(function, target, bstr(known.name), _parameter(operator, known))
    assert reply.hresult not in (E_NOTIMPL, RefusalCode.INVALID_COMMAND)
    assert reply.hresult == 0, hex(reply.hresult)
    promised = set(known.result_types) - {"VT_EMPTY", "none"}
    if promised:
        assert reply.vt is not None
        assert vt_name(reply.vt) in (_on_rc7(promised) if profile == "rc7" else promised)
    else:
        assert reply.value is None


def _on_rc7(types: set[str]) -> set[str]:
    """RC7 answers poses in single precision."""
    return types | {each.replace("VT_R8|", "VT_R4|") for each in types}


NUMBERS = st.integers(-3, 110).map(i4) | st.floats(allow_nan=False).map(r8) | st.booleans().map(boolean)
TEXTS = st.sampled_from((HOME, POSE, "P1", "@E", "@P 10", "J", "", "SPEED=F1,NEXT", "(1,5)", "1")).map(bstr)
LIKELY = st.recursive(
    NUMBERS | TEXTS,
    lambda inner: st.lists(inner, max_size=9).map(lambda each: variant_array(*each)),
    max_leaves=12,
)
"""Parameters that are nearly right."""


@settings(max_examples=300, deadline=None)
@given(st.sampled_from([known for profile, known in CASES if profile == "rc8"]), any_variant() | LIKELY)
def test_any_parameter_is_answered_or_refused(known: CommandSpec, parameter: Variant) -> None:
    operator = Operator(Simulation("rc8", InitialState(motor=True, object_width=12.0)), tcp=True)
    operator.ready()
    function, target = _target(operator, known)
    raw = operator.send(function, target, bstr(known.name), parameter) + operator.simulation.wait(3_700_000)
    replies = [Frame(output.data) for output in raw if Frame(output.data).code != S_EXECUTING]
    assert len(replies) == 1
    assert replies[0].code not in (E_NOTIMPL, RefusalCode.INVALID_COMMAND)


def test_each_generation_is_walked() -> None:
    walked = {profile: sum(profile == each for each, _ in CASES) for profile in ALL}
    assert walked["rc8"] == walked["cserver"] > 100
    assert walked["rc9"] > 95
    assert walked["rc7"] > 70


@pytest.mark.parametrize(("profile", "name"), [("rc7", "HandMoveA"), ("rc9", "HandStop"), ("rc8", "MoveA")])
def test_a_command_of_another_controller_is_unknown(profile: str, name: str) -> None:
    operator = Operator(Simulation(profile))
    assert operator.command(name, ints(5, 100)).hresult == RefusalCode.INVALID_COMMAND


@pytest.mark.parametrize("profile", ["rc7", "rc8", "cserver"])
@pytest.mark.parametrize("name", ["TwofgGrip", "twofgstop", "HandGrip"])
def test_the_hand_of_cobotta_pro_is_unknown_to_others(profile: str, name: str) -> None:
    operator = Operator(Simulation(profile))
    assert operator.robot(name, PARAMETERS.get(name, EMPTY)).hresult == RefusalCode.INVALID_COMMAND


def test_what_has_no_effect_is_listed_as_assumed() -> None:
    tables = (ROBOT_COMMANDS, CONTROLLER_COMMANDS, TASK_COMMANDS)
    ineffective = {name for table in tables for name, run in table.items() if run is accept_without_effect}
    listed = {
        name.casefold()
        for behaviour in read_behaviours()
        for name in behaviour.name.split()
        if behaviour.certainty is Certainty.ASSUMED
    }
    assert len(ineffective) > 5
    assert ineffective <= listed
