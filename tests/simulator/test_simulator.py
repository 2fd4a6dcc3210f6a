"""Sessions, handles and calls, with every profile."""

from __future__ import annotations

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from bcapscope.protocol.frame import Frame, encode, parse_datagram
from bcapscope.protocol.functions import FUNCTIONS
from bcapscope.protocol.simulated import SIMULATOR_TEXT, SIMULATOR_VARIABLE
from bcapscope.protocol.variant import EMPTY, VT, Variant
from bcapscope.simulator.machine import Start
from bcapscope.simulator.profile import PROFILES
from bcapscope.simulator.simulator import FORGOTTEN_AFTER, KEPT, MOST_CLIENTS, Simulator
from bcapscope.simulator.values import bstr, i2, i4, r4, r8, row
from tests.simulator.desk import MS, Desk, Operator, Person, ints, joints
from tests.strategies import variants

START = encode(1, 0, 1, [bstr("")])
E_HANDLE, E_INVALIDARG, E_NOTIMPL = 0x80070006, 0x80070057, 0x80004001
E_TOO_MUCH_DATA = 0x80000909


@pytest.fixture(params=list(PROFILES))
def desk(request: pytest.FixtureRequest) -> Desk:
    return Desk(str(request.param))


@pytest.fixture
def operator(desk: Desk) -> Operator:
    return Operator(desk)


def test_everything_before_service_start_is_refused(desk: Desk) -> None:
    person = Person(desk)
    assert person.call("Controller_Connect", *map(bstr, "abcd")).hresult == 0x80000902


@pytest.mark.parametrize(("option", "result"), [(",WDT=79", E_INVALIDARG), (",WDT=80", 0), ("WDT=400", 0)])
def test_wdt_has_a_least_value(desk: Desk, option: str, result: int) -> None:
    assert Person(desk).call("Service_Start", bstr(option)).hresult == result


@pytest.mark.parametrize(
    ("profile", "provider", "result"),
    [
        ("rc7", "", 0),
        ("rc8", "CaoProv.DENSO.VRC", 0),
        ("rc8", "CaoProv.DENSO.RC8", E_INVALIDARG),
        ("rc9", "CaoProv.DENSO.VRC", E_INVALIDARG),
        ("rc9", "caoprov.denso.vrc9", 0),
    ],
)
def test_the_provider_counts_but_on_rc7(profile: str, provider: str, result: int) -> None:
    person = Person(Desk(profile))
    person.call("Service_Start", bstr(""))
    assert person.call("Controller_Connect", *map(bstr, ("", provider, "", ""))).hresult == result


def test_a_controller_connected_twice_under_one_name() -> None:
    person = Person(Desk("rc8"))
    person.call("Service_Start", bstr(""))
    texts = ("a", "CaoProv.DENSO.VRC", "localhost")
    first = person.call("Controller_Connect", *map(bstr, (*texts, "")))
    assert person.call("Controller_Connect", *map(bstr, (*texts, ""))).hresult == 0x80000205
    again = person.call("Controller_Connect", *map(bstr, (*texts, "@IfNotMember")))
    assert again.value == first.value


def test_a_name_is_in_use_as_long_as_any_client_has_it() -> None:
    desk = Desk("rc8")
    first, second = Person(desk, "first"), Person(desk, "second")
    names = [bstr(text) for text in ("Cell", "CaoProv.DENSO.VRC", "localhost", "")]
    first.call("Service_Start", bstr(""))
    second.call("Service_Start", bstr(""))
    assert first.call("Controller_Connect", *names).hresult == 0
    assert second.call("Controller_Connect", bstr("CELL"), *names[1:]).hresult == 0x80000205
    assert second.call("Controller_Connect", *names[:3], bstr("@IfNotMember")).hresult == 0
    assert second.call("Service_Stop").hresult == 0
    desk.simulator.disconnect("first", desk.now)
    second.call("Service_Start", bstr(""))
    assert second.call("Controller_Connect", *names).hresult == 0


