"""A client that talks to a simulated controller in memory, with a clock of its own."""

from __future__ import annotations

from typing import NamedTuple

from bcapscope.protocol.codec.frame import Frame, encode_frame
from bcapscope.protocol.codec.variant import EMPTY, VT, Value, Variant
from bcapscope.protocol.tables.function_table import function_by_name
from bcapscope.protocol.tables.hresult import S_EXECUTING
from bcapscope.simulator.argument_values import bstr, float_array, i4
from bcapscope.simulator.machine import InitialState, Machine
from bcapscope.simulator.profile import PROFILES
from bcapscope.simulator.scenario import read_scenario
from bcapscope.simulator.scenario_runner import ScenarioRunner
from bcapscope.simulator.simulator import Simulator, SimulatorOutput
from bcapscope.simulator.simulator_server import ControllerModel
from tests.english import collects

MS = 1_000_000


class Reply(NamedTuple):
    """What a call was answered: result, value (None without argument), how long it took in ms."""

    hresult: int
    value: Value
    vt: int | None
    ms: float
    notices: int
    reserved: int


class Simulation:
    """A controller and its time."""

    def __init__(self, profile: str = "rc8", start: InitialState | None = None) -> None:
        self.simulator = Simulator(PROFILES[profile], start)
        self.stage: ScenarioRunner | None = None
        self.news: list[str] = []
        self.now = 0

    @classmethod
    def of(cls, scenario: str) -> Simulation:
        """Make a simulation at which a scenario is played."""
        played = read_scenario(scenario)
        simulation = cls()
        simulation.simulator = Simulator(played.controller_profile, played.initial_state())
        simulation.stage = ScenarioRunner(played, simulation.simulator, 0, on_news=collects(simulation.news))
        return simulation

    @property
    def answerer(self) -> ControllerModel:
        """What clients talk to."""
        return self.stage or self.simulator

    @property
    def machine(self) -> Machine:
        """The controller."""
        return self.simulator.machine

    def wait(self, ms: float) -> list[SimulatorOutput]:
        """Let time pass as a server would: stop whenever something is due."""
        end, outputs = self.now + round(ms * MS), []
        while (due := self.answerer.due(self.now)) is not None and due <= end:
            self.now = max(due, self.now + 1)
            outputs += self.answerer.advance(self.now)
        self.now = max(end, self.now)
        return outputs + self.answerer.advance(self.now)


class SimulatedClient:
    """One client, over UDP unless told."""

    def __init__(self, simulation: Simulation, name: str = "client", tcp: bool = False) -> None:
        self.simulation = simulation
        self.name = name
        self.serial = 0
        self.tcp = tcp
        if tcp:
            assert simulation.answerer.on_connect(name, simulation.now)

    def send(self, function: str, *arguments: Variant) -> list[SimulatorOutput]:
        """Send a request and return what comes at once."""
        self.serial += 1
        found = function_by_name(function)
        assert found is not None
        raw = encode_frame(self.serial, 0, found.id, arguments)
        simulator, now = self.simulation.answerer, self.simulation.now
        return (
            simulator.on_segment(self.name, raw, now)
            if self.tcp
            else simulator.on_datagram(self.name, raw, now)
        )

    def call(self, function: str, *arguments: Variant, patience: float = 20_000) -> Reply:
        """Send a request and wait for its reply."""
        began, notices = self.simulation.now, 0
        outputs = self.send(function, *arguments)
        while True:
            for output in outputs:
                frame = Frame(output.data)
                if output.peer != self.name or frame.serial != self.serial:
                    continue
                if frame.code != S_EXECUTING:
                    return self._reply(frame, began, notices)
                notices += 1
            due = self.simulation.answerer.due(self.simulation.now)
            assert due is not None, "no answer, and nothing is under way"
            assert due - began <= patience * MS, "no answer in time"
            self.simulation.now = max(due, self.simulation.now + 1)
            outputs = self.simulation.answerer.advance(self.simulation.now)

    def _reply(self, frame: Frame, began: int, notices: int) -> Reply:
        values = frame.variants
        value = values[0] if values else None
        ms = (self.simulation.now - began) / MS
        return Reply(
            frame.code,
            value.value if value else None,
            value.vt if value else None,
            ms,
            notices,
            frame.reserved,
        )


class Operator(SimulatedClient):
    """A client with a controller and a robot open."""

    def __init__(
        self, simulation: Simulation, name: str = "client", tcp: bool = False, options: str = ""
    ) -> None:
        super().__init__(simulation, name, tcp)
        provider = {"rc9": "CaoProv.DENSO.VRC9"}.get(simulation.machine.profile.name, "CaoProv.DENSO.VRC")
        assert self.call("Service_Start", bstr(options)).hresult == 0
        texts = map(bstr, ("", provider, "localhost", ""))
        self.controller = self.handle(self.call("Controller_Connect", *texts))
        self.arm = self.get("Controller_GetRobot", self.controller, "Arm")

    def handle(self, reply: Reply) -> Variant:
        """Return the handle in a reply."""
        assert reply.hresult == 0, hex(reply.hresult)
        assert isinstance(reply.value, int)
        return i4(reply.value)

    def get(self, function: str, parent: Variant, name: str, option: str = "") -> Variant:
        """Open an object."""
        return self.handle(self.call(function, parent, bstr(name), bstr(option)))

    def robot(self, command: str, parameter: Variant = EMPTY) -> Reply:
        """Run a command of the robot."""
        return self.call("Robot_Execute", self.arm, bstr(command), parameter)

    def command(self, command: str, parameter: Variant = EMPTY) -> Reply:
        """Run a command of the controller."""
        return self.call("Controller_Execute", self.controller, bstr(command), parameter)

    def read(self, name: str) -> Reply:
        """Read a variable of the controller."""
        variable = self.get("Controller_GetVariable", self.controller, name)
        return self.call("Variable_GetValue", variable)

    def write(self, name: str, value: Variant) -> Reply:
        """Write a variable of the controller."""
        variable = self.get("Controller_GetVariable", self.controller, name)
        return self.call("Variable_PutValue", variable, value)

    def move(self, pose: str, option: str = "") -> Reply:
        """Move by PTP."""
        return self.call("Robot_Move", self.arm, i4(1), bstr(pose), bstr(option))

    def machine_error(self) -> int:
        """Return the newest active error as the controller's own panel shows it; 0 for none."""
        active = self.simulation.machine.active_alarms
        return active[0].code if active else 0

    def ready(self) -> None:
        """Take the arm and switch the motor on; run RobSlave where it is needed."""
        if self.simulation.machine.profile.needs_robslave:
            task = self.get("Controller_GetTask", self.controller, "RobSlave")
            assert self.call("Task_Start", task, i4(1), bstr("")).hresult == 0
        else:
            assert self.robot("TakeArm", ints(0, 0)).hresult == 0
        assert self.robot("Motor", ints(1, 0)).hresult == 0

    def slave(self, mode: int) -> Reply:
        """Switch slave mode."""
        return self.robot("slvChangeMode", i4(mode))

    def point(self, *values: float) -> Reply:
        """Send a set point."""
        return self.robot("slvMove", float_array(VT.R8, values))


def ints(*numbers: int) -> Variant:
    """Make an array of VT_I4."""
    return Variant.array(VT.I4, numbers)


def joints(*numbers: float) -> tuple[float, ...]:
    """Fill joints up to eight."""
    return (*numbers, *(0.0,) * (8 - len(numbers)))
