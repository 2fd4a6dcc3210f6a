"""A whole session in slave mode on an RC8: from Service_Start to Service_Stop, 240 set points at 8 ms."""

from __future__ import annotations

from random import Random

from bcapscope.protocol.codec.variant import EMPTY, Variant
from tests.samples.calls import (
    MS,
    S_EXECUTING,
    SECOND,
    START,
    US,
    Datagrams,
    i4,
    i4s,
    mixed,
    r8s,
    reply,
    request,
    text,
)
from tests.samples.files import Interface, pcapng

SET_POINTS = 240

_CYCLE = 8 * MS
_SLOTS = 3
_WATCHDOG = 400 * MS
_BOOT = START - 812 * SECOND
_CONTROLLER, _ROBOT = 1, 2
_REST, _RUN = 6, 226
_FROM = (0.0, 0.0, 90.0, 0.0, 90.0, 0.0, 0.0, 0.0)
_TO = (24.0, 15.0, 112.0, -18.0, 68.0, 36.0, 0.0, 0.0)
_SERVO_LAG = 4.25


def slave_session() -> bytes:
    """Return the session as pcapng with nanoseconds."""
    session = _Session()
    session.open()
    session.follow()
    session.close()
    return pcapng(
        session.network.packets,
        [Interface("eth0", "to the controller")],
        "RC8 in slave mode 0x202 over UDP, made by tests/samples",
    )


class _Session:
    """A client that numbers as DENSO's C library does: its own serial in reserved, replies carry 0."""

    def __init__(self) -> None:
        self.network = Datagrams()
        self._chance = Random(8).random
        self._now = START
        self._serial = 0

    def open(self) -> None:
        """Connect, take the arm, go to the first position and enter slave mode."""
        self._call("Service_Start", text(",WDT=400"), comment="keep-alives each 400 ms are asked for")
        names = ("", "CaoProv.DENSO.VRC", "localhost", "")
        self._call("Controller_Connect", *map(text, names), result=i4(_CONTROLLER), takes=31 * MS)
        self._call(
            "Controller_GetRobot", i4(_CONTROLLER), text("Arm"), text(""), result=i4(_ROBOT), takes=3 * MS
        )
        self._execute("TakeArm", i4s(0, 0), takes=6 * MS)
        self._execute("Motor", i4s(1, 0), takes=1370 * MS, comment="the motor needs longer than 400 ms")
        self._execute("ExtSpeed", r8s(30.0, 30.0, 30.0))
        near = tuple(value + 1.5 if value else value for value in _FROM)
        self._execute("CurJnt", EMPTY, result=r8s(*near))
        pose = mixed(r8s(*_FROM), text("J"), text("@E"))
        move = (i4(_ROBOT), i4(1), pose, text(""))
        self._call("Robot_Move", *move, takes=620 * MS, comment="to the first position, and standing there")
        self._execute("slvSendFormat", i4(0))
        self._execute("slvRecvFormat", i4s(0x12, 1))
        self._execute("slvChangeMode", i4(0x202), takes=9 * MS, comment="slave mode begins")

    def follow(self) -> None:
        """Send the set points; from the fourth on the controller sets the pace by when it answers."""
        tick = self._now + 5 * MS
        queued = 0
        for index in range(SET_POINTS):
            sent = self._now
            arrived = sent + 70 * US + self._jitter(20 * US)
            while tick <= arrived:
                tick, queued = tick + _CYCLE, max(queued - 1, 0)
            if queued == _SLOTS:
                arrived, tick, queued = tick, tick + _CYCLE, queued - 1
            queued += 1
            answered = arrived + 120 * US + self._jitter(60 * US)
            self._ask("Robot_Execute", (i4(_ROBOT), text("slvMove"), r8s(*_joints(index - _REST))), "")
            stamp = i4((arrived - _BOOT) // US)
            here = r8s(*_joints(index - _REST - _SERVO_LAG))
            self.network.down(answered, reply(self._serial, 0, mixed(stamp, here)))
            self._now = answered + 90 * US + self._jitter(50 * US)

    def close(self) -> None:
        """Leave slave mode and let everything go in order."""
        self._execute("slvChangeMode", i4(0), takes=47 * MS, comment="slave mode ends")
        self._execute("Motor", i4s(0, 0), takes=340 * MS)
        self._execute("GiveArm", EMPTY)
        self._call("Robot_Release", i4(_ROBOT))
        self._call("Controller_Disconnect", i4(_CONTROLLER), takes=12 * MS)
        self._call("Service_Stop")

    def _execute(
        self,
        command: str,
        parameter: Variant,
        result: Variant = EMPTY,
        takes: int = 1100 * US,
        comment: str = "",
    ) -> None:
        arguments = (i4(_ROBOT), text(command), parameter)
        self._call("Robot_Execute", *arguments, result=result, takes=takes, comment=comment)

    def _call(
        self,
        function: str,
        *arguments: Variant,
        result: Variant | None = None,
        takes: int = 900 * US,
        comment: str = "",
    ) -> None:
        """Ask, and answer after `takes` nanoseconds, with keep-alives meanwhile."""
        sent = self._now
        self._ask(function, arguments, comment)
        answered = sent + takes + self._jitter(200 * US)
        for at in range(sent + _WATCHDOG, answered, _WATCHDOG):
            self.network.down(at + self._jitter(MS), reply(self._serial, 0, hresult=S_EXECUTING))
        results = () if result is None else (result,)
        self.network.down(answered, reply(self._serial, 0, *results))
        self._now = answered + 2 * MS + self._jitter(3 * MS)

    def _ask(self, function: str, arguments: tuple[Variant, ...], comment: str) -> None:
        self._serial += 1
        self.network.up(self._now, request(self._serial, self._serial, function, *arguments), comment)

    def _jitter(self, most: int) -> int:
        return int(self._chance() * most)


def _joints(index: float) -> tuple[float, ...]:
    """Return the joints at a point of the motion: a polynomial that begins and ends at rest."""
    part = min(max(index / _RUN, 0.0), 1.0)
    share = part * part * part * (10.0 - part * (15.0 - 6.0 * part))
    return tuple(round(a + (b - a) * share, 5) for a, b in zip(_FROM, _TO, strict=True))
