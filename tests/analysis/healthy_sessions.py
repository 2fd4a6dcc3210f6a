"""Sessions in which nothing is wrong, in the styles of many clients. `diagnose` has to stay silent on each.

Each session is played in each style that it fits.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

from bcapscope.protocol.codec.variant import EMPTY, VT, Variant
from tests.analysis.operators import (
    C_TCP,
    C_UDP,
    CSHARP_TCP,
    CSHARP_UDP,
    PYTHON_TCP,
    PYTHON_UDP,
    RC7_TCP,
    RC7_UDP,
    ROS,
    ROS2_RC9,
    S_BUF_FULL,
    STYLES,
    Cell,
    Session,
    Style,
    diagnose_session,
)
from tests.analysis.scenes import Diagnosed
from tests.samples.calls import i4, i4s, mixed, r8s, text

_RC8_STYLES = tuple(style for style in STYLES if not style.rc7)
_RC7_STYLES = RC7_UDP, RC7_TCP
_EVERY_OTHER = C_UDP, PYTHON_TCP, ROS, RC7_UDP


class HealthySession(NamedTuple):
    """A session without a problem.

    Attributes:
        first: Share of the packets before the capture began.
        last: Share of the packets when the capture ended.
        notes: Rules of severity note that are right here.
    """

    name: str
    session: Session
    style: Style
    first: float = 0.0
    last: float = 1.0
    notes: tuple[str, ...] = ()

    def diagnose(self) -> Diagnosed:
        return diagnose_session(self.session, self.style, self.first, self.last)


def _reads_values(cell: Cell) -> None:
    client = cell.operator().open()
    for name in ("I1", "S10", "D100", "P3"):
        client.read_variable(name, i4(5), times=10, every=20)
    client.read_variable("@ERROR_CODE", i4(0)).release()


def _starts_and_stops(cell: Cell) -> None:
    cell.operator().start().call("Service_Stop")


def _moves(cell: Cell) -> None:
    client = cell.operator().open().ready().move().move("@0 P2").move("@E P3", takes=350)
    client.execute("ExtSpeed", i4s(50, 50)).move("@E P4").close()


def _moves_for_long(cell: Cell) -> None:
    client = cell.operator()
    client.start(",WDT=400")
    client.connect().get_robot().read_type().take_arm().motor()
    client.style = client.style._replace(option=",WDT=400")
    client.move(takes=9000).move(takes=12500).close()


def _drives(mode: int) -> Session:
    """A slave-mode session from standstill to standstill."""

    def session(cell: Cell) -> None:
        client = cell.operator().open().ready().move().enter(mode)
        client.hold(5).stream(120).hold(5).leave().close()

    return session


def _drives_twice(cell: Cell) -> None:
    client = cell.operator().open().ready()
    for _ in range(2):
        client.enter(0x002).hold(4).stream(60).hold(4).leave().wait(500).move()
    client.close()


def _pauses_at_standstill(cell: Cell) -> None:
    client = cell.operator().open().ready().enter(0x002).hold(5).stream(80).hold(10)
    client.wait(2000).hold(10).stream(80).hold(10).wait(700).hold(5).leave().close()


def _swings(mode: int, pause: float) -> Session:
    """Smooth motions with pauses between them, in which the client sends nothing."""

    def session(cell: Cell) -> None:
        client = cell.operator().open().ready().enter(mode)
        for by in (10.0, -25.0, 15.0):
            client.swing(150, by).wait(pause)
        client.leave().close()

    return session


def _holds_still(every: float) -> Session:
    """A mode that holds the last set point, which the client repeats slowly while the robot stands."""

    def session(cell: Cell) -> None:
        client = cell.operator().open().ready().enter(0x102).stream(60).hold(80, every)
        client.stream(60).hold(40, every).leave().close()

    return session


def _waits_for_room(cell: Cell) -> None:
    """Mode 0 with S_BUF_FULL: the client sends until the buffer is full, and then waits one period."""
    client = cell.operator().open().ready().enter(0x002)
    client.point(every=2).point(every=2).point(every=2).point(S_BUF_FULL, every=8)
    client.stream(100).point(S_BUF_FULL, every=8).stream(60).hold(4).leave().close()


def _streams_fast(cell: Cell) -> None:
    """Async mode at the recommended period of 1 ms."""
    client = cell.operator().open().ready().enter(0x102).stream(400, every=1.0, step=0.01, takes=0.3)
    client.leave().close()


def _streams_slowly(every: float) -> Session:
    def session(cell: Cell) -> None:
        cell.operator().open().ready().enter(0x102).stream(100, every).hold(5).leave().close()

    return session


def _uses_formats(cell: Cell) -> None:
    client = cell.operator().open().ready()
    client.execute("slvRecvFormat", i4(2)).execute("slvSendFormat", i4(0)).enter(0x002)
    client.stream(100).execute("slvGetMode", result=i4(0x002)).leave().close()


def _reads_in_slave_mode(cell: Cell) -> None:
    client = cell.operator().open().ready().enter(0x002)
    for _ in range(6):
        client.stream(20)
        began = client.now
        client.execute("CurJnt", result=r8s(*(0.0,) * 8), takes=0.5)
        client.now = began + 4
        client.wait(1)
    client.hold(4).leave().close()


def _clears_an_old_error(cell: Cell) -> None:
    client = cell.operator().open().read_errors(0x84201482, 0x8150101A).clear()
    client.ready().move().enter(0x002).stream(80).leave().close()


def _looks_at_errors(cell: Cell) -> None:
    client = cell.operator().open()
    for _ in range(5):
        client.read_errors().wait(200)
    client.release()


def _idles(cell: Cell) -> None:
    client = cell.operator().open().ready().move().wait(90_000).move().wait(240_000)
    client.execute("CurPos", result=r8s(*(0.0,) * 7)).close()


def _halts(cell: Cell) -> None:
    client = cell.operator().open().ready().move()
    client.call("Robot_Halt", client.robot, text("")).move().close()


def _opens_again(cell: Cell) -> None:
    client = cell.operator().open().ready().move().close().wait(3000)
    client.open().ready().enter(0x002).stream(60).leave().close()


def _switches_motor_often(cell: Cell) -> None:
    client = cell.operator().open().ready()
    for _ in range(3):
        client.move().motor(on=False).wait(500).motor()
    client.close()


def _runs_a_task(cell: Cell) -> None:
    client = cell.operator().open()
    task = i4(30)
    client.call("Controller_GetTask", client.controller, text("PRO1"), text(""), result=task)
    client.call("Task_Start", task, i4(1), text("")).wait(2000).call("Task_Stop", task, i4(0), text(""))
    client.call("Task_Release", task).release()


def _watched(driver: Session) -> Session:
    """A second client reads positions over TCP while the first one drives."""

    def session(cell: Cell) -> None:
        watcher = cell.operator(PYTHON_TCP, at=3, host="192.168.0.11").open()
        driver(cell)
        for _ in range(15):
            watcher.execute("CurJnt", result=r8s(*(0.0,) * 8)).wait(100)
        watcher.release()

    return session


def _watches_itself(cell: Cell) -> None:
    """DENSO's ROS driver: it reads over TCP and acts over UDP, from the same computer."""
    reader, actor = cell.operator(ROS._replace(tcp=True)).open(), cell.operator(at=40)
    actor.start().connect().get_robot().ready().enter(0x002).hold(4).stream(120).hold(4).leave().close()
    reader.read_variable("@ERROR_CODE", i4(0), times=8, every=120).release()