@pytest.mark.parametrize(
    ("option", "ms"),
    [
        ("", 274),
        ("SPEED=50", 524),
        ("speed = 50 NEXT", 0),
        ("TIME=3000", 3024),
        ("TIME=1", 274),
        ("NEXT", 0),
    ],
)
def test_a_motion_is_made_as_its_option_says(option: str, ms: float) -> None:
    operator = Operator(Desk())
    operator.ready()
    reply = operator.move("@E J(40,0,90,0,90,0)", option)
    assert (reply.hresult, reply.ms) == (0, ms)


@pytest.mark.parametrize("option", ["SPEED=0", "SPEED=101", "SPEED=x", "TIME=-1", "TIME=1e300", "TIME=nan"])
def test_a_motion_with_an_odd_option_is_refused(option: str) -> None:
    operator = Operator(Desk())
    operator.ready()
    assert operator.move("@E J(40,0,90,0,90,0)", option).hresult >> 16 in (0x8007, 0x8002)
    assert operator.robot("CurJnt").value == joints(0, 0, 90, 0, 90, 0)


def test_handles_are_of_one_class_and_end_with_their_release(operator: Operator) -> None:
    variable = operator.get("Controller_GetVariable", operator.controller, "I1")
    assert operator.call("Robot_GetName", variable).hresult == E_HANDLE
    assert operator.call("Variable_GetName", i4(4711)).hresult == E_HANDLE
    assert operator.call("Variable_GetName", variable).value == "I1"
    assert operator.call("Variable_Release", variable).hresult == 0
    assert operator.call("Variable_Release", variable).hresult == E_HANDLE
    assert operator.call("Controller_Disconnect", operator.controller).hresult == 0
    assert operator.call("Robot_GetName", operator.arm).hresult == E_HANDLE


def test_a_client_has_a_thousand_objects(operator: Operator) -> None:
    results = [
        operator.call("Controller_GetVariable", operator.controller, bstr("I1"), bstr("")).hresult
        for _ in range(999)
    ]
    assert results == [0] * 998 + [0x80000905]


@pytest.mark.parametrize("function_id", [0, 138, 200, 0x80000000, 0xFFFFFFFF])
def test_ids_outside(desk: Desk, function_id: int) -> None:
    reply = desk.simulator.datagram("a", encode(1, 0, function_id), 0)
    assert reply[0].data == encode(1, 0, E_INVALIDARG)


@pytest.mark.parametrize("function_id", [each for each in FUNCTIONS if each not in (1, 2, 4)])
def test_every_function_answers_one_argument_or_none(function_id: int) -> None:
    operator = Operator(Desk("cserver"))
    function = FUNCTIONS[function_id]
    fill = {"VT_I4": i4(1), "VT_R4": r4(1), "VT_BSTR": bstr("x"), "VARIANT": EMPTY}
    handles = {"Controller": operator.controller, "Robot": operator.arm}
    rest = tuple(fill[param.type] for param in function.params[1:])
    reply = operator.call(function.name, handles.get(function.owner, i4(99)), *rest)
    assert reply.hresult != 0x8000FFFF
    if reply.hresult == E_NOTIMPL or function.result == "none":
        assert reply.vt is None
    else:
        assert reply.vt is not None


@pytest.mark.parametrize(
    ("name", "value", "back"),
    [
        ("I7", i4(-5), -5),
        ("I7", r8(3.9), 3),
        ("F7", r8(0.5), 0.5),
        ("D7", r8(0.1), 0.1),
        ("S7", bstr("日本"), "日本"),
        ("V7", row(VT.R8, (1, 2, 3)), (1.0, 2.0, 3.0)),
        ("J7", row(VT.R4, (1, 2)), joints(1.0, 2.0)),
        ("IO130", Variant(VT.BOOL, True), True),
        ("IOB128", i2(0x7F), 0x7F),
        ("IOW128", i4(0xABCD), 0xABCD),
        ("IOF128", r4(2.5), 2.5),
    ],
)
def test_variables_keep_what_is_written(operator: Operator, name: str, value: Variant, back: object) -> None:
    assert operator.write(name, value).hresult == 0
    assert operator.read(name.lower()).value == back


