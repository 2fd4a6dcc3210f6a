"""Slave mode, as it works and as it fails."""

from __future__ import annotations

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from bcapscope.protocol.frame import Frame
from bcapscope.protocol.variant import EMPTY, VT, Variant
from bcapscope.simulator.profile import PROFILES
from bcapscope.simulator.values import bstr, i2, i4, r8, row, variants
from tests.simulator.desk import Desk, Operator, ints, joints

HOME = (0.0, 0.0, 90.0, 0.0, 90.0, 0.0)
UNDERFLOW, OVERFLOW, OUTSIDE, REFUSED = 0x84201482, 0x83201483, 0x83500121, 0x83501032
FULL = 0x0F200501


def started(profile: str = "rc8", mode: int | None = None) -> Operator:
    """An operator in slave mode, by joints; the mode that waits unless another is asked for."""
    operator = Operator(Desk(profile))
    operator.ready()
    chosen = mode if mode is not None else 0x002 if profile == "rc7" else 0x202
    assert operator.slave(chosen).hresult == 0
    return operator


def send(operator: Operator, first: float) -> int:
    """Send a set point whose J1 is `first` degrees away from home; return the result."""
    return operator.point(first, *HOME[1:]).hresult


def current_errors(operator: Operator) -> list[int]:
    """Read the current errors as clients do, the newest first."""
    count = operator.command("GetCurErrorCount").value
    assert isinstance(count, int)
    found = []
    for index in range(count):
        info = operator.command("GetCurErrorInfo", i4(index)).value
        assert isinstance(info, tuple)
        assert isinstance(info[0], Variant)
        assert isinstance(info[0].value, int)
        found.append(info[0].value & 0xFFFFFFFF)
    newest = operator.read("@ERROR_CODE").value
    assert isinstance(newest, int)
    assert newest & 0xFFFFFFFF == (found[0] if found else 0)
    return found


@pytest.mark.parametrize("profile", sorted(PROFILES))
def test_slvmove_outside_slave_mode_is_a_current_error(profile: str) -> None:
    operator = Operator(Desk(profile))
    operator.ready()
    assert current_errors(operator) == []
    assert [send(operator, 0) for _ in range(40)] == [OUTSIDE] * 40
    assert current_errors(operator) == [OUTSIDE]
    assert operator.command("GetErrorLogCount").value == 1
    assert operator.move("J(0,0,90,0,90,0)").hresult == 0x81501025
    assert operator.command("ClearError").hresult == 0
    assert current_errors(operator) == []


@pytest.mark.parametrize(("profile", "stops"), [("rc7", True), ("rc8", False)])
def test_slvmove_outside_slave_mode_is_an_error_of_level_3(profile: str, stops: bool) -> None:
    """It ends motions and programs; the motor stays on."""
    operator = Operator(Desk(profile))
    operator.ready()
    operator.move("J(90,0,90,0,90,0)", "NEXT")
    operator.desk.wait(100)
    assert send(operator, 0) == OUTSIDE
    operator.desk.wait(100)
    busy = operator.get("Robot_GetVariable", operator.arm, "@BUSY_STATUS")
    servo = operator.get("Robot_GetVariable", operator.arm, "@SERVO_ON")
    assert operator.call("Variable_GetValue", busy).value is False
    assert operator.call("Variable_GetValue", servo).value is True
    assert operator.command("ClearError").hresult == 0
    assert operator.slave(0x002).hresult == (0x80004005 if stops else 0)


@pytest.mark.parametrize("profile", sorted(PROFILES))
def test_another_mode_in_slave_mode_is_a_current_error(profile: str) -> None:
    operator = started(profile)
    assert operator.slave(0x102).hresult == REFUSED
    assert operator.robot("slvGetMode").value == 0
    assert current_errors(operator) == [REFUSED]
    assert send(operator, 0) == OUTSIDE
    assert current_errors(operator) == [OUTSIDE, REFUSED]


@pytest.mark.parametrize(
    ("profile", "mode", "result"),
    [
        ("rc7", 0x002, 0),
        ("rc7", 0x103, 0),
        ("rc7", 0x202, 0x80070057),
        ("rc8", 0x202, 0),
        ("rc9", 0x001, 0),
        ("rc8", 0x004, 0x80070057),
        ("rc8", 0x302, 0x80070057),
    ],
)
def test_modes_by_generation(profile: str, mode: int, result: int) -> None:
    operator = Operator(Desk(profile))
    operator.ready()
    reply = operator.slave(mode)
    assert reply.hresult == result
    got = operator.robot("slvGetMode", bstr(""))
    assert got.value == (0 if result else mode)
    assert got.vt == (VT.I2 if profile == "rc7" else VT.I4)


