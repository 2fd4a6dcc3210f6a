"""What the operators of `faulty_sessions` do: each function is a session that goes wrong, or makes one."""

from __future__ import annotations

from tests.analysis.operators import (
    C_TCP,
    PYTHON_TCP,
    RC7_TCP,
    RC7_UDP,
    Cell,
    Operator,
    Session,
    Style,
)
from tests.samples.calls import MS, START, i4, i4s, r8s, text
from tests.samples.tcp import Connection

OUTSIDE, IN_SLAVE_MODE, UNDERFLOW, ABANDONED = 0x83500121, 0x83501032, 0x84201482, 0x84201486
STOP, TOKEN, NO_ARM, NO_MOTOR, ACTIVE = 0x8150101A, 0x83501028, 0x83501024, 0x81501003, 0x81501025
INVALID, HANDLE, BUSY, NAME_IN_USE = 0x80070057, 0x80070006, 0x809100AA, 0x80000205
SPEED_J1, ACCELERATION_J1, BEYOND_J1 = 0x84204051, 0x84204041, 0x83204071
MOTOR_ON = i4s(1, 0)


def ready(cell: Cell) -> Operator:
    return cell.operator().open().ready()


def driving(cell: Cell, mode: int = 0x202) -> Operator:
    """Return an operator in the middle of a motion in slave mode."""
    return ready(cell).move().enter(mode).hold(3).stream(60)


def gives_up(client: Operator, *listed: int) -> None:
    """Send two more set points, which are refused, then read the errors and end the session properly."""
    client.point(OUTSIDE).point(OUTSIDE).leave()
    client.read_errors(*listed).clear().close()


# The error list names the cause.


def stopped_by(*listed: int, code: int = ABANDONED, style: Style | None = None) -> Session:
    def session(cell: Cell) -> None:
        if style is not None:
            cell.style = style
        gives_up(driving(cell).jump(0.05, code), *listed)

    return session


def stop_read_by_watcher(cell: Cell) -> None:
    watcher = cell.operator(PYTHON_TCP, host="192.168.0.11").open()
    client = driving(cell).jump(0.05, ABANDONED)
    watcher.now = client.now + 5
    watcher.read_errors(ABANDONED, STOP).release()
    client.leave().wait(50).close()


def stop_read_by_variable(cell: Cell) -> None:
    client = driving(cell).jump(0.05, ABANDONED).leave()
    client.read_variable("@ERROR_CODE", i4(STOP - (1 << 32))).close()


def active_error_is_a_stop(cell: Cell) -> None:
    ready(cell).move(code=ACTIVE).read_errors(STOP).close()


# Set points came too late, too fast or with too large steps.


def starves(pause: float, mode: int = 0x202) -> Session:
    def session(cell: Cell) -> None:
        client = driving(cell, mode).wait(pause)
        gives_up(client.jump(0.05, UNDERFLOW), UNDERFLOW)

    return session


def starves_at_start(cell: Cell) -> None:
    client = ready(cell).enter(0x202).stream(4).wait(120).jump(0.05, UNDERFLOW)
    gives_up(client, UNDERFLOW)


def starves_and_recovers_badly(cell: Cell) -> None:
    client = driving(cell).wait(60).jump(0.05, UNDERFLOW).point(OUTSIDE)
    client.motor(code=ACTIVE).enter(0x202, code=ACTIVE).close()


def pauses_in_motion(cell: Cell) -> None:
    driving(cell).wait(80).stream(40).hold(3).leave().close()


def overflows(cell: Cell) -> None:
    client = ready(cell).enter(0x002).stream(30, every=2.0)
    client.jump(0.05, 0x83201483).stream(5).leave().close()


def off_pace(every: float, mode: int, takes: float | None = None) -> Session:
    def session(cell: Cell) -> None:
        ready(cell).enter(mode).stream(120, every, step=0.01, takes=takes).hold(3).leave().close()

    return session


def too_fast(code: int, step: float = 0.3) -> Session:
    def session(cell: Cell) -> None:
        client = driving(cell).jump(step).jump(step + 0.05, code)
        gives_up(client, code)

    return session