@pytest.mark.parametrize(
    ("name", "value", "result"),
    [
        ("I7", bstr("5"), 0x80020005),
        ("I7", r8(1e10), 0x8002000A),
        ("I100", i4(1), 0x8002000B),
        ("P1", row(VT.R8, range(8)), 0x80020005),
        ("S1", bstr("x" * 248), 0x8007000E),
        ("IO512", i4(1), 0x8002000B),
        ("@MODE", i4(1), 0x8000020A),
    ],
)
def test_what_does_not_fit_is_refused(desk: Desk, name: str, value: Variant, result: int) -> None:
    operator = Operator(desk, tcp=True)
    assert operator.write(name, value).hresult == result


def test_a_star_takes_its_number_from_the_id(operator: Operator) -> None:
    operator.write("I9", i4(99))
    variable = operator.get("Controller_GetVariable", operator.controller, "I*")
    assert operator.call("Variable_GetValue", variable).hresult == 0x8002000B
    operator.call("Variable_PutID", variable, i4(9))
    assert operator.call("Variable_GetValue", variable).value == 99


def test_poses_are_single_on_rc7_and_double_later() -> None:
    for name, vt in (("rc7", VT.R4), ("rc8", VT.R8)):
        operator = Operator(Desk(name))
        variable = operator.get("Robot_GetVariable", operator.arm, "@CURRENT_ANGLE")
        reply = operator.call("Variable_GetValue", variable)
        assert (reply.vt, reply.value) == (0x2000 | vt, joints(0, 0, 90, 0, 90))


def test_the_simulator_says_that_it_is_one(operator: Operator) -> None:
    assert operator.read(SIMULATOR_VARIABLE).value == SIMULATOR_TEXT


def test_unknown_names_are_refused(operator: Operator) -> None:
    for function, name in (("GetVariable", "@NONE"), ("GetTask", "Pro9"), ("GetFile", "a.pac")):
        reply = operator.call(f"Controller_{function}", operator.controller, bstr(name), bstr(""))
        assert reply.hresult == 0x80000204
    made = operator.call("Controller_GetFile", operator.controller, bstr("a.pac"), bstr("@Create=1"))
    assert made.hresult == 0


def test_the_arm_has_one_owner() -> None:
    desk = Desk()
    first, second = Operator(desk, "a"), Operator(desk, "b")
    assert first.robot("TakeArm").hresult == 0
    assert second.robot("takearm").hresult == 0x83501024
    assert second.robot("GiveArm").hresult == 0
    assert second.robot("TakeArm").hresult == 0x83501024
    first.call("Service_Stop")
    assert second.robot("TakeArm").hresult == 0


def test_motion_needs_arm_motor_and_no_error() -> None:
    operator = Operator(Desk())
    results = [operator.move("J(0,0,90)").hresult]
    operator.robot("Motor", i4(1))
    results.append(operator.move("J(0,0,90,0,0,0)").hresult)
    operator.robot("TakeArm")
    results.append(operator.move("J(0,0,90,0,0,0)").hresult)
    operator.desk.machine.fail(0x84204051, operator.desk.now)
    results.append(operator.move("J(0,0,90,0,0,0)").hresult)
    assert results == [E_INVALIDARG, 0x83501024, 0, 0x81501025]


def test_errors_are_told_until_they_are_cleared() -> None:
    operator = Operator(Desk())
    operator.desk.machine.fail(0x84204051, operator.desk.now)
    assert operator.read("@ERROR_CODE").value == 0x84204051 - (1 << 32)
    assert operator.command("GetCurErrorCount").value == 1
    info = operator.command("GetCurErrorInfo", i4(0)).value
    assert isinstance(info, tuple)
    assert len(info) == 7
    assert "J1" in str(info[1])
    assert operator.command("GetCurErrorInfo", i4(1)).hresult == 0x8002000B
    state = operator.command("SysState").value
    assert isinstance(state, int)
    assert state >> 1 & 1
    assert operator.command("ClearError").hresult == 0
    assert operator.command("GetCurErrorCount").value == 0
    assert operator.command("GetErrorLogCount").value == 1
    log = operator.command("GetErrorLog", i4(0)).value
    assert isinstance(log, tuple)
    assert len(log) == 16