def test_what_must_be_ready() -> None:
    operator = Operator(Desk("rc8"))
    results = [operator.slave(0x202).hresult]
    operator.robot("Motor", i4(1))
    results.append(operator.slave(0x202).hresult)
    operator.robot("TakeArm")
    operator.desk.machine.mode = 1
    results.append(operator.slave(0x202).hresult)
    operator.desk.machine.mode = 3
    results.append(operator.slave(0x202).hresult)
    results.append(operator.slave(0x102).hresult)
    assert results == [0x81501003, 0x83501024, 0x81501017, 0, REFUSED]


def test_rc7_needs_robslave() -> None:
    operator = Operator(Desk("rc7"))
    operator.robot("Motor", i2(1))
    assert operator.slave(0x002).hresult == 0x80004005
    operator.ready()
    assert operator.slave(0x002).hresult == 0


@pytest.mark.parametrize(("profile", "result"), [("rc7", 0x600B), ("rc8", 0x8150100D)])
def test_entering_waits_half_a_second_for_standstill(profile: str, result: int) -> None:
    operator = Operator(Desk(profile))
    operator.ready()
    operator.robot("ExtSpeed", r8(10))
    operator.move("J(20,0,90,0,90,0)", "NEXT")
    reply = operator.slave(0x002)
    assert (reply.hresult, reply.ms) == (result, 500)
    operator.desk.wait(5000)
    assert operator.slave(0x002).hresult == 0


def test_entering_after_an_end_motion_does_not_wait() -> None:
    waits = []
    for passing in ("@0", "@E"):
        operator = Operator(Desk())
        operator.ready()
        operator.move(f"{passing} J(20,0,90,0,90,0)")
        waits.append(operator.slave(0x202).ms)
    assert waits == [24, 0]


@pytest.mark.parametrize(("profile", "mode", "at_once"), [("rc7", 0x002, 0), ("rc8", 0x202, 3)])
def test_waiting_modes_pace_the_client(profile: str, mode: int, at_once: int) -> None:
    operator = started(profile, mode)
    times = []
    for number in range(20):
        reply = operator.point(number * 0.1, *HOME[1:])
        assert reply.hresult == 0
        times.append(reply.ms)
    assert times == [0] * at_once + [8] * (20 - at_once)


def test_set_points_are_followed_with_a_lag() -> None:
    operator = started()
    for number in range(51):
        send(operator, number * 0.1)
    behind = operator.robot("CurJnt").value
    assert isinstance(behind, tuple)
    assert 4.0 < float(str(behind[0])) < 5.0
    assert operator.slave(0).hresult == 0
    assert operator.robot("CurJnt").value == pytest.approx(joints(5.0, *HOME[1:]))


def test_the_arm_does_not_move_before_a_set_point_has_come() -> None:
    operator = started("rc7")
    operator.desk.wait(3000)
    before = operator.point(0.005, *HOME[1:]).value
    assert before == pytest.approx(joints(*HOME))


@pytest.mark.parametrize(
    ("profile", "mode", "keeps_time"),
    [
        ("rc7", 0x002, False),
        ("rc7", 0x102, True),
        ("rc8", 0x002, False),
        ("rc8", 0x102, True),
        ("rc8", 0x202, False),
    ],
)
def test_time_may_stand_still_only_where_clients_wait_for_replies(
    profile: str, mode: int, keeps_time: bool
) -> None:
    operator = started(profile, mode)
    assert operator.desk.answerer.keeps_time is keeps_time
    operator.slave(0)
    assert not operator.desk.answerer.keeps_time


def test_mode_0_warns_when_full_and_refuses_one_too_many() -> None:
    operator = started(mode=0x002)
    results = [send(operator, 0.1) for _ in range(5)]
    assert results == [0, 0, FULL, OVERFLOW, OVERFLOW]
    operator.desk.wait(8)
    assert [send(operator, 0.1) for _ in range(2)] == [FULL, OVERFLOW]


