"""Sessions that went wrong, each with the rule of its root cause, which `diagnose` has to name first.

The troubles are those of users of DENSO's libraries and drivers, as their public issues describe them.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

from bcapscope.protocol.codec.variant import VT, Variant
from tests.analysis.operators import (
    C_TCP,
    C_UDP,
    CSHARP_TCP,
    PYTHON_TCP,
    PYTHON_UDP,
    RC7_TCP,
    RC7_UDP,
    ROS,
    Cell,
    Operator,
    Session,
    Style,
    diagnose_session,
)
from tests.analysis.scenes import Diagnosed
from tests.samples.calls import MS, START, i4, i4s, r8s, text
from tests.samples.tcp import Connection

_OUTSIDE, _IN_SLAVE_MODE, _UNDERFLOW, _ABANDONED = 0x83500121, 0x83501032, 0x84201482, 0x84201486
_STOP, _TOKEN, _NO_ARM, _NO_MOTOR, _ACTIVE = 0x8150101A, 0x83501028, 0x83501024, 0x81501003, 0x81501025
_INVALID, _HANDLE, _BUSY, _NAME_IN_USE = 0x80070057, 0x80070006, 0x809100AA, 0x80000205
_SPEED_J1, _ACCELERATION_J1, _BEYOND_J1 = 0x84204051, 0x84204041, 0x83204071
_MOTOR_ON = i4s(1, 0)


class FaultySession(NamedTuple):
    """A session that went wrong. `cause` is the rule of its first finding."""

    name: str
    cause: str
    session: Session
    style: Style = C_UDP

    def diagnose(self) -> Diagnosed:
        return diagnose_session(self.session, self.style)


def _ready(cell: Cell) -> Operator:
    return cell.operator().open().ready()


def _driving(cell: Cell, mode: int = 0x202) -> Operator:
    """Return an operator in the middle of a motion in slave mode."""
    return _ready(cell).move().enter(mode).hold(3).stream(60)


def _gives_up(client: Operator, *listed: int) -> None:
    """Send two more set points, which are refused, then read the errors and end the session properly."""
    client.point(_OUTSIDE).point(_OUTSIDE).leave()
    client.read_errors(*listed).clear().close()


# The error list names the cause.


def _stopped_by(*listed: int, code: int = _ABANDONED, style: Style | None = None) -> Session:
    def session(cell: Cell) -> None:
        if style is not None:
            cell.style = style
        _gives_up(_driving(cell).jump(0.05, code), *listed)

    return session


def _stop_read_by_watcher(cell: Cell) -> None:
    watcher = cell.operator(PYTHON_TCP, host="192.168.0.11").open()
    client = _driving(cell).jump(0.05, _ABANDONED)
    watcher.now = client.now + 5
    watcher.read_errors(_ABANDONED, _STOP).release()
    client.leave().wait(50).close()


def _stop_read_by_variable(cell: Cell) -> None:
    client = _driving(cell).jump(0.05, _ABANDONED).leave()
    client.read_variable("@ERROR_CODE", i4(_STOP - (1 << 32))).close()


def _active_error_is_a_stop(cell: Cell) -> None:
    _ready(cell).move(code=_ACTIVE).read_errors(_STOP).close()


# Set points came too late, too fast or with too large steps.


def _starves(pause: float, mode: int = 0x202) -> Session:
    def session(cell: Cell) -> None:
        client = _driving(cell, mode).wait(pause)
        _gives_up(client.jump(0.05, _UNDERFLOW), _UNDERFLOW)

    return session


def _starves_at_start(cell: Cell) -> None:
    client = _ready(cell).enter(0x202).stream(4).wait(120).jump(0.05, _UNDERFLOW)
    _gives_up(client, _UNDERFLOW)


def _starves_and_recovers_badly(cell: Cell) -> None:
    client = _driving(cell).wait(60).jump(0.05, _UNDERFLOW).point(_OUTSIDE)
    client.motor(code=_ACTIVE).enter(0x202, code=_ACTIVE).close()


def _pauses_in_motion(cell: Cell) -> None:
    _driving(cell).wait(80).stream(40).hold(3).leave().close()


def _overflows(cell: Cell) -> None:
    client = _ready(cell).enter(0x002).stream(30, every=2.0)
    client.jump(0.05, 0x83201483).stream(5).leave().close()


def _off_pace(every: float, mode: int, takes: float | None = None) -> Session:
    def session(cell: Cell) -> None:
        _ready(cell).enter(mode).stream(120, every, step=0.01, takes=takes).hold(3).leave().close()

    return session


def _too_fast(code: int, step: float = 0.3) -> Session:
    def session(cell: Cell) -> None:
        client = _driving(cell).jump(step).jump(step + 0.05, code)
        _gives_up(client, code)

    return session


def _jumps(cell: Cell) -> None:
    _gives_up(_driving(cell).jump(8.0).stream(4).jump(0.05, _SPEED_J1), _SPEED_J1)


def _begins_far_away(cell: Cell) -> None:
    client = _ready(cell).enter(0x202)
    client.axis = 20.0
    pose = client.pose()
    client.axis = 0.0
    serial = client.ask("Robot_Execute", client.robot, text("slvMove"), pose)
    client.wait(7).answer(serial, client.pose()).wait(1)
    client.axis = 20.0
    client.jump(0.05, _SPEED_J1)
    _gives_up(client, _SPEED_J1)


def _beyond_range(cell: Cell) -> None:
    _gives_up(_driving(cell).jump(0.05, _BEYOND_J1), _BEYOND_J1)


def _sends_nan(cell: Cell) -> None:
    client = _driving(cell)
    client.axis = float("nan")
    client.point(0x83201405)
    client.axis = 3.0
    _gives_up(client, 0x83201405)


# Slave mode ended, or was never on.


def _never_enters(cell: Cell) -> None:
    _ready(cell).point(_OUTSIDE).point(_OUTSIDE).close()


def _sends_after_leaving(cell: Cell) -> None:
    _driving(cell).leave().point(_OUTSIDE).point(_OUTSIDE).close()


def _mode_refused(code: int) -> Session:
    def session(cell: Cell) -> None:
        _ready(cell).enter(0x202, code=code).point(_OUTSIDE).point(_OUTSIDE).release()

    return session


def _opens_gripper_itself(cell: Cell) -> None:
    client = _driving(cell)
    client.control("HandMoveA", r8s(30.0, 50.0), code=_IN_SLAVE_MODE)
    client.point(_OUTSIDE).point(_OUTSIDE).close()


def _other_opens_gripper(cell: Cell) -> None:
    client = _ready(cell).enter(0x202).stream(40)
    other = cell.operator(at=client.now - 100, host="192.168.0.11").open()
    other.now = client.now - 4
    other.control("HandMoveA", r8s(30.0, 50.0), code=_IN_SLAVE_MODE)
    client.jump(0.05, _OUTSIDE).point(_OUTSIDE).close()
    other.release()


def _other_leaves_slave_mode(cell: Cell) -> None:
    client = _ready(cell).enter(0x202).stream(60)
    other = cell.operator(at=client.now - 100, host="192.168.0.11").open()
    other.now = client.now - 6
    other.leave()
    client.jump(0.05, _OUTSIDE).point(_OUTSIDE).close()
    other.release()


def _lost_unseen(cell: Cell) -> None:
    _driving(cell).jump(0.05, _OUTSIDE).point(_OUTSIDE).close()


def _quits_in_slave_mode(cell: Cell) -> None:
    _driving(cell).release()


def _vanishes_in_slave_mode(cell: Cell) -> None:
    client = _driving(cell)
    other = cell.operator(at=client.now + 15_000, host="192.168.0.11").open()
    other.release()


# Arm, motor, token, mode, licence.


def _arm_never_taken(cell: Cell) -> None:
    cell.operator().open().enter(0x202, code=_NO_ARM).release()


def _arm_refused(code: int) -> Session:
    def session(cell: Cell) -> None:
        client = cell.operator().open().take_arm(code=code)
        client.motor(code=_NO_ARM).enter(0x202, code=_NO_ARM).release()

    return session


def _arm_given_back(cell: Cell) -> None:
    client = _ready(cell).move().execute("GiveArm")
    client.enter(0x202, code=_NO_ARM).point(_OUTSIDE).release()


def _arm_lost_by_error(cell: Cell) -> None:
    client = _ready(cell).move(code=0x84201414)
    client.enter(0x202, code=_NO_ARM).release()


def _arm_held_by_other(cell: Cell) -> None:
    holder = cell.operator(host="192.168.0.11").open().take_arm()
    client = cell.operator(at=200).open().take_arm(code=_NO_ARM)
    client.enter(0x202, code=_NO_ARM).release()
    holder.now = client.now + 10
    holder.execute("GiveArm").release()


def _arm_held_by_unseen(cell: Cell) -> None:
    cell.operator().open().take_arm(code=_NO_ARM).release()


def _motor_refused(code: int) -> Session:
    def session(cell: Cell) -> None:
        client = cell.operator().open().take_arm().motor(code=code)
        client.move(code=_NO_MOTOR, takes=1).enter(0x202, code=_NO_MOTOR).release()

    return session


def _motor_switched_off(cell: Cell) -> None:
    _ready(cell).move().motor(on=False).enter(0x202, code=_NO_MOTOR).release()


def _motor_switched_off_by_other(cell: Cell) -> None:
    client = _ready(cell).move()
    cell.operator(at=client.now, host="192.168.0.11").open().motor(on=False).release()
    client.wait(600).move(code=_NO_MOTOR, takes=1).execute("GiveArm").release()


def _motor_never_on(cell: Cell) -> None:
    cell.operator().open().take_arm().move(code=_NO_MOTOR, takes=1).execute("GiveArm").release()


def _motor_off_after_error(cell: Cell) -> None:
    client = _driving(cell).jump(0.4, _SPEED_J1).leave().clear()
    client.move(code=_NO_MOTOR, takes=1).close()


def _token_then_refusals(cell: Cell) -> None:
    client = cell.operator().open().take_arm(code=_TOKEN).clear(code=_INVALID)
    client.motor(code=_NO_ARM).enter(0x202, code=_NO_ARM).release()


def _token_then_reset(cell: Cell) -> None:
    client = cell.operator().open().motor(code=_TOKEN)
    client.execute("MotionPreparation", code=0x83500372).clear(code=0x83500372).release()


def _reset_missing(cell: Cell) -> None:
    cell.operator().open().clear(code=0x83500372).execute("MotionPreparation", code=0x83500372).release()


def _error_not_cleared(cell: Cell) -> None:
    _ready(cell).move(code=_ACTIVE, takes=1).enter(0x202, code=_ACTIVE).close()


def _cleared_unread(cell: Cell) -> None:
    _driving(cell).jump(0.4, _SPEED_J1).leave().clear().motor().close()


# An RC7.


def _without_robslave(cell: Cell) -> None:
    client = cell.operator(RC7_UDP).open().motor()
    client.enter(0x002, code=0x80004005).release()


def _robslave_not_restarted(cell: Cell) -> None:
    client = cell.operator(RC7_UDP).open().ready().enter(0x002).stream(40).jump(0.05, 0x6413)
    client.clear().motor().enter(0x002, code=0x80004005).release()


def _robslave_refused(cell: Cell) -> None:
    client = cell.operator(RC7_TCP).open().start_robslave(code=0x21F3)
    client.enter(0x002, code=0x80004005).release()


def _rc7_code(code: int) -> Session:
    def session(cell: Cell) -> None:
        client = cell.operator(RC7_UDP).open()
        client.motor(code=code).release()

    return session


def _rc7_refuses_in_slave_mode(code: int) -> Session:
    def session(cell: Cell) -> None:
        client = cell.operator(RC7_UDP).open().ready().enter(0x002).stream(40)
        client.clear(code=code).leave().close()

    return session


# The beginning and the end of a session.


def _wdt_too_small(code: int) -> Session:
    def session(cell: Cell) -> None:
        cell.operator().start(",WDT=20", code=_INVALID).connect(code=code).get_robot(code=code)

    return session


def _serial_zero(cell: Cell) -> None:
    client = cell.operator()
    client.serial = -1
    client.start().connect(code=0x80000902).get_robot(code=0x80000902)


def _not_started(cell: Cell) -> None:
    cell.operator().connect(code=0x80000902).get_robot(code=_HANDLE)


def _wrong_provider(cell: Cell) -> None:
    client = cell.operator().start().connect(code=0x80000201, provider="CaoProv.DENSO.RC8")
    client.get_robot(code=_HANDLE).execute("CurJnt", code=_HANDLE).call("Service_Stop")


def _connect_refused(code: int) -> Session:
    def session(cell: Cell) -> None:
        client = cell.operator().start().connect(code=code)
        client.controller = i4(0)
        client.get_robot(code=_HANDLE).call("Service_Stop")

    return session


def _robot_refused(cell: Cell) -> None:
    client = cell.operator().start().connect().get_robot(code=0x80000204)
    client.robot = i4(0)
    client.execute("TakeArm", i4s(0, 0), code=_HANDLE).call("Service_Stop")


def _crashed_then_name_in_use(cell: Cell) -> None:
    first = cell.operator().start().connect(name="cell").get_robot().read_type().wait(200)
    again = cell.operator(at=first.now + 5000).start().connect(code=_NAME_IN_USE, name="cell")
    cell.operator(at=again.now + 30_000).start()


def _begins_again_without_closing(cell: Cell) -> None:
    cell.operator().open().ready().wait(500).open().close()


def _handle_after_release(cell: Cell) -> None:
    client = cell.operator().open()
    client.call("Robot_Release", client.robot)
    client.execute("CurJnt", code=_HANDLE)
    client.call("Controller_Disconnect", client.controller).call("Service_Stop")


def _leaks_handles(cell: Cell) -> None:
    client = cell.operator().open()
    for number in range(40):
        names = client.controller, text("I1"), text("")
        client.call("Controller_GetVariable", *names, result=i4(100 + number))
    names = client.controller, text("I1"), text("")
    client.call("Controller_GetVariable", *names, code=0x80000905).release()


def _reset_by_controller(cell: Cell) -> None:
    client = cell.operator(C_TCP).open()
    client.ask("Robot_Execute", client.robot, text("Motor"), _MOTOR_ON)
    assert isinstance(client.network, Connection)
    client.network.reset(START + round(client.wait(30).now * MS))


# Calls that last long, and replies that are lost.


def _long_move_without_wdt(cell: Cell) -> None:
    client = cell.operator().start("").connect().get_robot().read_type().take_arm().motor()
    move = client.robot, i4(1), text("@E P1"), text("")
    first = client.ask("Robot_Move", *move)
    client.wait(3000).ask("Robot_Move", *move, reserved=first)
    client.wait(3000).execute("CurJnt", code=_BUSY)
    client.wait(3000).answer(first).wait(5).close()


def _executes_forever(cell: Cell) -> None:
    client = cell.operator(C_TCP).open().take_arm()
    serial = client.ask("Robot_Execute", client.robot, text("Motor"), _MOTOR_ON)
    for _ in range(6):
        client.wait(400).answer(serial, code=0x900)
    client.wait(100).execute("CurJnt", code=_BUSY).release()


def _controller_is_silent(cell: Cell) -> None:
    client = cell.operator()
    first = client.ask("Service_Start", text(",WDT=400"))
    for _ in range(6):
        client.wait(100).ask("Service_Start", text(",WDT=400"), reserved=first)
    client.wait(1000)
    other = cell.operator(at=client.now, host="192.168.0.11").open()
    other.release()


def _reply_too_late(cell: Cell) -> None:
    client = _driving(cell)
    client.axis += 0.05
    pose = client.pose()
    first = client.ask("Robot_Execute", client.robot, text("slvMove"), pose)
    client.wait(16).ask("Robot_Execute", client.robot, text("slvMove"), pose, reserved=first)
    client.wait(12).answer(first, pose).wait(1).answer(client.serial, pose).wait(8)
    _gives_up(client.jump(0.05, _UNDERFLOW), _UNDERFLOW)


# Wrong calls.


def _wrong_command(cell: Cell) -> None:
    cell.operator().open().execute("CurrJnt", code=0x80000904).release()


def _wrong_arguments(cell: Cell) -> None:
    cell.operator().open().execute("TakeArm", text("0"), code=_INVALID).release()


def _wrong_format(cell: Cell) -> None:
    cell.operator().open().ready().execute("slvSendFormat", i4(0x120), code=_INVALID).close()


def _wrong_mode(cell: Cell) -> None:
    cell.operator().open().ready().enter(0x302, code=_INVALID).close()


def _moves_before_standstill(cell: Cell) -> None:
    client = _ready(cell).move("@P P1", takes=5)
    client.enter(0x202, code=0x8150100D, takes=500).close()


def _polls(cell: Cell) -> None:
    cell.operator().open().read_variable("I1", i4(1), times=400).release()


def _unlisted(cell: Cell) -> None:
    _gives_up(_driving(cell).jump(0.05, 0x84999999), 0x84999999)


def _harmless_refusals_of_another(session: Session) -> Session:
    """The same, next to a client with harmless refusals that began earlier."""

    def with_another(cell: Cell) -> None:
        other = cell.operator(CSHARP_TCP, host="192.168.0.11").open()
        other.execute("CurrJnt", code=0x80000904).execute("ExtSpeed", code=_INVALID)
        session(cell)
        other.wait(500).read_variable("I1", Variant(VT.I4, 1)).release()

    return with_another


_LISTED = (
    ("emergency stop", "emergency-stop", (_ABANDONED, _STOP)),
    ("protective stop", "emergency-stop", (_ABANDONED, 0x81501022)),
    ("safety state", "emergency-stop", (0x81501078, _ABANDONED)),
    ("J1 too fast", "over-limit", (_ABANDONED, _SPEED_J1)),
    ("J1 out of range", "beyond-range", (_ABANDONED, 0x83204231)),
    ("mode switch", "not-in-automatic-mode", (_ABANDONED, 0x81501017)),
    ("enable switch", "not-in-automatic-mode", (_ABANDONED, 0x81501021)),
    ("token", "no-executable-token", (_ABANDONED, _TOKEN)),
    ("virtual fence", "controller-error", (_ABANDONED, 0x8320155E)),
    ("stop before an error of speed", "emergency-stop", (_ABANDONED, _SPEED_J1, _STOP)),
)
_STATES = (
    (_STOP, "emergency-stop"),
    (0x83500178, "emergency-stop"),
    (0x8150101C, "emergency-stop"),
    (0x81501017, "not-in-automatic-mode"),
    (0x81501005, "not-in-automatic-mode"),
    (0x83501026, "no-executable-token"),
    (0x83501029, "no-executable-token"),
    (0x83500126, "no-licence"),
    (0x8000020C, "no-licence"),
    (0x81501069, "manual-reset-missing"),
    (0x8350106E, "motor-switching-off"),
    (0x80000900, "controller-timeout"),
    (0x8150012D, "controller-timeout"),
    (0x83500160, "controller-error"),
)
_RC7_CODES = (
    (0x21F3, "not-in-automatic-mode"),
    (0x21E7, "not-in-automatic-mode"),
    (0x2008, "emergency-stop"),
    (0x2289, "no-executable-token"),
    (0x21D3, "error-not-cleared"),
)


def _in_families() -> Iterator[FaultySession]:
    """Yield sessions that differ only in the code with which something was refused."""
    for name, cause, listed in _LISTED:
        yield FaultySession(f"error list: {name}", cause, _stopped_by(*listed))
    for code, cause in _STATES:
        yield FaultySession(f"Motor refused with {code:08X}", cause, _motor_refused(code))
        if cause in ("emergency-stop", "no-executable-token"):
            yield FaultySession(f"TakeArm refused with {code:08X}", cause, _arm_refused(code), CSHARP_TCP)
    for code, cause in _RC7_CODES:
        for form in (0, 0x80000000):
            yield FaultySession(f"RC7: {form | code:08X}", cause, _rc7_code(form | code))
    for code in (0x2254, 0x80002254):
        yield FaultySession(f"RC7: {code:08X}", "refused-in-slave-mode", _rc7_refuses_in_slave_mode(code))


_SINGLE: tuple[FaultySession, ...] = (
    FaultySession("error list: set points while off", "emergency-stop", _stopped_by(_STOP, code=_OUTSIDE)),
    FaultySession("error list: in ROS", "emergency-stop", _stopped_by(_ABANDONED, _STOP, style=ROS)),
    FaultySession("error list: read by another client", "emergency-stop", _stop_read_by_watcher),
    FaultySession("error list: @ERROR_CODE", "emergency-stop", _stop_read_by_variable),
    FaultySession("error list: Move while an error is active", "emergency-stop", _active_error_is_a_stop),
    FaultySession("pause of 100 ms, then 84201482", "set-point-gap", _starves(100)),
    FaultySession("pause of 40 ms in mode 0", "set-point-gap", _starves(40, 0x002)),
    FaultySession("pause over TCP", "set-point-gap", _starves(64), PYTHON_TCP),
    FaultySession("pause at the start", "set-point-gap", _starves_at_start),
    FaultySession("pause, and no recovery", "set-point-gap", _starves_and_recovers_badly),
    FaultySession("pause, no error reported", "set-point-gap", _pauses_in_motion),
    FaultySession("312 set points per second in mode 0", "off-grid", _off_pace(3.2, 0x002)),
    FaultySession("100 set points per second in mode 0", "off-grid", _off_pace(10, 0x002)),
    FaultySession("slow replies in mode 2", "off-grid", _off_pace(9.4, 0x202, takes=9.0)),
    FaultySession("overflow", "overflow", _overflows),
    FaultySession("acceleration too high", "over-limit", _too_fast(_ACCELERATION_J1)),
    FaultySession("speed too high", "over-limit", _too_fast(_SPEED_J1), PYTHON_UDP),
    FaultySession("a jump", "set-point-jump", _jumps),
    FaultySession("first point far away", "far-first-point", _begins_far_away),
    FaultySession("out of range", "beyond-range", _beyond_range),
    FaultySession("NaN", "not-finite", _sends_nan),
    FaultySession("slave mode never entered", "slvmove-outside-slave-mode", _never_enters),
    FaultySession("set points after leaving", "slvmove-outside-slave-mode", _sends_after_leaving),
    FaultySession("slvChangeMode refused: stop", "emergency-stop", _mode_refused(_STOP)),
    FaultySession("slvChangeMode refused: licence", "no-licence", _mode_refused(0x83500009)),
    FaultySession("slvChangeMode refused: value", "slave-mode-refused", _mode_refused(_INVALID)),
    FaultySession("gripper in slave mode", "refused-in-slave-mode", _opens_gripper_itself),
    FaultySession("gripper of another client", "refused-in-slave-mode", _other_opens_gripper),
    FaultySession("another client leaves", "slave-mode-ended-by-other", _other_leaves_slave_mode),
    FaultySession("slave mode lost", "slave-mode-lost-unseen", _lost_unseen),
    FaultySession("quits in slave mode", "quit-in-slave-mode", _quits_in_slave_mode),
    FaultySession("vanishes in slave mode", "quit-in-slave-mode", _vanishes_in_slave_mode),
    FaultySession("arm never taken", "arm-not-taken", _arm_never_taken),
    FaultySession("arm given back", "arm-not-taken", _arm_given_back),
    FaultySession("arm lost by an error", "over-limit", _arm_lost_by_error),
    FaultySession("arm held by another client", "arm-taken-by-other", _arm_held_by_other),
    FaultySession("arm held by the pendant", "arm-taken-by-other", _arm_held_by_unseen),
    FaultySession("motor switched off", "motor-off", _motor_switched_off),
    FaultySession("motor switched off by another", "motor-off", _motor_switched_off_by_other),
    FaultySession("motor never on", "motor-off", _motor_never_on),
    FaultySession("motor off after an error", "over-limit", _motor_off_after_error),
    FaultySession("@SERVO_ON refused", "emergency-stop", _motor_refused(_STOP), ROS),
    FaultySession("token, then refusals", "no-executable-token", _token_then_refusals),
    FaultySession("token, then ManualReset", "no-executable-token", _token_then_reset),
    FaultySession("ManualReset missing", "manual-reset-missing", _reset_missing),
    FaultySession("error of an earlier session", "error-not-cleared", _error_not_cleared),
    FaultySession("error cleared unread", "over-limit", _cleared_unread),
    FaultySession("RC7 without RobSlave", "robslave-not-running", _without_robslave),
    FaultySession("RC7: RobSlave not restarted", "controller-error", _robslave_not_restarted),
    FaultySession("RC7: RobSlave refused", "not-in-automatic-mode", _robslave_refused),
    FaultySession("WDT too small", "wdt-too-small", _wdt_too_small(0x80000902)),
    FaultySession("WDT too small, bad handles", "wdt-too-small", _wdt_too_small(_HANDLE)),
    FaultySession("serial 0", "serial-zero", _serial_zero),
    FaultySession("service not started", "service-not-started", _not_started),
    FaultySession("wrong provider", "provider-refused", _wrong_provider),
    FaultySession("connect refused: licence", "no-licence", _connect_refused(0x8000020C)),
    FaultySession("connect refused: unspecified", "controller-error", _connect_refused(0x80004005)),
    FaultySession("robot not found", "controller-error", _robot_refused),
    FaultySession("name left by a crash", "unclean-quit", _crashed_then_name_in_use),
    FaultySession("new session without closing", "unclean-quit", _begins_again_without_closing),
    FaultySession("handle after release", "bad-handle", _handle_after_release),
    FaultySession("too many handles", "handle-leak", _leaks_handles),
    FaultySession("reset by the controller", "controller-hung-up", _reset_by_controller),
    FaultySession("long move without WDT", "long-call-without-wdt", _long_move_without_wdt),
    FaultySession("a call that never ends", "executing-forever", _executes_forever),
    FaultySession("no reply at all", "controller-silent", _controller_is_silent),
    FaultySession("reply after the time-out", "late-reply", _reply_too_late),
    FaultySession("unknown command", "unknown-command", _wrong_command),
    FaultySession("wrong arguments", "argument-refused", _wrong_arguments),
    FaultySession("wrong format", "format-refused", _wrong_format),
    FaultySession("wrong mode", "slave-mode-refused", _wrong_mode),
    FaultySession("slvChangeMode in motion", "no-at-e", _moves_before_standstill),
    FaultySession("a value read 400 times", "polling", _polls),
    FaultySession("a code that no table has", "controller-error", _unlisted),
)
_BESIDE = ("set-point-gap", "over-limit", "emergency-stop", "refused-in-slave-mode", "slave-mode-lost-unseen")


def _all() -> Iterator[FaultySession]:
    yield from _SINGLE
    yield from _in_families()
    for cause in _BESIDE:
        alone = next(each for each in _SINGLE if each.cause == cause)
        name = f"{alone.name}, beside harmless refusals of another client"
        yield FaultySession(name, cause, _harmless_refusals_of_another(alone.session), alone.style)


FAULTY_SESSIONS: tuple[FaultySession, ...] = tuple(_all())