def test_the_emergency_stop_stays_until_it_is_let_go() -> None:
    operator = Operator(Desk())
    operator.ready()
    operator.desk.machine.press_emergency_stop(operator.desk.now)
    assert operator.robot("Motor", i4(1)).hresult == 0x8150101A
    assert operator.command("ClearError").hresult == 0x8150101A
    operator.desk.machine.emergency = False
    assert operator.command("ClearError").hresult == 0
    assert operator.robot("Motor", i4(1)).hresult == 0


def test_a_move_takes_time_and_ends_where_it_should() -> None:
    operator = Operator(Desk())
    operator.ready()
    plain = operator.move("J(90, 0, 90, 0, 90, 0)")
    ends = operator.move("@E J(0, 0, 90, 0, 90, 0)")
    passing = operator.move("@P J(90, 0, 90, 0, 90, 0)")
    assert ends.ms - plain.ms == pytest.approx(24, abs=0.1)
    assert 0.69 < passing.ms / plain.ms < 0.71
    operator.desk.wait(1000)
    assert operator.robot("CurJnt").value == joints(90, 0, 90, 0, 90, 0)
    operator.robot("ExtSpeed", r8(10))
    assert operator.move("J(0, 0, 90, 0, 90, 0)").ms == pytest.approx(plain.ms * 10, rel=0.01)


def test_a_second_move_meanwhile_is_told_to_come_back() -> None:
    operator = Operator(Desk())
    operator.ready()
    assert operator.move("J(90,0,90,0,90,0)", "SPEED=50, NEXT").ms == 0
    assert operator.move("J(0,0,90,0,90,0)").hresult == 0x80010004
    assert operator.robot("MotionComplete", ints(0, 1)).value is False
    operator.desk.wait(2000)
    assert operator.robot("MotionComplete", ints(0, 1)).value is True
    assert operator.move("J(0,0,90,0,90,0)").hresult == 0


def test_halt_stops_a_motion_of_another_client() -> None:
    desk = Desk()
    first, second = Operator(desk, "a"), Operator(desk, "b")
    first.ready()
    first.robot("ExtSpeed", r8(1))
    assert first.send("Robot_Move", first.arm, i4(1), bstr("J(90,0,90,0,90,0)"), bstr("")) == []
    desk.wait(100)
    outputs = second.send("Robot_Halt", second.arm, bstr(""))
    assert {output.peer: Frame(output.data).code for output in outputs} == {"b": 0, "a": 0x83201404}
    angle = second.robot("CurJnt").value
    assert isinstance(angle, tuple)
    assert 0 < float(str(angle[0])) < 10


def test_beyond_reach_and_limits() -> None:
    operator = Operator(Desk())
    operator.ready()
    assert operator.move("J(171,0,90,0,90,0)").hresult == 0x83204071
    assert operator.move("P(5000,0,0,0,0,0)").hresult == 0x83204232
    assert operator.robot("OutRange", bstr("J(0,140,90,0,0,0)")).value == 2
    assert operator.robot("OutRange", bstr("P(5000,0,0,0,0,0)")).value == -1


def test_conversions_agree_with_each_other() -> None:
    operator = Operator(Desk())
    here = (20.0, 30.0, 60.0, 10.0, 20.0, 30.0, 0.0, 0.0)
    position = operator.robot("J2P", row(VT.R8, here)).value
    assert isinstance(position, tuple)
    trans = operator.robot("P2T", row(VT.R8, tuple(map(float, map(str, position))))).value
    assert isinstance(trans, tuple)
    back = operator.robot("T2J", row(VT.R8, tuple(map(float, map(str, trans))))).value
    assert back == pytest.approx(here)


def test_the_control_log_has_a_record_each_8_ms() -> None:
    operator = Operator(Desk())
    operator.ready()
    operator.robot("StartLog")
    moved = operator.move("J(10,0,90,0,90,0)")
    operator.robot("StopLog")
    count = operator.robot("GetLogCount").value
    assert isinstance(count, int)
    assert count == int(moved.ms / 8) + 1
    tcp = Operator(operator.desk, "tcp", tcp=True)
    record = tcp.robot("GetLogRecord", i4(count - 1)).value
    assert isinstance(record, tuple)
    assert len(record) == 39
    assert operator.robot("GetLogRecord", i4(0)).hresult == 0x80000909
    assert operator.robot("ClearLog").hresult == 0
    assert operator.robot("GetLogCount").value == 0