def test_mode_1_takes_the_newest_point_and_holds_the_last() -> None:
    operator = started(mode=0x102)
    for number in range(5):
        assert send(operator, 0.05 * number) == 0
    operator.desk.wait(100)
    assert operator.robot("CurJnt").value == pytest.approx(joints(0.2, *HOME[1:]))
    assert operator.robot("slvGetMode").value == 0x102


def test_running_empty_while_moving_ends_slave_mode() -> None:
    operator = started(mode=0x202)
    for number in range(10):
        send(operator, number * 0.2)
    operator.desk.wait(3 * 8 + 8)
    assert [send(operator, 2) for _ in range(3)] == [UNDERFLOW, OUTSIDE, OUTSIDE]
    assert operator.robot("slvGetMode").value == 0
    assert current_errors(operator) == [OUTSIDE, UNDERFLOW]
    assert operator.slave(0x202).hresult == 0x81501025
    assert operator.command("ClearError").hresult == 0
    assert operator.slave(0x202).hresult == 0x81501003
    assert operator.robot("Motor", ints(1, 0)).hresult == 0
    assert operator.slave(0x202).hresult == 0


def test_three_points_are_24_ms_of_slack() -> None:
    for pause, result in ((23, 0), (33, UNDERFLOW)):
        operator = started(mode=0x002)
        for number in range(3):
            send(operator, 0.2 * number)
        operator.desk.wait(pause)
        assert send(operator, 0.6) == result


def test_standing_still_without_points_is_no_error() -> None:
    operator = started()
    for _ in range(5):
        send(operator, 0)
    operator.desk.wait(60_000)
    assert send(operator, 0) == 0


def test_robslave_stops_with_an_error_on_rc7() -> None:
    operator = started("rc7")
    for number in range(5):
        send(operator, number * 0.3)
    operator.desk.wait(50)
    assert send(operator, 0) == UNDERFLOW
    operator.command("ClearError")
    operator.robot("Motor", i2(1))
    operator.desk.wait(1000)
    assert operator.slave(0x002).hresult == 0x80004005
    operator.ready()
    assert operator.slave(0x002).hresult == 0


@pytest.mark.parametrize(("detector", "mode"), [(False, 0x102), (True, 0)])
def test_a_late_point_is_an_error_in_async_of_rc7_if_its_detector_is_on(detector: bool, mode: int) -> None:
    operator = started("rc7", 0x102)
    operator.desk.machine.slave.async_detector = detector
    for number in range(3):
        send(operator, number * 0.1)
        operator.desk.wait(8)
    operator.desk.wait(100)
    assert operator.robot("slvGetMode").value == mode
    assert operator.machine_error() == (UNDERFLOW if detector else 0)


@pytest.mark.parametrize(
    ("points", "code"),
    [
        ([3.0], 0x84204051),
        ([0.3, 0.6, 0.3], 0x84204041),
        ([200.0], 0x83204231),
    ],
)
def test_limits_of_an_axis_end_slave_mode(points: list[float], code: int) -> None:
    operator = started(mode=0x002)
    results = []
    for point in points:
        results.append(send(operator, point))
        operator.desk.wait(8)
    assert operator.machine_error() == code
    assert operator.robot("slvGetMode").value == 0


def test_a_set_point_beyond_its_limit_is_refused_at_once() -> None:
    operator = started()
    assert operator.point(0, 0, 90, 0, 130, 0).hresult == 0x83204235
    assert operator.point(*HOME).hresult == OUTSIDE


@pytest.mark.parametrize(
    ("parameter", "result"),
    [
        (row(VT.R8, HOME), 0),
        (row(VT.R4, (*HOME, 0, 0)), 0),
        (row(VT.R8, (*HOME, 0, 0, 0x40003F)), 0),
        (row(VT.R8, HOME[:5]), 0x80070057),
        (row(VT.R8, range(10)), 0x80070057),
        (row(VT.R8, (float("nan"), *HOME[1:])), 0x83201405),
        (EMPTY, 0x80070057),
        (bstr("J(0,0,90,0,90,0)"), 0x80070057),
    ],
)
def test_lengths_and_types_of_set_points(parameter: Variant, result: int) -> None:
    assert started().robot("slvMove", parameter).hresult == result