def _takes_turns(cell: Cell) -> None:
    first = cell.operator().open().ready().move().close()
    second = cell.operator(at=first.now + 200, host="192.168.0.12").open().ready()
    second.enter(0x002).stream(60).leave().close()


def _three_clients(cell: Cell) -> None:
    driver = cell.operator().open().ready().enter(0x002)
    reader = cell.operator(CSHARP_TCP, at=5, host="192.168.0.11").open()
    viewer = cell.operator(PYTHON_UDP, at=9, host="192.168.0.12").open()
    reader.read_variable("I1", i4(1), times=6, every=150).release()
    viewer.read_errors().read_variable("S1", Variant(VT.BSTR, "ok"), times=5, every=200).release()
    driver.stream(150).leave().close()


def _two_robots_in_turn(cell: Cell) -> None:
    client = cell.operator().open().ready().move()
    other = i4(90)
    client.call("Controller_GetRobot", client.controller, text("Robot1"), text(""), result=other)
    client.call("Robot_Execute", other, text("CurJnt"), EMPTY, result=r8s(*(0.0,) * 8))
    client.call("Robot_Release", other).close()


def _sends_io(cell: Cell) -> None:
    client = cell.operator().open().ready()
    for value in (0, 1, 0):
        client.write_variable("IO24", Variant(VT.BOOL, bool(value))).wait(50)
    client.control("GetErrorDescription", i4(0), Variant(VT.BSTR, "no error")).close()


