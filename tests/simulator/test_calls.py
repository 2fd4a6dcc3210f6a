"""Handles, functions and calls, with every profile."""

from __future__ import annotations

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from bcapscope.protocol.codec.frame import Frame, encode_frame
from bcapscope.protocol.codec.variant import EMPTY, Variant
from bcapscope.protocol.tables.function_table import FUNCTIONS
from bcapscope.simulator.argument_values import bstr, i4, r4, r8
from bcapscope.simulator.machine import InitialState
from bcapscope.simulator.profile import PROFILES
from bcapscope.simulator.simulator import Simulator
from tests.simulator.simulation import MS, Operator, Simulation
from tests.strategies import variants

E_HANDLE = 0x80070006
E_INVALIDARG = 0x80070057
E_NOTIMPL = 0x80004001
E_TOO_MUCH_DATA = 0x80000909


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
def test_ids_outside(simulation: Simulation, function_id: int) -> None:
    reply = simulation.simulator.on_datagram("a", encode_frame(1, 0, function_id), 0)
    assert reply[0].data == encode_frame(1, 0, E_INVALIDARG)


@pytest.mark.parametrize("function_id", [each for each in FUNCTIONS if each not in (1, 2, 4)])
def test_every_function_answers_one_argument_or_none(function_id: int) -> None:
    operator = Operator(Simulation("cserver"))
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


def test_s_executing_comes_each_wdt_while_a_call_runs() -> None:
    simulation = Simulation("cserver", InitialState(motor=True))
    operator = Operator(simulation, options=",WDT=80")
    operator.robot("TakeArm")
    operator.robot("ExtSpeed", r8(10))
    reply = operator.move("J(20,0,90,0,90,0)")
    assert reply.hresult == 0
    assert reply.notices == int(reply.ms / 80) > 5


def test_a_stuck_call_is_never_answered_and_makes_the_client_busy() -> None:
    simulation = Simulation("cserver", InitialState(motor=True))
    operator = Operator(simulation, options=",WDT=80,InvokeTimeout=200")
    operator.robot("TakeArm")
    operator.robot("ExtSpeed", r8(1))
    stuck = operator.send("Robot_Move", operator.arm, i4(1), bstr("J(90,0,90,0,90,0)"), bstr(""))
    assert stuck == []
    assert len(simulation.wait(1000)) == 2
    assert operator.robot("CurJnt").hresult == 0x809100AA
    assert simulation.wait(120_000) == []
    assert operator.robot("CurJnt").hresult == 0


def test_calls_of_one_client_wait_for_each_other() -> None:
    simulation = Simulation("rc8", InitialState(motor=True))
    operator = Operator(simulation, tcp=True)
    operator.robot("TakeArm")
    operator.send("Robot_Move", operator.arm, i4(1), bstr("@E J(10,0,90,0,90,0)"), bstr(""))
    assert operator.send("Robot_Execute", operator.arm, bstr("CurJnt"), EMPTY) == []
    codes = [Frame(output.data).serial for output in simulation.wait(2000)]
    assert codes == [operator.serial - 1, operator.serial]


def test_a_retry_is_answered_and_not_run_again() -> None:
    simulation = Simulation("rc7")
    operator = Operator(simulation)
    (objects,) = simulation.machine.open_objects.values()
    count = len(objects)
    content = (9, [operator.controller, bstr("I2"), bstr("")])
    first = simulation.simulator.on_datagram("client", encode_frame(100, 0, *content), simulation.now)[0].data
    again = simulation.simulator.on_datagram("client", encode_frame(101, 100, *content), simulation.now)[
        0
    ].data
    assert Frame(first).arguments == Frame(again).arguments
    assert (Frame(again).serial, Frame(again).reserved) == (101, 100)
    assert len(objects) == count + 1


def test_what_a_datagram_cannot_carry_is_refused() -> None:
    """The names of all variables are a few kB."""
    for tcp, result in ((False, E_TOO_MUCH_DATA), (True, 0)):
        operator = Operator(Simulation("rc8"), tcp=tcp)
        assert operator.call("Controller_GetVariableNames", operator.controller, bstr("")).hresult == result
        assert operator.call("Controller_GetName", operator.controller).hresult == 0


def test_reserved_is_echoed_by_rc7_only() -> None:
    for name, reserved in (("rc7", 7), ("rc8", 0)):
        outputs = Simulation(name).simulator.on_datagram("a", encode_frame(7, 7, 1, [bstr("")]), 0)
        assert Frame(outputs[0].data).reserved == reserved


def test_defects_of_the_c_server_are_its_own() -> None:
    for name, result in (("cserver", 0), ("rc8", E_INVALIDARG)):
        outputs = Simulation(name).simulator.on_datagram("a", encode_frame(0, 0, 200), 0)
        assert Frame(outputs[0].data).code == result


@settings(max_examples=60, deadline=None)
@given(st.lists(st.tuples(st.integers(0, 140), st.lists(variants(), max_size=4)), max_size=12))
def test_any_request_gets_one_answer_at_most(requests: list[tuple[int, list[Variant]]]) -> None:
    simulation = Simulation("rc8", InitialState(motor=True))
    operator = Operator(simulation, tcp=True)
    operator.robot("TakeArm")
    for function_id, arguments in requests:
        filled = [operator.controller if function_id < 26 else operator.arm, *arguments]
        operator.serial += 1
        raw = encode_frame(operator.serial, 0, function_id, filled)
        outputs = simulation.simulator.on_segment("client", raw, simulation.now) + simulation.wait(60_000)
        assert len([each for each in outputs if each.data]) <= 1
        if any(not each.data for each in outputs):
            return


@settings(max_examples=100, deadline=None)
@given(st.lists(st.binary(max_size=80), max_size=10))
def test_any_bytes_are_taken(chunks: list[bytes]) -> None:
    simulator = Simulator(PROFILES["rc7"])
    simulator.on_connect("a", 0)
    for number, chunk in enumerate(chunks):
        simulator.on_segment("a", chunk, number * MS)
        simulator.on_datagram("b", chunk, number * MS)
        simulator.on_datagram("b", b"\x01" + (len(chunk) + 5).to_bytes(4, "little") + chunk, number * MS)