def test_positions_and_trans_are_set_points_too() -> None:
    for mode, command in ((0x201, "CurPos"), (0x203, "CurTrn")):
        operator = Operator(Desk())
        operator.ready()
        here = operator.robot(command).value
        assert isinstance(here, tuple)
        operator.slave(mode)
        reply = operator.robot("slvMove", Variant.array(VT.R8, here))
        assert reply.hresult == 0
        assert reply.value == pytest.approx(here)


@pytest.mark.parametrize("command", ["ClearError", "SysState", "GetCurErrorInfo"])
def test_commands_that_slave_mode_refuses_end_it(command: str) -> None:
    operator = started()
    assert operator.command(command, i4(0)).hresult == REFUSED
    assert operator.point(*HOME).hresult == OUTSIDE
    assert current_errors(operator) == [OUTSIDE, REFUSED]


def test_a_second_client_ends_the_first_ones_slave_mode() -> None:
    operator = started()
    other = Operator(operator.desk, "other")
    assert other.robot("TakeArm").hresult == REFUSED
    assert operator.point(*HOME).hresult == OUTSIDE


def test_what_slave_mode_allows() -> None:
    operator = started()
    for command in ("slvGetMode", "CurPos", "CurJnt", "GetSrvData"):
        assert operator.robot(command, i4(2)).hresult == 0
    assert operator.write("I1", i4(5)).hresult == 0
    assert operator.point(*HOME).hresult == 0
    assert operator.call("Robot_Halt", operator.arm, bstr("")).hresult == 0
    assert operator.point(*HOME).hresult == OUTSIDE


def test_the_set_points_of_another_client_are_refused() -> None:
    operator = started()
    other = Operator(operator.desk, "other")
    assert other.point(*HOME).hresult == 0x83501024


def test_a_client_that_waits_for_its_turn_hears_of_the_error() -> None:
    operator = started("rc8", 0x202)
    other = Operator(operator.desk, "other")
    for _ in range(3):
        operator.point(*HOME)
    assert operator.send("Robot_Execute", operator.arm, bstr("slvMove"), row(VT.R8, HOME)) == []
    outputs = other.send("Robot_Execute", other.arm, bstr("TakeArm"), EMPTY)
    assert {output.peer: Frame(output.data).code for output in outputs} == {
        "client": REFUSED,
        "other": REFUSED,
    }


def test_formats_of_rc8() -> None:
    operator = Operator(Desk())
    operator.ready()
    assert operator.robot("slvSendFormat", i4(0x0320)).hresult == 0x80070057
    assert operator.robot("slvSendFormat", i4(0x0020)).hresult == 0
    assert operator.robot("slvRecvFormat", ints(0x0034 | 0x40 | 0x100, 1)).hresult == 0
    operator.slave(0x202)
    point = variants(row(VT.R8, HOME), i4(0x00AB0000))
    reply = operator.robot("slvMove", point)
    assert reply.hresult == 0
    assert isinstance(reply.value, tuple)
    kinds = [part.vt for part in reply.value if isinstance(part, Variant)]
    assert kinds == [VT.I4, 0x2000 | VT.R8, VT.I4, VT.I4, 0x2000 | VT.R8]
    stamp, poses, _, hand, _ = (part.value for part in reply.value if isinstance(part, Variant))
    assert stamp == operator.desk.now // 1000
    assert isinstance(poses, tuple)
    assert len(poses) == 15
    assert hand == 0x00AB0000
    operator.slave(0)
    assert operator.read("IOB64").value == 0xAB


def test_user_io_of_rc8() -> None:
    operator = Operator(Desk())
    operator.ready()
    operator.robot("slvSendFormat", i4(0x200))
    operator.robot("slvRecvFormat", i4(0x202))
    operator.slave(0x202)
    data = Variant.array(VT.UI1, b"\x12\x34")
    whole = variants(row(VT.R8, HOME), i4(256), i4(16), data, i4(256), i4(16))
    reply = operator.robot("slvMove", whole)
    assert isinstance(reply.value, tuple)
    assert reply.value[1] == data
    far = variants(row(VT.R8, HOME), i4(504), i4(16), data, i4(256), i4(16))
    assert operator.robot("slvMove", far).hresult == 0x80070057


def test_rc7_has_no_formats() -> None:
    assert Operator(Desk("rc7")).robot("slvSendFormat", i4(0)).hresult == 0x80010005