def test_s_executing_comes_each_wdt_while_a_call_runs() -> None:
    desk = Desk("cserver", Start(motor=True))
    operator = Operator(desk, options=",WDT=80")
    operator.robot("TakeArm")
    operator.robot("ExtSpeed", r8(10))
    reply = operator.move("J(20,0,90,0,90,0)")
    assert reply.hresult == 0
    assert reply.notices == int(reply.ms / 80) > 5


def test_a_stuck_call_is_never_answered_and_makes_the_client_busy() -> None:
    desk = Desk("cserver", Start(motor=True))
    operator = Operator(desk, options=",WDT=80,InvokeTimeout=200")
    operator.robot("TakeArm")
    operator.robot("ExtSpeed", r8(1))
    stuck = operator.send("Robot_Move", operator.arm, i4(1), bstr("J(90,0,90,0,90,0)"), bstr(""))
    assert stuck == []
    assert len(desk.wait(1000)) == 2
    assert operator.robot("CurJnt").hresult == 0x809100AA
    assert desk.wait(120_000) == []
    assert operator.robot("CurJnt").hresult == 0


def test_calls_of_one_client_wait_for_each_other() -> None:
    desk = Desk("rc8", Start(motor=True))
    operator = Operator(desk, tcp=True)
    operator.robot("TakeArm")
    operator.send("Robot_Move", operator.arm, i4(1), bstr("@E J(10,0,90,0,90,0)"), bstr(""))
    assert operator.send("Robot_Execute", operator.arm, bstr("CurJnt"), EMPTY) == []
    codes = [Frame(output.data).serial for output in desk.wait(2000)]
    assert codes == [operator.serial - 1, operator.serial]


def test_a_retry_is_answered_and_not_run_again() -> None:
    desk = Desk("rc7")
    operator = Operator(desk)
    count = len(desk.simulator._links["client"].conversation.client.objects)
    content = (9, [operator.controller, bstr("I2"), bstr("")])
    first = desk.simulator.datagram("client", encode(100, 0, *content), desk.now)[0].data
    again = desk.simulator.datagram("client", encode(101, 100, *content), desk.now)[0].data
    assert Frame(first).arguments == Frame(again).arguments
    assert (Frame(again).serial, Frame(again).reserved) == (101, 100)
    assert len(desk.simulator._links["client"].conversation.client.objects) == count + 1


def test_what_a_datagram_cannot_carry_is_refused() -> None:
    """The names of all variables are a few kB."""
    for tcp, result in ((False, E_TOO_MUCH_DATA), (True, 0)):
        operator = Operator(Desk("rc8"), tcp=tcp)
        assert operator.call("Controller_GetVariableNames", operator.controller, bstr("")).hresult == result
        assert operator.call("Controller_GetName", operator.controller).hresult == 0


def test_reserved_is_echoed_by_rc7_only() -> None:
    for name, reserved in (("rc7", 7), ("rc8", 0)):
        outputs = Desk(name).simulator.datagram("a", encode(7, 7, 1, [bstr("")]), 0)
        assert Frame(outputs[0].data).reserved == reserved


def test_defects_of_the_c_server_are_its_own() -> None:
    for name, result in (("cserver", 0), ("rc8", E_INVALIDARG)):
        outputs = Desk(name).simulator.datagram("a", encode(0, 0, 200), 0)
        assert Frame(outputs[0].data).code == result


@pytest.mark.parametrize("data", [b"", b"\x01", b"\x01\xff\xff\xff\xff" + bytes(20), b"x" * 600])
def test_a_bad_datagram_is_dropped_and_counted(desk: Desk, data: bytes) -> None:
    assert desk.simulator.datagram("a", data, 0) == []
    assert (desk.simulator.dropped, desk.simulator.clients) == (1, 0)