def _poses_as_arrays(cell: Cell) -> None:
    client = cell.operator().open().ready()
    pose = mixed(r8s(0, 10, 80, 0, 90, 0), text("J"), text("@E"))
    client.call("Robot_Move", client.robot, i4(1), pose, text("SPEED=20"), takes=300).close()


_EVERYWHERE: tuple[tuple[str, Session], ...] = (
    ("reads values", _reads_values),
    ("starts and stops", _starts_and_stops),
    ("moves", _moves),
    ("moves for long", _moves_for_long),
    ("drives in mode 0 or Sync", _drives(0x002)),
    ("drives in mode 1 or Async", _drives(0x102)),
    ("drives in P", _drives(0x001)),
    ("drives in T", _drives(0x103)),
    ("drives twice", _drives_twice),
    ("clears an old error", _clears_an_old_error),
    ("looks at errors", _looks_at_errors),
    ("idles", _idles),
    ("halts", _halts),
    ("opens again", _opens_again),
    ("switches the motor often", _switches_motor_often),
)
_SOMEWHERE: tuple[tuple[str, Session], ...] = (
    ("runs a task", _runs_a_task),
    ("pauses at standstill", _pauses_at_standstill),
    ("holds still at 10 Hz", _holds_still(100)),
    ("holds still at 33 Hz", _holds_still(30)),
    ("streams fast", _streams_fast),
    ("reads in slave mode", _reads_in_slave_mode),
    ("swings", _swings(0x002, 0.0)),
    ("swings with short pauses", _swings(0x002, 60.0)),
    ("swings with long pauses", _swings(0x102, 3000.0)),
    ("is watched", _watched(_drives(0x002))),
    ("takes turns", _takes_turns),
    ("three clients", _three_clients),
    ("two robots", _two_robots_in_turn),
    ("sends I/O", _sends_io),
    ("poses as arrays", _poses_as_arrays),
)
_ON_RC8: tuple[tuple[str, Session], ...] = (
    ("drives in mode 2", _drives(0x202)),
    ("drives in mode 2 in P", _drives(0x201)),
    ("swings in mode 2", _swings(0x202, 1500.0)),
    ("waits for room", _waits_for_room),
    ("uses formats", _uses_formats),
    ("watches itself", _watches_itself),
)
_TAKES_ARM_ON_RC7 = Style("RC7 behind a provider with TakeArm", option="", provider="", rc7=True)


def _takes_arm_on_rc7(cell: Cell) -> None:
    client = cell.operator().open().execute("TakeArm", i4s(0, 0)).ready()
    client.enter(0x002).stream(60).leave().close()


_CUTS = (0.2, 1.0), (0.0, 0.6), (0.3, 0.7), (0.5, 0.9), (0.05, 0.95)
_CUT_SESSIONS: tuple[tuple[str, Session], ...] = (
    ("drives", _drives(0x002)),
    ("drives in mode 1", _drives(0x102)),
    ("moves", _moves),
    ("reads values", _reads_values),
    ("drives twice", _drives_twice),
)
_CUT_STYLES = C_UDP, C_TCP, CSHARP_UDP, RC7_UDP


def _all() -> Iterator[HealthySession]:
    groups = ((_EVERYWHERE, STYLES), (_SOMEWHERE, _EVERY_OTHER), (_ON_RC8, _RC8_STYLES[::2]))
    for sessions, styles in groups:
        for name, session in sessions:
            yield from (HealthySession(name, session, style) for style in styles)
    for name, session in _CUT_SESSIONS:
        for style in _CUT_STYLES:
            for first, last in _CUTS:
                yield HealthySession(f"{name}, captured from {first} to {last}", session, style, first, last)
    for first in (0.0, 0.1):
        name = f"takes the arm, captured from {first}"
        yield HealthySession(name, _takes_arm_on_rc7, _TAKES_ARM_ON_RC7, first)
    for every in (16, 32):
        slow = ("slow-set-points",)
        for style in (C_UDP, ROS2_RC9):
            yield HealthySession(f"streams every {every} ms", _streams_slowly(every), style, notes=slow)


HEALTHY_SESSIONS: tuple[HealthySession, ...] = tuple(_all())
