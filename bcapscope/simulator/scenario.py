"""Scenarios in YAML: the state of a controller, and what goes wrong with the controller.

In the bundled scenarios, durations, limits and times are assumed. The failures happened to users of real
controllers, as each scenario says.
"""

from __future__ import annotations

import re
from dataclasses import replace
from enum import StrEnum
from functools import reduce
from operator import or_
from pathlib import Path
from typing import Annotated, TypeAlias

import msgspec
from msgspec import Meta

from bcapscope.faults.document import LONGEST_DOCUMENT, DocumentError, FieldError, read_document
from bcapscope.faults.fault_kinds import AnyFault
from bcapscope.faults.quantities import DurationQuantity, HresultQuantity
from bcapscope.messages import Message
from bcapscope.protocol.codec.variant import VT
from bcapscope.protocol.retry.responder import Defect
from bcapscope.protocol.slave_mode.modes import Generation
from bcapscope.protocol.tables.function_table import ObjectClass
from bcapscope.protocol.tables.hresult import is_failure
from bcapscope.protocol.variant_values import variant_of
from bcapscope.simulator.call_outcome import RefusalCode, RefusedError
from bcapscope.simulator.kinematics import AXIS_LIMITS, HOME, AxisLimit, axis_beyond_limit, pad_joints
from bcapscope.simulator.machine import MOTOR_ON_TIME, ROBOT_TYPE, ROBSLAVE, InitialState
from bcapscope.simulator.profile import DEFAULT_PROFILE, PROFILES, NoArgument, Profile
from bcapscope.simulator.scenario_event import LONGEST_NAME, AnyEvent, Joints6, OperatingMode, Percent
from bcapscope.simulator.scenario_files import bundled_scenarios
from bcapscope.simulator.simulator import MAX_CLIENTS
from bcapscope.simulator.system_variables import variable_names
from bcapscope.simulator.variable_memory import VariableMemory
from bcapscope.traffic.filter.tokens import with_nearest

Text: TypeAlias = Annotated[str, Meta(min_length=1, max_length=2000)]
Name: TypeAlias = Annotated[str, Meta(min_length=1, max_length=LONGEST_NAME)]
Names: TypeAlias = Annotated[tuple[Name, ...], Meta(max_length=32)]
SlotCount: TypeAlias = Annotated[int, Meta(ge=0, le=MAX_CLIENTS)]
Finite: TypeAlias = Annotated[float, Meta(ge=-1e9, le=1e9)]
VariableSetting: TypeAlias = bool | int | float | str | tuple[Finite, ...]
FaultsAndEvents: TypeAlias = Annotated[tuple[AnyFault | AnyEvent, ...], Meta(max_length=1000)]

_VARIABLE = re.compile(r"(IO[BWDF]?|[IFDVPJTS])([0-9]{1,9})")


class ProfileName(StrEnum):
    RC7 = "rc7"
    RC8 = "rc8"
    RC9 = "rc9"
    CSERVER = "cserver"


class ServerDefect(StrEnum):
    FORGETS_FIRST = "forgets-first"
    SERIAL_ZERO = "serial-zero"


class ScenarioTransport(StrEnum):
    UDP = "udp"
    TCP = "tcp"


class ClientProgram(StrEnum):
    """The program that the client of a scenario runs. If no fault occurs, each of these programs succeeds."""

    CALLS = "calls"
    """Connect, read and write a few variables, and disconnect."""
    MOTION = "motion"
    """As `CALLS`, then take the arm, switch the motor on and move the robot to and fro."""
    SLAVE = "slave"
    """As `MOTION`, then move to a first position with the pass motion @E, and enter slave mode. If the client
    sets the pace, the client sends a set point every 8 ms. Otherwise, the client sends the next set
    point after each reply.
    """
    PASSING = "passing"
    """As `SLAVE`, but the motion before slave mode has the pass motion @P."""
    GRIPPER = "gripper"
    """As `SLAVE`, while a second client sometimes writes an I/O output."""


