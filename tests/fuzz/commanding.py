"""A client that calls every catalogued command, with parameters that are nearly right or not at all."""

from __future__ import annotations

import random
import socket
from collections.abc import Callable
from contextlib import suppress

from bcapscope.protocol.codec.frame import Frame, encode_frame
from bcapscope.protocol.codec.variant import ARRAY, EMPTY, NUMBER_FORMATS, VT, Variant
from bcapscope.protocol.tables.command_catalogue import commands_of
from bcapscope.protocol.tables.function_table import ObjectClass, function_by_name
from bcapscope.protocol.tables.hresult import E_NOTIMPL, S_EXECUTING
from bcapscope.protocol.tables.variables import VARIABLES, VariableKind
from bcapscope.simulator.argument_values import boolean, bstr, float_array, i4, r8, variant_array
from bcapscope.simulator.call_outcome import RefusalCode
from bcapscope.simulator.profile import PROFILES

PATIENCE = 0.3
"""Seconds that the client waits for a reply before it leaves; motions take longer."""

CALLS = 60
"""Most calls of one client."""

_LACKS = PROFILES["rc8"].lacks
_OTHER_PROVIDERS = ("EVP2", "ESC11")
_EXTENSIONS = ("Hand0", "Comm", "Pallet")
_EXECUTES = {"controller": 17, "robot": 64, "task": 87}

VOCABULARY: tuple[tuple[str, str], ...] = (
    *(
        (target, known.name)
        for target, function_id in _EXECUTES.items()
        for known in commands_of(function_id)
        if known.controllers not in _OTHER_PROVIDERS and known.name.casefold() not in _LACKS
    ),
    *((known.controllers, known.name) for known in commands_of(28) if known.controllers in _EXTENSIONS),
)
"""Every command of an RC8 that the catalogue knows, with the object that takes it."""

_MOTIONS = (
    *("Robot_Move", "Robot_Drive", "Robot_Halt", "Robot_Hold", "Robot_Unhold", "Robot_Speed", "Robot_Change"),
    *("Robot_Accelerate", "Task_Start", "Task_Stop"),
)
_TEXTS = (
    *("J(0, 0, 90, 0, 90, 0)", "@E P(400, 100, 500, 180, 0, 90)", "P1", "@P J2", "T3", "J", "P", "@0", "@E"),
    *(
        "(1, 5)",
        "@E (1, 5), (2, -5)",
        "SPEED=F2,NEXT",
        "SPEED=50, TIME=9",
        "NEXT",
        "@P 10",
        "1",
        "",
        "\0",
        "é",
    ),
)
_NUMBERS = (0, 1, 2, 3, 5, 12, 90, 100, 0x101, 0x202, 0x620, 0x234, -1, -2, -3, 0x7FFFFFFF, -0x80000000)


def parameter(chance: random.Random, depth: int = 0) -> Variant:
    """Make a parameter of any type, nested up to three deep."""
    makers: list[Callable[[], Variant]] = [
        lambda: bstr(chance.choice(_TEXTS)),
        lambda: i4(chance.choice(_NUMBERS)),
        lambda: r8(chance.choice((*_NUMBERS, 0.5, 1e300, float("nan"), float("-inf")))),
        lambda: boolean(chance.random() < 0.5),
        lambda: EMPTY,
        lambda: float_array(VT.R8, [chance.uniform(-200, 600) for _ in range(chance.randrange(12))]),
        lambda: _odd_numbers(chance),
    ]
    if depth < 3:
        makers += [
            lambda: variant_array(*(parameter(chance, depth + 1) for _ in range(chance.randrange(10))))
        ] * 3
    return chance.choice(makers)()


def _odd_numbers(chance: random.Random) -> Variant:
    """Make a number, or an array of numbers, of a type that commands do not expect."""
    vt = chance.choice([each for each in NUMBER_FORMATS if each not in (VT.R4, VT.R8, VT.DATE, VT.BOOL)])
    numbers = tuple(chance.randrange(128) for _ in range(chance.randrange(1, 10)))
    if vt == VT.UI1:
        return Variant.array(VT.UI1, bytes(numbers))
    return Variant(ARRAY | vt, numbers, len(numbers)) if chance.random() < 0.5 else Variant(vt, numbers[0])