def test_a_bad_frame_ends_a_connection_without_reply(desk: Desk) -> None:
    assert desk.simulator.connect("a", 0)
    outputs = desk.simulator.segment("a", encode(1, 0, 1, [bstr("")])[:-1] + b"\x05" + b"\x01" * 40, 0)
    assert outputs == [("a", b"")]
    assert desk.simulator.clients == 0


def test_twenty_clients_of_each_kind() -> None:
    simulator = Desk().simulator
    request = encode(1, 0, 1, [bstr("")])
    for number in range(MOST_CLIENTS):
        assert simulator.connect(("tcp", number), 0)
        assert simulator.datagram(("udp", number), request, number)
    assert not simulator.connect("one more", 0)
    assert simulator.datagram("one more", request, FORGOTTEN_AFTER - 1) == []
    assert simulator.datagram("one more", request, FORGOTTEN_AFTER)
    assert simulator.datagram("another", request, FORGOTTEN_AFTER) == []


def test_stops_find_a_place_when_all_are_taken_and_others_keep_theirs() -> None:
    simulator = Desk().simulator
    request, halt = encode(1, 0, 1, [bstr("")]), encode(1, 0, 70, [i4(1), bstr("")])
    for number in range(MOST_CLIENTS):
        assert simulator.connect(("tcp", number), 0)
        assert simulator.datagram(("udp", number), request, 0)
    for number in range(3 * KEPT):
        assert simulator.datagram(("stop", number), halt, 1)
        assert simulator.connect(("stop, TCP", number), 1, is_stop=True) is (number < KEPT)
        assert simulator.clients <= 2 * (MOST_CLIENTS + KEPT)
    assert simulator.datagram("one more", request, 1) == []
    for number in range(MOST_CLIENTS):
        assert simulator.datagram(("udp", number), halt, 1)


def test_reset_lets_go_of_all() -> None:
    desk = Desk()
    first = Operator(desk, "a", tcp=True)
    first.robot("TakeArm")
    assert desk.simulator.reset(desk.now) == [("a", b"")]
    assert Operator(desk, "b").robot("TakeArm").hresult == 0


@settings(max_examples=60, deadline=None)
@given(st.lists(st.tuples(st.integers(0, 140), st.lists(variants(), max_size=4)), max_size=12))
def test_any_request_gets_one_answer_at_most(requests: list[tuple[int, list[Variant]]]) -> None:
    desk = Desk("rc8", Start(motor=True))
    operator = Operator(desk, tcp=True)
    operator.robot("TakeArm")
    for function_id, arguments in requests:
        filled = [operator.controller if function_id < 26 else operator.arm, *arguments]
        operator.serial += 1
        raw = encode(operator.serial, 0, function_id, filled)
        outputs = desk.simulator.segment("client", raw, desk.now) + desk.wait(60_000)
        assert len([each for each in outputs if each.data]) <= 1
        if any(not each.data for each in outputs):
            return


@settings(max_examples=100, deadline=None)
@given(st.lists(st.binary(max_size=80), max_size=10))
def test_any_bytes_are_taken(chunks: list[bytes]) -> None:
    simulator = Simulator(PROFILES["rc7"])
    simulator.connect("a", 0)
    for number, chunk in enumerate(chunks):
        simulator.segment("a", chunk, number * MS)
        simulator.datagram("b", chunk, number * MS)
        simulator.datagram("b", b"\x01" + (len(chunk) + 5).to_bytes(4, "little") + chunk, number * MS)


def _framed(inner: bytes) -> bytes:
    return b"\x01" + (len(inner) + 6).to_bytes(4, "little") + inner + b"\x04"


@given(
    st.binary(max_size=40)
    | st.binary(min_size=8, max_size=30).map(_framed)
    | st.binary(max_size=4).map(lambda more: START + more)
    | st.integers(0, len(START)).map(lambda stop: START[:stop])
)
def test_a_datagram_is_looked_at_or_dropped_as_its_frames_say(data: bytes) -> None:
    simulator = Simulator(PROFILES["rc8"])
    simulator.datagram("a", data, 0)
    items = parse_datagram(data)
    sound = len(items) == 1 and isinstance(items[0], Frame) and not items[0].problems
    assert simulator.dropped == (not sound)