def jumps(cell: Cell) -> None:
    gives_up(driving(cell).jump(8.0).stream(4).jump(0.05, SPEED_J1), SPEED_J1)


def begins_far_away(cell: Cell) -> None:
    client = ready(cell).enter(0x202)
    client.axis = 20.0
    pose = client.pose()
    client.axis = 0.0
    serial = client.ask("Robot_Execute", client.robot, text("slvMove"), pose)
    client.wait(7).answer(serial, client.pose()).wait(1)
    client.axis = 20.0
    client.jump(0.05, SPEED_J1)
    gives_up(client, SPEED_J1)


def beyond_range(cell: Cell) -> None:
    gives_up(driving(cell).jump(0.05, BEYOND_J1), BEYOND_J1)


def sends_nan(cell: Cell) -> None:
    client = driving(cell)
    client.axis = float("nan")
    client.point(0x83201405)
    client.axis = 3.0
    gives_up(client, 0x83201405)


# Slave mode ended, or was never on.


def never_enters(cell: Cell) -> None:
    ready(cell).point(OUTSIDE).point(OUTSIDE).close()


def sends_after_leaving(cell: Cell) -> None:
    driving(cell).leave().point(OUTSIDE).point(OUTSIDE).close()


def mode_refused(code: int) -> Session:
    def session(cell: Cell) -> None:
        ready(cell).enter(0x202, code=code).point(OUTSIDE).point(OUTSIDE).release()

    return session


def opens_gripper_itself(cell: Cell) -> None:
    client = driving(cell)
    client.control("HandMoveA", r8s(30.0, 50.0), code=IN_SLAVE_MODE)
    client.point(OUTSIDE).point(OUTSIDE).close()


def other_opens_gripper(cell: Cell) -> None:
    client = ready(cell).enter(0x202).stream(40)
    other = cell.operator(at=client.now - 100, host="192.168.0.11").open()
    other.now = client.now - 4
    other.control("HandMoveA", r8s(30.0, 50.0), code=IN_SLAVE_MODE)
    client.jump(0.05, OUTSIDE).point(OUTSIDE).close()
    other.release()


def other_leaves_slave_mode(cell: Cell) -> None:
    client = ready(cell).enter(0x202).stream(60)
    other = cell.operator(at=client.now - 100, host="192.168.0.11").open()
    other.now = client.now - 6
    other.leave()
    client.jump(0.05, OUTSIDE).point(OUTSIDE).close()
    other.release()


def lost_unseen(cell: Cell) -> None:
    driving(cell).jump(0.05, OUTSIDE).point(OUTSIDE).close()


def quits_in_slave_mode(cell: Cell) -> None:
    driving(cell).release()


def vanishes_in_slave_mode(cell: Cell) -> None:
    client = driving(cell)
    other = cell.operator(at=client.now + 15_000, host="192.168.0.11").open()
    other.release()


# Arm, motor, token, mode, licence.


def arm_never_taken(cell: Cell) -> None:
    cell.operator().open().enter(0x202, code=NO_ARM).release()


def arm_refused(code: int) -> Session:
    def session(cell: Cell) -> None:
        client = cell.operator().open().take_arm(code=code)
        client.motor(code=NO_ARM).enter(0x202, code=NO_ARM).release()

    return session


def arm_given_back(cell: Cell) -> None:
    client = ready(cell).move().execute("GiveArm")
    client.enter(0x202, code=NO_ARM).point(OUTSIDE).release()


def arm_lost_by_error(cell: Cell) -> None:
    client = ready(cell).move(code=0x84201414)
    client.enter(0x202, code=NO_ARM).release()


def arm_lost_by_cleared_error(cell: Cell) -> None:
    client = ready(cell).move(code=0x84201414).read_errors(0x84201414).clear()
    client.enter(0x202, code=NO_ARM).release()


def arm_held_by_other(cell: Cell) -> None:
    holder = cell.operator(host="192.168.0.11").open().take_arm()
    client = cell.operator(at=200).open().take_arm(code=NO_ARM)
    client.enter(0x202, code=NO_ARM).release()
    holder.now = client.now + 10
    holder.execute("GiveArm").release()


