"""Whole sessions in few words: an `Operator` makes calls one after another, in the style of a client library.

Each method makes some calls, moves the operator's clock on, and returns the operator.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import NamedTuple, TypeAlias

from bcapscope.protocol.codec.variant import EMPTY, VT, Variant
from tests.analysis.scenes import HOME, Diagnosed, diagnose_bytes
from tests.samples.calls import (
    MS,
    SERVER,
    START,
    Datagrams,
    i2,
    i4,
    i4s,
    mixed,
    r4s,
    r8s,
    reply,
    request,
    text,
)
from tests.samples.files import Packet, pcap
from tests.samples.tcp import Connection
from tests.samples.wire import Host

S_EXECUTING, S_BUF_FULL = 0x900, 0x0F200501
_POSES = {1: (300.0, 0.0, 400.0, 180.0, 0.0, 180.0, 5.0), 2: HOME, 3: (300.0, 0.0, 400.0, *(0.0,) * 7)}


class Style(NamedTuple):
    """How a client library makes its calls.

    Attributes:
        option: Option of Service_Start.
        own_reserved: Whether a first attempt carries its own serial as reserved, as in DENSO's C library.
        rc7: Whether the controller is an RC7.
        motor_by_variable: Whether the client switches the motor with @SERVO_ON, as DENSO's ROS drivers do.
        clears_first: Whether the client calls ClearError before it prepares a motion.
    """

    name: str
    tcp: bool = False
    option: str = ",WDT=400"
    provider: str = "CaoProv.DENSO.VRC"
    own_reserved: bool = False
    rc7: bool = False
    motor_by_variable: bool = False
    clears_first: bool = False


C_UDP = Style("C over UDP", own_reserved=True)
C_TCP = Style("C over TCP", tcp=True, own_reserved=True, clears_first=True)
PYTHON_TCP = Style("Python over TCP", tcp=True, option="")
PYTHON_UDP = Style("Python over UDP", option=",WDT=400,InvokeTimeout=180000")
CSHARP_UDP = Style("C# over UDP", option=",WDT=1000", clears_first=True)
CSHARP_TCP = Style("C# over TCP", tcp=True, option=",WDT=1000")
ROS = Style("ROS over UDP", provider="caoProv.DENSO.VRC", motor_by_variable=True, clears_first=True)
ROS2_RC9 = Style("ROS 2 with an RC9", provider="CaoProv.DENSO.VRC9", motor_by_variable=True)
RC7_UDP = Style("RC7 over UDP", option="", provider="", rc7=True)
RC7_TCP = Style("RC7 over TCP", tcp=True, option="", provider="", rc7=True, clears_first=True)
STYLES = (C_UDP, C_TCP, PYTHON_TCP, PYTHON_UDP, CSHARP_UDP, CSHARP_TCP, ROS, ROS2_RC9, RC7_UDP, RC7_TCP)


class Operator:
    """A client with a clock of its own, in ms from the beginning of the capture."""

    def __init__(
        self, style: Style = C_UDP, port: int = 50001, host: str = "192.168.0.10", at: float = 0.0
    ) -> None:
        self.style = style
        self.now = at
        self.serial = 0
        self.network = (Connection if style.tcp else Datagrams)(
            Host(bytes.fromhex("0200c0a8000a"), host, port), SERVER
        )
        self.controller, self.robot = i4(1), i4(2)
        self.mode = 0
        self.axis = 0.0  # position of the first axis
        self._handles = 10

    # single frames

    def ask(self, function: str, *arguments: Variant, reserved: int | None = None) -> int:
        """Send a request and return its serial; the clock stays."""
        self.serial += 1
        usual = self.serial if self.style.own_reserved else 0
        frame = request(self.serial, usual if reserved is None else reserved, function, *arguments)
        self.network.up(self._time(), frame)
        return self.serial

    def answer(self, serial: int, *results: Variant, code: int = 0) -> Operator:
        self.network.down(self._time(), reply(serial, 0, *results, hresult=code))
        return self

    def wait(self, ms: float) -> Operator:
        self.now += ms
        return self

    def _time(self) -> int:
        return START + round(self.now * MS)

    # calls

    def call(
        self,
        function: str,
        *arguments: Variant,
        result: Variant | None = None,
        code: int = 0,
        takes: float = 1.0,
    ) -> Operator:
        """Make a call; with WDT, notices come while it lasts."""
        serial = self.ask(function, *arguments)
        pause = 1000 if "1000" in self.style.option else 400
        left = takes
        while "WDT" in self.style.option and left > pause:
            self.wait(pause).answer(serial, code=S_EXECUTING)
            left -= pause
        self.wait(left).answer(serial, *(() if result is None else (result,)), code=code)
        return self.wait(1.0)

    def unanswered(self, function: str, *arguments: Variant, wait: float = 100.0) -> Operator:
        self.ask(function, *arguments)
        return self.wait(wait)

    def execute(
        self,
        command: str,
        parameter: Variant = EMPTY,
        result: Variant = EMPTY,
        *,
        code: int = 0,
        takes: float = 1.0,
    ) -> Operator:
        """Send a command to the robot."""
        arguments = self.robot, text(command), parameter
        return self.call("Robot_Execute", *arguments, result=None if code else result, code=code, takes=takes)

    def control(
        self, command: str, parameter: Variant = EMPTY, result: Variant = EMPTY, *, code: int = 0
    ) -> Operator:
        """Send a command to the controller."""
        arguments = self.controller, text(command), parameter
        return self.call("Controller_Execute", *arguments, result=None if code else result, code=code)

    # a session

    def start(self, option: str | None = None, code: int = 0) -> Operator:
        return self.call("Service_Start", text(self.style.option if option is None else option), code=code)

    def connect(self, code: int = 0, provider: str | None = None, name: str = "") -> Operator:
        names = name, self.style.provider if provider is None else provider, "localhost", ""
        result = None if code else self.controller
        return self.call("Controller_Connect", *map(text, names), result=result, code=code, takes=20)

    def get_robot(self, code: int = 0) -> Operator:
        result = None if code else self.robot
        return self.call(
            "Controller_GetRobot", self.controller, text("Arm"), text(""), result=result, code=code
        )

    def read_type(self) -> Operator:
        return self.execute("GetRobotTypeName", result=text("VS-060"))

    def open(self) -> Operator:
        """Start a session and get the robot."""
        self.start().connect().get_robot().read_type()
        if self.style.rc7:
            self.control("PutAutoMode", i2(2))
        return self

    def take_arm(self, code: int = 0) -> Operator:
        """Take the arm; an RC7 has no such command."""
        if self.style.rc7 and not code:
            return self
        return self.execute("TakeArm", i4s(0, 0), code=code)

    def motor(self, on: bool = True, code: int = 0) -> Operator:
        if self.style.motor_by_variable:
            return self.write_variable("@SERVO_ON", Variant(VT.BOOL, on), code, takes=300)
        state = i2(int(on)) if self.style.rc7 else i4s(int(on), 0)
        return self.execute("Motor", state, code=code, takes=300)

    def ready(self) -> Operator:
        """Prepare a motion, as the style does it."""
        if self.style.clears_first:
            self.control("ClearError")
        self.take_arm().motor()
        if self.style.rc7:
            self.start_robslave()
        return self.execute("CurJnt", result=r8s(*HOME))

    def start_robslave(self, code: int = 0) -> Operator:
        handle = self._new_handle()
        names = self.controller, text("RobSlave"), text("")
        self.call("Controller_GetTask", *names, result=handle)
        return self.call("Task_Start", handle, i4(1), text(""), code=code)

    def move(self, target: str = "@E P1", code: int = 0, takes: float = 800.0) -> Operator:
        return self.call("Robot_Move", self.robot, i4(1), text(target), text(""), code=code, takes=takes)

    def shut_down(self) -> Operator:
        self.motor(on=False)
        return self if self.style.rc7 else self.execute("GiveArm")

    def release(self) -> Operator:
        """Let everything go."""
        self.call("Robot_Release", self.robot)
        return self.call("Controller_Disconnect", self.controller).call("Service_Stop")

    def close(self) -> Operator:
        return self.shut_down().release()

    # variables and errors

    def _new_handle(self) -> Variant:
        self._handles += 1
        return i4(self._handles)

    def read_variable(self, name: str, value: Variant, times: int = 1, every: float = 0.0) -> Operator:
        handle = self._new_handle()
        self.call("Controller_GetVariable", self.controller, text(name), text(""), result=handle)
        for _ in range(times):
            self.call("Variable_GetValue", handle, result=value).wait(every)
        return self.call("Variable_Release", handle)

    def write_variable(self, name: str, value: Variant, code: int = 0, takes: float = 1.0) -> Operator:
        handle = self._new_handle()
        self.call("Robot_GetVariable", self.robot, text(name), text(""), result=handle)
        self.call("Variable_PutValue", handle, value, code=code, takes=takes)
        return self.call("Variable_Release", handle)

    def read_errors(self, *codes: int) -> Operator:
        """Read the error list, newest error first."""
        self.control("GetCurErrorCount", result=i4(len(codes)))
        for index, code in enumerate(codes):
            number = code - (1 << 32) if code & 0x80000000 else code
            self.control("GetCurErrorInfo", i4(index), mixed(i4(number), text("an error"), i4(0)))
        return self

    def clear(self, code: int = 0) -> Operator:
        return self.control("ClearError", code=code)

    # slave mode

    def enter(self, mode: int, code: int = 0, takes: float = 5.0) -> Operator:
        if not code:
            self.mode = mode
        number = i2(mode) if self.style.rc7 else i4(mode)
        arguments = self.robot, text("slvChangeMode"), number
        result = None if code or self.style.rc7 else EMPTY
        return self.call("Robot_Execute", *arguments, result=result, code=code, takes=takes)

    def leave(self) -> Operator:
        return self.enter(0)

    def pose(self) -> Variant:
        """Return the set point of the present position."""
        values = _POSES[self.mode & 3 or 2]
        values = (values[0] + self.axis, *values[1:])
        return r4s(*values) if self.style.rc7 else r8s(*values)

    @property
    def usual_reply_ms(self) -> float:
        waits = self.mode & 0xF00 == (0 if self.style.rc7 else 0x200)
        return 7.4 if waits else 0.7

    def point(self, code: int = 0, takes: float | None = None, every: float = 8.0) -> Operator:
        """Send a set point; the next one is due after `every` ms."""
        began, pose = self.now, self.pose()
        serial = self.ask("Robot_Execute", self.robot, text("slvMove"), pose)
        self.wait(self.usual_reply_ms if takes is None else takes)
        failed = bool(code & 0x80000000) or 0x1000 <= code <= 0xFFFF
        self.answer(serial, EMPTY if failed else pose, code=code)
        self.now = began + every
        return self

    def stream(
        self, points: int, every: float = 8.0, step: float = 0.05, takes: float | None = None
    ) -> Operator:
        """Move smoothly: send set points with this step between them."""
        for _ in range(points):
            self.axis += step
            self.point(takes=takes, every=every)
        return self

    def swing(self, points: int, by: float, every: float = 8.0) -> Operator:
        """Move from standstill to standstill, smoothly."""
        start = self.axis
        for number in range(1, points + 1):
            self.axis = start + by * (1 - math.cos(math.pi * number / points)) / 2
            self.point(every=every)
        return self

    def hold(self, points: int, every: float = 8.0) -> Operator:
        """Stand still: repeat the last set point."""
        return self.stream(points, every, step=0.0)

    def jump(self, step: float, code: int = 0) -> Operator:
        """Send a set point with a large step."""
        self.axis += step
        return self.point(code)

    def packets(self) -> list[Packet]:
        return self.network.packets


Session: TypeAlias = Callable[["Cell"], object]
"""Lets the operators of a cell act."""


class Cell:
    """A controller and its operators."""

    def __init__(self, style: Style = C_UDP) -> None:
        self.style = style
        self._operators: list[Operator] = []

    def operator(self, style: Style | None = None, at: float = 0.0, host: str = "192.168.0.10") -> Operator:
        port = 50001 + len(self._operators)
        operator = Operator(self.style if style is None else style, port, host, at)
        self._operators.append(operator)
        return operator

    def packets(self) -> list[Packet]:
        every = (packet for operator in self._operators for packet in operator.packets())
        return sorted(every, key=lambda packet: packet.time)


def diagnose_packets(packets: list[Packet], first: float = 0.0, last: float = 1.0) -> Diagnosed:
    """Diagnose the share of the packets from `first` to `last`."""
    kept = packets[round(first * len(packets)) : round(last * len(packets))]
    return diagnose_bytes(pcap(kept, nanoseconds=True))


def diagnose_session(
    session: Session, style: Style = C_UDP, first: float = 0.0, last: float = 1.0
) -> Diagnosed:
    """Diagnose the capture of a session, or the share of its packets from `first` to `last`."""
    cell = Cell(style)
    session(cell)
    return diagnose_packets(cell.packets(), first, last)