class ScenarioClient(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """The client that a scenario is made for; `options` are those of Service_Start."""

    session: ClientProgram = ClientProgram.SLAVE
    over: ScenarioTransport = ScenarioTransport.UDP
    mode: Annotated[int, Meta(ge=1, le=0x203)] = 0x002
    options: Annotated[str, Meta(max_length=200)] = ",WDT=400"


class InitialSettings(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """State of the controller when it is switched on, as in `InitialState`; `joints` holds six angles."""

    joints: Joints6 = HOME[:6]
    mode: OperatingMode = OperatingMode.AUTOMATIC
    token: bool = True
    motor: bool = False
    motor_time: DurationQuantity = DurationQuantity(MOTOR_ON_TIME)
    speed: Percent = 100.0
    type_name: Name = ROBOT_TYPE
    errors: Annotated[tuple[HresultQuantity, ...], Meta(max_length=32)] = ()
    empty: Names = ()
    emergency: bool = False
    arm_taken: bool = False
    object_width: Annotated[float, Meta(gt=0, le=39)] | None = None
    udp_clients: SlotCount = 0
    tcp_clients: SlotCount = 0

    def __post_init__(self) -> None:
        for index, code in enumerate(self.errors):
            if not is_failure(code):
                raise FieldError(("errors", index), Message("scenario.no-error", code=code.text))
        known = {name for generation in Generation for name in variable_names(ObjectClass.ROBOT, generation)}
        for index, name in enumerate(self.empty):
            if name.upper() not in known:
                raise FieldError(("empty", index), Message("scenario.no-variable", name=name))


class TaskSettings(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    loaded: Names = (ROBSLAVE, "Pro1")
    running: Names = ()

    def __post_init__(self) -> None:
        loaded = {name.casefold() for name in self.loaded}
        for index, name in enumerate(self.running):
            if name.casefold() not in loaded:
                raise FieldError(("running", index), Message("scenario.not-loaded", name=name))


class AxisLimitSettings(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Limits of one axis in degrees and seconds; a missing limit keeps its usual value."""

    low: Annotated[float, Meta(ge=-360, le=360)] | None = None
    high: Annotated[float, Meta(ge=-360, le=360)] | None = None
    speed: Annotated[float, Meta(gt=0, le=10_000)] | None = None
    acceleration: Annotated[float, Meta(gt=0, le=1_000_000)] | None = None

    def __post_init__(self) -> None:
        if self.low is not None and self.high is not None and self.low > self.high:
            raise FieldError(("low",), Message("scenario.above-high"))

    def applied_to(self, usual: AxisLimit) -> AxisLimit:
        given = {name: value for name, value in msgspec.structs.asdict(self).items() if value is not None}
        return usual._replace(**given)


class AxisLimitsSettings(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    J1: AxisLimitSettings = AxisLimitSettings()
    J2: AxisLimitSettings = AxisLimitSettings()
    J3: AxisLimitSettings = AxisLimitSettings()
    J4: AxisLimitSettings = AxisLimitSettings()
    J5: AxisLimitSettings = AxisLimitSettings()
    J6: AxisLimitSettings = AxisLimitSettings()

    @property
    def axis_limits(self) -> tuple[AxisLimit, ...]:
        given = (self.J1, self.J2, self.J3, self.J4, self.J5, self.J6)
        return tuple(limit.applied_to(usual) for limit, usual in zip(given, AXIS_LIMITS, strict=True))


class Scenario(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """The start state of a simulated controller, and the faults and events that happen to the controller.

    Attributes:
        story: What happens, how the controller reacts, and which users reported this failure.
        shows: Rule that `bcapscope diagnose` reports as the root cause; None for no rule.
        then: Rules besides `shows` that `bcapscope diagnose` reports if the scenario's `client` is used.
        client: Client that the scenario is made for.
        defects: Defects of DENSO's C server that the controller has; None for the defects of the profile.
        variables: Initial values of variables by name, such as ``I1``, ``P3`` or ``IO128``.
        in_slave_mode: Faults and events that apply after slave mode is first entered.
    """

    title: Text
    story: Text = ""
    shows: Name | None = None
    then: Names = ()
    client: ScenarioClient = ScenarioClient()
    profile: ProfileName = ProfileName(DEFAULT_PROFILE)
    defects: tuple[ServerDefect, ...] | None = None
    no_argument: NoArgument | None = None
    start: InitialSettings = InitialSettings()
    variables: dict[Name, VariableSetting] = {}
    tasks: TaskSettings = TaskSettings()
    limits: AxisLimitsSettings = AxisLimitsSettings()
    faults: FaultsAndEvents = ()
    in_slave_mode: FaultsAndEvents = ()
    seed: Annotated[int, Meta(ge=0, le=2**63 - 1)] = 0

    def __post_init__(self) -> None:
        self.write_variables(VariableMemory(VT.R8))
        seen: set[str] = set()
        for field in ("faults", "in_slave_mode"):
            for index, each in enumerate(getattr(self, field)):
                if each.name and each.name in seen:
                    raise FieldError((field, index, "name"), Message("scenario.same-name", name=each.name))
                seen.add(each.name)
        axis = axis_beyond_limit(pad_joints(self.start.joints), self.limits.axis_limits)
        if axis:
            raise FieldError(
                ("start", "joints", axis - 1), Message("scenario.beyond-limits", axis=f"J{axis}")
            )

    @property
    def controller_profile(self) -> Profile:
        profile = PROFILES[self.profile]
        if self.defects is not None:
            profile = replace(
                profile, defects=reduce(or_, (Defect[each.name] for each in self.defects), Defect.NONE)
            )
        if self.no_argument is not None:
            profile = replace(profile, no_argument=self.no_argument)
        return profile

    def initial_state(self, epoch: int = 0) -> InitialState:
        start = msgspec.structs.asdict(self.start)
        start |= {
            "joints": pad_joints(self.start.joints),
            "mode": self.start.mode.number,
            "empty": tuple(name.upper() for name in self.start.empty),
        }
        limits, tasks = self.limits.axis_limits, self.tasks
        return InitialState(**start, limits=limits, tasks=tasks.loaded, running=tasks.running, epoch=epoch)

    def write_variables(self, memory: VariableMemory) -> None:
        """Write the scenario's variables to `memory`; an invalid variable raises FieldError."""
        for name, value in self.variables.items():
            match = _VARIABLE.fullmatch(name.upper())
            if match is None:
                raise FieldError(("variables", name), Message("scenario.unknown-variable"))
            try:
                memory.write(match[1], int(match[2]), variant_of(value))
            except RefusedError as refusal:
                is_bad_index = refusal.hresult == RefusalCode.BAD_INDEX
                case = "scenario.bad-index" if is_bad_index else "scenario.unfit-value"
                raise FieldError(("variables", name), Message(case)) from refusal


def load_scenario(name_or_path: str) -> Scenario:
    """Read a bundled scenario by its name, or a scenario from a file.

    Raises DocumentError for an invalid scenario, LookupError for an unknown name, and OSError for an
    unreadable file.
    """
    bundled = bundled_scenarios()
    if name_or_path in bundled:
        return read_scenario(bundled[name_or_path])
    if not name_or_path.endswith((".yaml", ".yml")):
        unknown = Message("scenario.unknown", name=f"{name_or_path!r}")
        reason = with_nearest(unknown, name_or_path, bundled)
        raise LookupError(f"{reason}{'.' if reason is unknown else ''}")
    try:
        with Path(name_or_path).open(encoding="utf-8") as file:
            return read_scenario(file.read(LONGEST_DOCUMENT + 1))
    except UnicodeDecodeError as error:
        no_text = Message("document.no-utf8", reason=error.reason, position=error.start)
        raise DocumentError((), 0, no_text) from error


def read_scenario(text: str) -> Scenario:
    """Read a scenario from YAML, or raise DocumentError with line and field."""
    return read_document(text, Scenario)