def arm_held_by_unseen(cell: Cell) -> None:
    cell.operator().open().take_arm(code=NO_ARM).release()


def motor_refused(code: int) -> Session:
    def session(cell: Cell) -> None:
        client = cell.operator().open().take_arm().motor(code=code)
        client.move(code=NO_MOTOR, takes=1).enter(0x202, code=NO_MOTOR).release()

    return session


def motor_switched_off(cell: Cell) -> None:
    ready(cell).move().motor(on=False).enter(0x202, code=NO_MOTOR).release()


def motor_switched_off_by_other(cell: Cell) -> None:
    client = ready(cell).move()
    cell.operator(at=client.now, host="192.168.0.11").open().motor(on=False).release()
    client.wait(600).move(code=NO_MOTOR, takes=1).execute("GiveArm").release()


def motor_never_on(cell: Cell) -> None:
    cell.operator().open().take_arm().move(code=NO_MOTOR, takes=1).execute("GiveArm").release()


def motor_off_after_error(cell: Cell) -> None:
    client = driving(cell).jump(0.4, SPEED_J1).leave().clear()
    client.move(code=NO_MOTOR, takes=1).close()


def token_then_refusals(cell: Cell) -> None:
    client = cell.operator().open().take_arm(code=TOKEN).clear(code=INVALID)
    client.motor(code=NO_ARM).enter(0x202, code=NO_ARM).release()


def token_then_reset(cell: Cell) -> None:
    client = cell.operator().open().motor(code=TOKEN)
    client.execute("MotionPreparation", code=0x83500372).clear(code=0x83500372).release()


def reset_missing(cell: Cell) -> None:
    cell.operator().open().clear(code=0x83500372).execute("MotionPreparation", code=0x83500372).release()


def error_not_cleared(cell: Cell) -> None:
    ready(cell).move(code=ACTIVE, takes=1).enter(0x202, code=ACTIVE).close()


def cleared_unread(cell: Cell) -> None:
    driving(cell).jump(0.4, SPEED_J1).leave().clear().motor().close()


# An RC7.


def without_robslave(cell: Cell) -> None:
    client = cell.operator(RC7_UDP).open().motor()
    client.enter(0x002, code=0x80004005).release()


def robslave_not_restarted(cell: Cell) -> None:
    client = cell.operator(RC7_UDP).open().ready().enter(0x002).stream(40).jump(0.05, 0x6413)
    client.clear().motor().enter(0x002, code=0x80004005).release()


def robslave_refused(cell: Cell) -> None:
    client = cell.operator(RC7_TCP).open().start_robslave(code=0x21F3)
    client.enter(0x002, code=0x80004005).release()


def rc7_code(code: int) -> Session:
    def session(cell: Cell) -> None:
        client = cell.operator(RC7_UDP).open()
        client.motor(code=code).release()

    return session


def rc7_refuses_in_slave_mode(code: int) -> Session:
    def session(cell: Cell) -> None:
        client = cell.operator(RC7_UDP).open().ready().enter(0x002).stream(40)
        client.clear(code=code).leave().close()

    return session


# The beginning and the end of a session.


def wdt_too_small(code: int) -> Session:
    def session(cell: Cell) -> None:
        cell.operator().start(",WDT=20", code=INVALID).connect(code=code).get_robot(code=code)

    return session


def serial_zero(cell: Cell) -> None:
    client = cell.operator()
    client.serial = -1
    client.start().connect(code=0x80000902).get_robot(code=0x80000902)


def not_started(cell: Cell) -> None:
    cell.operator().connect(code=0x80000902).get_robot(code=HANDLE)


def wrong_provider(cell: Cell) -> None:
    client = cell.operator().start().connect(code=0x80000201, provider="CaoProv.DENSO.RC8")
    client.get_robot(code=HANDLE).execute("CurJnt", code=HANDLE).call("Service_Stop")


def connect_refused(code: int) -> Session:
    def session(cell: Cell) -> None:
        client = cell.operator().start().connect(code=code)
        client.controller = i4(0)
        client.get_robot(code=HANDLE).call("Service_Stop")

    return session


