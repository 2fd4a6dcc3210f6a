"""Sessions that went wrong, each with the rule of its root cause, which `diagnose` has to name first.

The troubles are those of users of DENSO's libraries and drivers, as their public issues describe them.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

from bcapscope.protocol.codec.variant import VT, Variant
from tests.analysis.faulty_acts import (
    ABANDONED,
    ACCELERATION_J1,
    HANDLE,
    INVALID,
    OUTSIDE,
    SPEED_J1,
    STOP,
    TOKEN,
    active_error_is_a_stop,
    arm_given_back,
    arm_held_by_other,
    arm_held_by_unseen,
    arm_lost_by_cleared_error,
    arm_lost_by_error,
    arm_never_taken,
    arm_refused,
    begins_again_without_closing,
    begins_far_away,
    beyond_range,
    cleared_unread,
    connect_refused,
    controller_is_silent,
    crashed_then_name_in_use,
    error_not_cleared,
    executes_forever,
    handle_after_release,
    jumps,
    leaks_handles,
    long_move_without_wdt,
    lost_unseen,
    mode_refused,
    motor_never_on,
    motor_off_after_error,
    motor_refused,
    motor_switched_off,
    motor_switched_off_by_other,
    moves_before_standstill,
    never_enters,
    not_started,
    off_pace,
    opens_gripper_itself,
    other_leaves_slave_mode,
    other_opens_gripper,
    overflows,
    pauses_in_motion,
    polls,
    quits_in_slave_mode,
    rc7_code,
    rc7_refuses_in_slave_mode,
    reply_too_late,
    reset_by_controller,
    reset_missing,
    robot_refused,
    robslave_not_restarted,
    robslave_refused,
    sends_after_leaving,
    sends_nan,
    serial_zero,
    starves,
    starves_and_recovers_badly,
    starves_at_start,
    stop_read_by_variable,
    stop_read_by_watcher,
    stopped_by,
    token_then_refusals,
    token_then_reset,
    too_fast,
    unlisted,
    vanishes_in_slave_mode,
    wdt_too_small,
    without_robslave,
    wrong_arguments,
    wrong_command,
    wrong_format,
    wrong_mode,
    wrong_provider,
)
from tests.analysis.operators import (
    C_UDP,
    CSHARP_TCP,
    PYTHON_TCP,
    PYTHON_UDP,
    ROS,
    Cell,
    Session,
    Style,
    diagnose_session,
)
from tests.analysis.scenes import Diagnosed


class FaultySession(NamedTuple):
    """A session that went wrong. `cause` is the rule of its first finding."""

    name: str
    cause: str
    session: Session
    style: Style = C_UDP

    def diagnose(self) -> Diagnosed:
        return diagnose_session(self.session, self.style)


def _harmless_refusals_of_another(session: Session) -> Session:
    """The same, next to a client with harmless refusals that began earlier."""

    def with_another(cell: Cell) -> None:
        other = cell.operator(CSHARP_TCP, host="192.168.0.11").open()
        other.execute("CurrJnt", code=0x80000904).execute("ExtSpeed", code=INVALID)
        session(cell)
        other.wait(500).read_variable("I1", Variant(VT.I4, 1)).release()

    return with_another


_LISTED = (
    ("emergency stop", "emergency-stop", (ABANDONED, STOP)),
    ("protective stop", "emergency-stop", (ABANDONED, 0x81501022)),
    ("safety state", "emergency-stop", (0x81501078, ABANDONED)),
    ("J1 too fast", "over-limit", (ABANDONED, SPEED_J1)),
    ("J1 out of range", "beyond-range", (ABANDONED, 0x83204231)),
    ("mode switch", "not-in-automatic-mode", (ABANDONED, 0x81501017)),
    ("enable switch", "not-in-automatic-mode", (ABANDONED, 0x81501021)),
    ("token", "no-executable-token", (ABANDONED, TOKEN)),
    ("virtual fence", "controller-error", (ABANDONED, 0x8320155E)),
    ("stop before an error of speed", "emergency-stop", (ABANDONED, SPEED_J1, STOP)),
)
_STATES = (
    (STOP, "emergency-stop"),
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
        yield FaultySession(f"error list: {name}", cause, stopped_by(*listed))
    for code, cause in _STATES:
        yield FaultySession(f"Motor refused with {code:08X}", cause, motor_refused(code))
        if cause in ("emergency-stop", "no-executable-token"):
            yield FaultySession(f"TakeArm refused with {code:08X}", cause, arm_refused(code), CSHARP_TCP)
    for code, cause in _RC7_CODES:
        for form in (0, 0x80000000):
            yield FaultySession(f"RC7: {form | code:08X}", cause, rc7_code(form | code))
    for code in (0x2254, 0x80002254):
        yield FaultySession(f"RC7: {code:08X}", "refused-in-slave-mode", rc7_refuses_in_slave_mode(code))


_SINGLE: tuple[FaultySession, ...] = (
    FaultySession("error list: set points while off", "emergency-stop", stopped_by(STOP, code=OUTSIDE)),
    FaultySession("error list: in ROS", "emergency-stop", stopped_by(ABANDONED, STOP, style=ROS)),
    FaultySession("error list: read by another client", "emergency-stop", stop_read_by_watcher),
    FaultySession("error list: @ERROR_CODE", "emergency-stop", stop_read_by_variable),
    FaultySession("error list: Move while an error is active", "emergency-stop", active_error_is_a_stop),
    FaultySession("pause of 100 ms, then 84201482", "set-point-gap", starves(100)),
    FaultySession("pause of 40 ms in mode 0", "set-point-gap", starves(40, 0x002)),
    FaultySession("pause over TCP", "set-point-gap", starves(64), PYTHON_TCP),
    FaultySession("pause at the start", "set-point-gap", starves_at_start),
    FaultySession("pause, and no recovery", "set-point-gap", starves_and_recovers_badly),
    FaultySession("pause, no error reported", "set-point-gap", pauses_in_motion),
    FaultySession("312 set points per second in mode 0", "off-grid", off_pace(3.2, 0x002)),
    FaultySession("100 set points per second in mode 0", "off-grid", off_pace(10, 0x002)),
    FaultySession("slow replies in mode 2", "off-grid", off_pace(9.4, 0x202, takes=9.0)),
    FaultySession("overflow", "overflow", overflows),
    FaultySession("acceleration too high", "over-limit", too_fast(ACCELERATION_J1)),
    FaultySession("speed too high", "over-limit", too_fast(SPEED_J1), PYTHON_UDP),
    FaultySession("a jump", "set-point-jump", jumps),
    FaultySession("first point far away", "far-first-point", begins_far_away),
    FaultySession("out of range", "beyond-range", beyond_range),
    FaultySession("NaN", "not-finite", sends_nan),
    FaultySession("slave mode never entered", "slvmove-outside-slave-mode", never_enters),
    FaultySession("set points after leaving", "slvmove-outside-slave-mode", sends_after_leaving),
    FaultySession("slvChangeMode refused: stop", "emergency-stop", mode_refused(STOP)),
    FaultySession("slvChangeMode refused: licence", "no-licence", mode_refused(0x83500009)),
    FaultySession("slvChangeMode refused: value", "slave-mode-refused", mode_refused(INVALID)),
    FaultySession("gripper in slave mode", "refused-in-slave-mode", opens_gripper_itself),
    FaultySession("gripper of another client", "refused-in-slave-mode", other_opens_gripper),
    FaultySession("another client leaves", "slave-mode-ended-by-other", other_leaves_slave_mode),
    FaultySession("slave mode lost", "slave-mode-lost-unseen", lost_unseen),
    FaultySession("quits in slave mode", "quit-in-slave-mode", quits_in_slave_mode),
    FaultySession("vanishes in slave mode", "quit-in-slave-mode", vanishes_in_slave_mode),
    FaultySession("arm never taken", "arm-not-taken", arm_never_taken),
    FaultySession("arm given back", "arm-not-taken", arm_given_back),
    FaultySession("arm lost by an error", "over-limit", arm_lost_by_error),
    FaultySession("arm lost by an error that was cleared", "over-limit", arm_lost_by_cleared_error),
    FaultySession("arm held by another client", "arm-taken-by-other", arm_held_by_other),
    FaultySession("arm held by the pendant", "arm-taken-by-other", arm_held_by_unseen),
    FaultySession("motor switched off", "motor-off", motor_switched_off),
    FaultySession("motor switched off by another", "motor-off", motor_switched_off_by_other),
    FaultySession("motor never on", "motor-off", motor_never_on),
    FaultySession("motor off after an error", "over-limit", motor_off_after_error),
    FaultySession("@SERVO_ON refused", "emergency-stop", motor_refused(STOP), ROS),
    FaultySession("token, then refusals", "no-executable-token", token_then_refusals),
    FaultySession("token, then ManualReset", "no-executable-token", token_then_reset),
    FaultySession("ManualReset missing", "manual-reset-missing", reset_missing),
    FaultySession("error of an earlier session", "error-not-cleared", error_not_cleared),
    FaultySession("error cleared unread", "over-limit", cleared_unread),
    FaultySession("RC7 without RobSlave", "robslave-not-running", without_robslave),
    FaultySession("RC7: RobSlave not restarted", "controller-error", robslave_not_restarted),
    FaultySession("RC7: RobSlave refused", "not-in-automatic-mode", robslave_refused),
    FaultySession("WDT too small", "wdt-too-small", wdt_too_small(0x80000902)),
    FaultySession("WDT too small, bad handles", "wdt-too-small", wdt_too_small(HANDLE)),
    FaultySession("serial 0", "serial-zero", serial_zero),
    FaultySession("service not started", "service-not-started", not_started),
    FaultySession("wrong provider", "provider-refused", wrong_provider),
    FaultySession("connect refused: licence", "no-licence", connect_refused(0x8000020C)),
    FaultySession("connect refused: unspecified", "controller-error", connect_refused(0x80004005)),
    FaultySession("robot not found", "controller-error", robot_refused),
    FaultySession("name left by a crash", "unclean-quit", crashed_then_name_in_use),
    FaultySession("new session without closing", "unclean-quit", begins_again_without_closing),
    FaultySession("handle after release", "bad-handle", handle_after_release),
    FaultySession("too many handles", "handle-leak", leaks_handles),
    FaultySession("reset by the controller", "controller-hung-up", reset_by_controller),
    FaultySession("long move without WDT", "long-call-without-wdt", long_move_without_wdt),
    FaultySession("a call that never ends", "executing-forever", executes_forever),
    FaultySession("no reply at all", "controller-silent", controller_is_silent),
    FaultySession("reply after the time-out", "late-reply", reply_too_late),
    FaultySession("unknown command", "unknown-command", wrong_command),
    FaultySession("wrong arguments", "argument-refused", wrong_arguments),
    FaultySession("wrong format", "format-refused", wrong_format),
    FaultySession("wrong mode", "slave-mode-refused", wrong_mode),
    FaultySession("slvChangeMode in motion", "no-at-e", moves_before_standstill),
    FaultySession("a value read 400 times", "polling", polls),
    FaultySession("a code that no table has", "controller-error", unlisted),
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