class Commander:
    """One client after the other, each in a session of its own.

    Attributes:
        calls: that were sent.
        replies: that came in time.
    """

    def __init__(self, port: int, chance: random.Random) -> None:
        self.calls = self.replies = 0
        self._address = ("127.0.0.1", port)
        self._chance = chance

    def command(self) -> None:
        """Open a session, make random calls, and leave, with or without closing the session."""
        with socket.create_connection(self._address, 30) as sock, suppress(TimeoutError, ConnectionError):
            session = _Session(sock, self)
            sock.settimeout(PATIENCE)
            if self._chance.random() < 0.7:
                session.get_ready()
            for _ in range(self._chance.randrange(CALLS)):
                self._call_something(session)
            if self._chance.random() < 0.5:
                session.call("Service_Stop")

    def _call_something(self, session: _Session) -> None:
        chance = self._chance
        kind = chance.randrange(10)
        if kind == 0:
            name = chance.choice(_MOTIONS)
            target = session.handles["task" if name.startswith("Task") else "robot"]
            session.call(name, target, *(parameter(chance) for _ in range(chance.randrange(5))))
        elif kind == 1:
            self._use_variable(session, chance.choice(VARIABLES))
        else:
            owner, command = chance.choice(VOCABULARY)
            reply = session.execute(owner, command, parameter(chance))
            assert reply.code not in (RefusalCode.INVALID_COMMAND, E_NOTIMPL), (owner, command)

    def _use_variable(self, session: _Session, kind: VariableKind) -> None:
        owner = {ObjectClass.ROBOT: "robot", ObjectClass.TASK: "task"}.get(kind.owner, "controller")
        number = self._chance.choice(("0", "99", "100", "999999999", "*")) if kind.is_numbered else ""
        getter = f"{owner.capitalize()}_GetVariable"
        reply = session.call(getter, session.handles[owner], bstr(kind.name + number), bstr(""))
        if reply.code == 0:
            variable = reply.variants[0]
            session.call("Variable_PutValue", variable, parameter(self._chance))
            session.call("Variable_GetValue", variable)


class _Session:
    """A session with everything open."""

    def __init__(self, sock: socket.socket, counts: Commander) -> None:
        self._sock = sock
        self._counts = counts
        self._serial = 0
        self._rest = b""
        self.call("Service_Start", bstr(",InvokeTimeout=200"))
        names = map(bstr, ("", "CaoProv.DENSO.VRC", "localhost", ""))
        controller = self.call("Controller_Connect", *names).variants[0]
        self.handles = {"controller": controller}
        for key, getter, name in (
            ("robot", "Controller_GetRobot", "Arm"),
            ("task", "Controller_GetTask", "Pro1"),
            *((name, "Controller_GetExtension", name) for name in _EXTENSIONS),
        ):
            self.handles[key] = self.call(getter, controller, bstr(name), bstr("")).variants[0]

    def get_ready(self) -> None:
        """Make motions possible; the motor is on a little later."""
        self.execute("controller", "ClearError", EMPTY)
        self.execute("robot", "TakeArm", EMPTY)
        self.execute("robot", "Motor", variant_array(i4(1), i4(1)))

    def execute(self, target: str, command: str, value: Variant) -> Frame:
        """Call a command of an object."""
        function_id = _EXECUTES.get(target, 28)
        return self._exchange(function_id, self.handles[target], bstr(command), value)

    def call(self, name: str, *arguments: Variant) -> Frame:
        """Call a function; return its reply."""
        function = function_by_name(name)
        assert function is not None
        return self._exchange(function.id, *arguments)

    def _exchange(self, function_id: int, *arguments: Variant) -> Frame:
        self._serial += 1
        self._counts.calls += 1
        self._sock.sendall(encode_frame(self._serial, 0, function_id, arguments))
        while (frame := self._frame()).code == S_EXECUTING:
            pass
        assert frame.serial == self._serial
        self._counts.replies += 1
        return frame

    def _frame(self) -> Frame:
        while len(self._rest) < 5 or len(self._rest) < int.from_bytes(self._rest[1:5], "little"):
            data = self._sock.recv(65536)
            if not data:
                raise ConnectionError("the simulator has closed the connection")
            self._rest += data
        length = int.from_bytes(self._rest[1:5], "little")
        raw, self._rest = self._rest[:length], self._rest[length:]
        return Frame(raw)