def robot_refused(cell: Cell) -> None:
    client = cell.operator().start().connect().get_robot(code=0x80000204)
    client.robot = i4(0)
    client.execute("TakeArm", i4s(0, 0), code=HANDLE).call("Service_Stop")


def crashed_then_name_in_use(cell: Cell) -> None:
    first = cell.operator().start().connect(name="cell").get_robot().read_type().wait(200)
    again = cell.operator(at=first.now + 5000).start().connect(code=NAME_IN_USE, name="cell")
    cell.operator(at=again.now + 30_000).start()


def begins_again_without_closing(cell: Cell) -> None:
    cell.operator().open().ready().wait(500).open().close()


def handle_after_release(cell: Cell) -> None:
    client = cell.operator().open()
    client.call("Robot_Release", client.robot)
    client.execute("CurJnt", code=HANDLE)
    client.call("Controller_Disconnect", client.controller).call("Service_Stop")


def leaks_handles(cell: Cell) -> None:
    client = cell.operator().open()
    for number in range(40):
        names = client.controller, text("I1"), text("")
        client.call("Controller_GetVariable", *names, result=i4(100 + number))
    names = client.controller, text("I1"), text("")
    client.call("Controller_GetVariable", *names, code=0x80000905).release()


def reset_by_controller(cell: Cell) -> None:
    client = cell.operator(C_TCP).open()
    client.ask("Robot_Execute", client.robot, text("Motor"), MOTOR_ON)
    assert isinstance(client.network, Connection)
    client.network.reset(START + round(client.wait(30).now * MS))


# Calls that last long, and replies that are lost.


def long_move_without_wdt(cell: Cell) -> None:
    client = cell.operator().start("").connect().get_robot().read_type().take_arm().motor()
    move = client.robot, i4(1), text("@E P1"), text("")
    first = client.ask("Robot_Move", *move)
    client.wait(3000).ask("Robot_Move", *move, reserved=first)
    client.wait(3000).execute("CurJnt", code=BUSY)
    client.wait(3000).answer(first).wait(5).close()


def executes_forever(cell: Cell) -> None:
    client = cell.operator(C_TCP).open().take_arm()
    serial = client.ask("Robot_Execute", client.robot, text("Motor"), MOTOR_ON)
    for _ in range(6):
        client.wait(400).answer(serial, code=0x900)
    client.wait(100).execute("CurJnt", code=BUSY).release()


def controller_is_silent(cell: Cell) -> None:
    client = cell.operator()
    first = client.ask("Service_Start", text(",WDT=400"))
    for _ in range(6):
        client.wait(100).ask("Service_Start", text(",WDT=400"), reserved=first)
    client.wait(1000)
    other = cell.operator(at=client.now, host="192.168.0.11").open()
    other.release()


def reply_too_late(cell: Cell) -> None:
    client = driving(cell)
    client.axis += 0.05
    pose = client.pose()
    first = client.ask("Robot_Execute", client.robot, text("slvMove"), pose)
    client.wait(16).ask("Robot_Execute", client.robot, text("slvMove"), pose, reserved=first)
    client.wait(12).answer(first, pose).wait(1).answer(client.serial, pose).wait(8)
    gives_up(client.jump(0.05, UNDERFLOW), UNDERFLOW)


# Wrong calls.


def wrong_command(cell: Cell) -> None:
    cell.operator().open().execute("CurrJnt", code=0x80000904).release()


def wrong_arguments(cell: Cell) -> None:
    cell.operator().open().execute("TakeArm", text("0"), code=INVALID).release()


def wrong_format(cell: Cell) -> None:
    cell.operator().open().ready().execute("slvSendFormat", i4(0x120), code=INVALID).close()


def wrong_mode(cell: Cell) -> None:
    cell.operator().open().ready().enter(0x302, code=INVALID).close()


def moves_before_standstill(cell: Cell) -> None:
    client = ready(cell).move("@P P1", takes=5)
    client.enter(0x202, code=0x8150100D, takes=500).close()


def polls(cell: Cell) -> None:
    cell.operator().open().read_variable("I1", i4(1), times=400).release()


def unlisted(cell: Cell) -> None:
    gives_up(driving(cell).jump(0.05, 0x84999999), 0x84999999)