def test_leaving_goes_to_the_last_point_first() -> None:
    operator = started(mode=0x002)
    for number in range(3):
        send(operator, number * 0.3)
    reply = operator.slave(0)
    assert (reply.hresult, reply.ms) == (0, 48)
    assert operator.machine_error() == 0
    assert operator.robot("slvMove", EMPTY).hresult == OUTSIDE
    assert operator.robot("CurJnt").value == pytest.approx(joints(0.6, *HOME[1:]))


def test_motions_after_slave_mode_begin_where_it_ended() -> None:
    operator = started()
    for number in range(20):
        send(operator, number * 0.1)
    operator.slave(0)
    assert operator.move("@E J(0,0,90,0,90,0)").hresult == 0
    assert operator.robot("CurJnt").value == joints(*HOME)


@pytest.mark.parametrize("mode", [0x002, 0x102, 0x202])
def test_slave_mode_begins_where_the_one_before_it_ended(mode: int) -> None:
    operator = started()
    for number in range(20):
        send(operator, number * 0.1)
    assert operator.slave(0).hresult == 0
    assert operator.slave(mode).hresult == 0
    assert operator.robot("CurJnt").value == pytest.approx(joints(1.9, *HOME[1:]))
    operator.desk.wait(100)
    assert send(operator, 1.9) == 0
    operator.desk.wait(100)
    assert operator.robot("CurJnt").value == pytest.approx(joints(1.9, *HOME[1:]))
    assert operator.machine_error() == 0


@settings(max_examples=60, deadline=None)
@given(st.sampled_from((0x002, 0x102, 0x202)), st.lists(st.tuples(st.floats(0, 40), st.floats(-0.3, 0.3))))
def test_any_pace_gives_an_answer_each_and_an_end_that_is_told(
    mode: int, steps: list[tuple[float, float]]
) -> None:
    operator = started(mode=mode)
    here, results = 0.0, []
    for pause, way in steps:
        operator.desk.wait(pause)
        here += way
        results.append(send(operator, here))
    ended = [number for number, result in enumerate(results) if result == OUTSIDE]
    assert ended == list(range(len(results) - len(ended), len(results)))
    on = operator.robot("slvGetMode").value == mode
    assert on is (operator.machine_error() == 0)


@pytest.mark.parametrize("mode", [0x002, 0x102, 0x202])
def test_what_ended_slave_mode_is_told_once(mode: int) -> None:
    operator = started(mode=mode)
    send(operator, 0)
    operator.desk.machine.press_emergency_stop(operator.desk.now)
    assert [send(operator, 0) for _ in range(3)] == [0x8150101A, OUTSIDE, OUTSIDE]


def test_what_ended_slave_mode_is_not_told_after_it_was_left() -> None:
    operator = started()
    operator.desk.machine.switch_mode(1, operator.desk.now)
    assert operator.slave(0).hresult == 0
    assert send(operator, 0) == OUTSIDE


@pytest.mark.parametrize("clears", [False, True])
def test_an_error_while_slave_mode_is_left_is_not_answered_later(clears: bool) -> None:
    operator = started(mode=0x002)
    send(operator, 0.3)
    assert operator.send("Robot_Execute", operator.arm, bstr("slvChangeMode"), i4(0)) == []
    operator.desk.machine.fail(0x84204051, operator.desk.now)
    (output,) = operator.desk.wait(0)
    assert Frame(output.data).code == 0
    if clears:
        assert operator.command("ClearError").hresult == 0
    assert send(operator, 0) == OUTSIDE


def test_a_cleared_error_is_not_answered_later() -> None:
    operator = started()
    other = Operator(operator.desk, "other")
    operator.desk.machine.fail(0x84204051, operator.desk.now)
    assert other.command("ClearError").hresult == 0
    assert send(operator, 0) == OUTSIDE


def test_a_client_that_waits_is_told_and_nobody_else() -> None:
    operator = started(mode=0x202)
    for _ in range(3):
        operator.point(*HOME)
    assert operator.send("Robot_Execute", operator.arm, bstr("slvMove"), row(VT.R8, HOME)) == []
    operator.desk.machine.switch_motor(False, operator.desk.now)
    (output,) = operator.desk.wait(0)
    assert Frame(output.data).code == 0x81501003
    assert send(operator, 0) == OUTSIDE
