"""What happens to a controller and its messages when a scenario is played."""

from __future__ import annotations

from random import Random

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from bcapscope.protocol.codec.frame import Frame, encode_frame
from bcapscope.protocol.codec.variant import VT, Variant
from bcapscope.simulator.argument_values import bstr, i4
from bcapscope.simulator.scenario_files import bundled_scenarios
from bcapscope.simulator.scenario_runner import MAX_LINES
from bcapscope.simulator.simulator import MAX_CLIENTS, ResetMarker
from tests.simulator.simulation import MS, Operator, SimulatedClient, Simulation, joints

HOME = (0.0, 0.0, 90.0, 0.0, 90.0, 0.0)
OUTSIDE = 0x83500121


def faults(*lines: str, begin: str = "title: x") -> str:
    """Write a scenario with faults."""
    return "\n".join([begin, "faults:", *(f"- {{{line}}}" for line in lines)])


def in_slave_mode(*lines: str, mode: int = 0x202) -> Operator:
    """An operator who has just entered slave mode, where things are to happen."""
    operator = Operator(
        Simulation.of("\n".join(["title: x", "in_slave_mode:", *(f"- {{{line}}}" for line in lines)]))
    )
    operator.ready()
    operator.simulation.wait(3000)
    assert operator.slave(mode).hresult == 0
    return operator


def codes(operator: Operator, count: int = 2) -> list[int]:
    """Send set points at home; return the results."""
    return [operator.point(*HOME).hresult for _ in range(count)]


def test_nothing_happens_in_a_scenario_without_faults() -> None:
    operator = Operator(Simulation.of("title: x"))
    operator.ready()
    assert operator.slave(0x202).hresult == 0
    assert codes(operator, 20) == [0] * 20
    assert operator.simulation.news == []


def test_variables_can_be_read() -> None:
    operator = Operator(Simulation.of("title: x\nvariables: {I1: 7, IO130: true}"))
    assert (operator.read("I1").value, operator.read("IO130").value) == (7, True)


# events at a moment


def test_an_event_happens_at_its_time() -> None:
    simulation = Simulation.of(faults("action: emergency-stop, after: 2s"))
    operator = Operator(simulation)
    assert simulation.answerer.due(simulation.now) == 2_000_000_000
    operator.ready()
    simulation.wait(2000 - simulation.now / MS - 1)
    assert not simulation.machine.emergency
    simulation.wait(1)
    assert simulation.machine.emergency
    assert simulation.news == ["emergency-stop"]
    assert operator.machine_error() == 0x8150101A


def test_an_event_counts_from_the_entering_of_slave_mode() -> None:
    operator = in_slave_mode("action: emergency-stop, after: 100ms, name: stopped")
    assert codes(operator) == [0, 0]
    operator.simulation.wait(99)
    assert codes(operator, 1) == [0]
    operator.simulation.wait(1)
    assert codes(operator) == [0x8150101A, OUTSIDE]
    assert operator.simulation.news == ["stopped"]


def test_slave_mode_is_set_up_once() -> None:
    operator = in_slave_mode("action: drop, direction: request, times: 1, after: 50ms")
    operator.slave(0)
    operator.simulation.wait(1000)
    assert operator.send("Robot_Execute", operator.arm, bstr("CurJnt"), i4(0)) == []
    assert operator.slave(0x202).hresult == 0
    operator.simulation.wait(1000)
    assert codes(operator) == [0, 0]


@pytest.mark.parametrize(
    ("event", "first"),
    [
        ("action: motor-off", 0x81501003),
        ("action: mode, to: manual", 0x81501017),
        ("action: mode, to: teach-check", 0x81501017),
        ("action: error, code: 0x84204053", 0x84204053),
        ("action: take-arm", 0x83501024),
        ("action: stop-task, task: Pro1", 0),
        ("action: 'move', joints: [10, 0, 90, 0, 90, 0]", 0),
    ],
)
def test_what_events_do_in_slave_mode(event: str, first: int) -> None:
    operator = in_slave_mode(f"{event}, after: 10ms")
    operator.simulation.wait(10)
    assert codes(operator, 1) == [first]


def test_slave_mode_of_rc7_ends_with_robslave() -> None:
    simulation = Simulation.of(
        "title: x\nprofile: rc7\nin_slave_mode: [{action: stop-task, task: RobSlave, after: 10ms}]"
    )
    operator = Operator(simulation)
    operator.ready()
    assert operator.slave(0x002).hresult == 0
    simulation.wait(10)
    assert codes(operator) == [OUTSIDE, OUTSIDE]


def test_the_stop_can_be_let_go() -> None:
    simulation = Simulation.of(faults("action: emergency-stop", "action: let-go, after: 1s"))
    operator = Operator(simulation)
    assert operator.command("ClearError").hresult == 0x8150101A
    simulation.wait(1000)
    assert operator.command("ClearError").hresult == 0
    assert operator.machine_error() == 0


def test_the_arm_is_moved_by_others() -> None:
    simulation = Simulation.of(faults("action: move, joints: [20, 0, 90, 0, 90, 0], speed: 10, after: 100ms"))
    operator = Operator(simulation)
    operator.ready()
    assert operator.slave(0x202).hresult == 0x8150100D
    simulation.wait(2000)
    assert operator.robot("CurJnt").value == pytest.approx(joints(20, *HOME[1:]))


def test_reset_forgets_all_clients() -> None:
    simulation = Simulation.of(faults("action: reset, after: 1s"))
    operator, other = Operator(simulation, tcp=True), Operator(simulation, "other")
    (output,) = simulation.wait(1000)
    assert output == ("client", b"")
    assert operator.send("Service_Start", bstr("")) == []
    assert other.robot("CurJnt").hresult == 0x80000902


# events on a match


def test_an_event_happens_on_a_match() -> None:
    simulation = Simulation.of(
        faults("action: error, code: E_FAIL, if: 'command == CurJnt and arg[2] == 1', times: 2")
    )
    operator = Operator(simulation)
    for number, error in ((0, 0), (1, 0x80004005)):
        operator.robot("CurJnt", i4(number))
        assert operator.machine_error() == error
    for _ in range(3):
        operator.command("ClearError")
        operator.robot("CurJnt", i4(1))
    assert operator.machine_error() == 0
    assert simulation.news == ["error", "error"]


def test_a_match_may_be_by_lot() -> None:
    counts = []
    for seed in (1, 1, 2):
        text = faults("action: error, code: E_FAIL, if: command == CurJnt, probability: 30%, times: 1000")
        simulation = Simulation.of(f"{text}\nseed: {seed}")
        operator = Operator(simulation)
        for _ in range(200):
            operator.robot("CurJnt")
        counts.append(len(simulation.machine.alarm_log))
    assert counts[0] == counts[1] != counts[2]
    assert all(30 < count < 90 for count in counts)


# messages


@pytest.mark.parametrize("tcp", [False, True])
def test_a_lost_request_never_reaches_the_controller(tcp: bool) -> None:
    simulation = Simulation.of(
        faults("action: drop, direction: request, if: function == Variable_PutValue, times: 1")
    )
    operator = Operator(simulation, tcp=tcp)
    variable = operator.get("Controller_GetVariable", operator.controller, "I1")
    assert operator.send("Variable_PutValue", variable, i4(5)) == []
    assert simulation.wait(1000) == []
    assert operator.read("I1").value == 0
    assert operator.call("Variable_PutValue", variable, i4(6)).hresult == 0
    assert operator.read("I1").value == 6


@pytest.mark.parametrize("tcp", [False, True])
def test_a_lost_reply_leaves_its_effect(tcp: bool) -> None:
    simulation = Simulation.of(
        faults("action: drop, direction: response, if: function == Variable_PutValue, times: 1")
    )
    operator = Operator(simulation, tcp=tcp)
    variable = operator.get("Controller_GetVariable", operator.controller, "I1")
    assert operator.send("Variable_PutValue", variable, i4(5)) == []
    assert operator.read("I1").value == 5


@pytest.mark.parametrize("tcp", [False, True])
@pytest.mark.parametrize("direction", ["request", "response"])
def test_a_delay_is_kept_to_the_nanosecond(tcp: bool, direction: str) -> None:
    simulation = Simulation.of(
        faults(f"action: delay, time: 30ms, direction: {direction}, if: command == CurJnt")
    )
    operator = Operator(simulation, tcp=tcp)
    assert operator.robot("CurJnt").ms == 30
    assert operator.robot("CurPos").ms == 0


def test_a_refusal_is_no_execution() -> None:
    simulation = Simulation.of(
        faults("action: answer, hresult: E_ACCESSDENIED, if: command == Motor, times: 1")
    )
    operator = Operator(simulation)
    assert operator.robot("Motor", i4(1)).hresult == 0x80070005
    assert not simulation.machine.motor_is_on(simulation.now)
    assert operator.robot("Motor", i4(1)).hresult == 0
    assert simulation.machine.motor_is_on(simulation.now)


def test_a_long_wait_is_told_by_notices() -> None:
    simulation = Simulation.of(faults("action: executing, time: 1s, every: 250ms, if: command == CurJnt"))
    reply = Operator(simulation).robot("CurJnt")
    assert (reply.hresult, reply.ms, reply.notices) == (0, 1000, 4)


def test_a_wrong_serial_and_garbage() -> None:
    simulation = Simulation.of(
        faults("action: serial, by: 5, if: command == CurJnt", "action: garbage, if: command == CurPos")
    )
    operator = Operator(simulation)
    (output,) = operator.send("Robot_Execute", operator.arm, bstr("CurJnt"), i4(0))
    assert Frame(output.data).serial == operator.serial + 5
    (output,) = operator.send("Robot_Execute", operator.arm, bstr("CurPos"), i4(0))
    assert Frame(output.data).problems


@pytest.mark.parametrize("how", ["fin", "reset"])
def test_a_connection_is_closed(how: str) -> None:
    simulation = Simulation.of(faults(f"action: close, how: {how}, if: command == CurJnt"))
    operator = Operator(simulation, tcp=True)
    ((peer, data),) = operator.send("Robot_Execute", operator.arm, bstr("CurJnt"), i4(0))
    assert (peer, data) == ("client", b"")
    assert isinstance(data, ResetMarker) is (how == "reset")
    assert simulation.simulator.client_count == 0
    assert operator.send("Service_Start", bstr("")) == []


def test_a_half_open_client_keeps_its_place_until_reset() -> None:
    simulation = Simulation.of(faults("action: half-open, if: function == Service_Stop"))
    for number in range(MAX_CLIENTS):
        person = SimulatedClient(simulation, f"client {number}", tcp=True)
        person.call("Service_Start", bstr(""))
        assert person.send("Service_Stop") == []
        simulation.answerer.on_disconnect(person.name, simulation.now)
    assert simulation.simulator.client_count == MAX_CLIENTS
    assert not simulation.answerer.on_connect("one more", simulation.now)
    assert simulation.stage is not None
    simulation.stage.reset(simulation.now)
    assert simulation.answerer.on_connect("one more", simulation.now)


def test_places_that_others_hold() -> None:
    simulation = Simulation.of("title: x\nstart: {udp_clients: 20, tcp_clients: 20}")
    assert not simulation.answerer.on_connect("client", simulation.now)
    assert SimulatedClient(simulation).send("Service_Start", bstr("")) == []
    simulation.wait(10_001)
    assert SimulatedClient(simulation, "later").call("Service_Start", bstr("")).hresult == 0
    assert not simulation.answerer.on_connect("client", simulation.now)


def test_frames_glued_and_split_on_a_stream_are_told_apart() -> None:
    simulation = Simulation.of(faults("action: drop, direction: request, if: serial == 2"))
    assert simulation.answerer.on_connect("client", 0)
    stream = b"".join(encode_frame(number, 0, 1, [bstr("")]) for number in (1, 2, 3))
    serials = [
        Frame(output.data).serial
        for start in range(0, len(stream), 7)
        for output in simulation.answerer.on_segment("client", stream[start : start + 7], 0)
    ]
    assert serials == [1, 3]


def test_many_addresses_do_not_fill_the_memory() -> None:
    simulation = Simulation.of("title: x")
    for number in range(2 * MAX_LINES):
        simulation.answerer.on_datagram(
            ("udp", ("10.0.0.1", number)), encode_frame(1, 0, 1, [bstr("")]), number
        )
    assert simulation.stage is not None
    assert len(simulation.stage._lines) == MAX_LINES == len(simulation.stage._peers)


@settings(max_examples=60, deadline=None)
@given(
    st.sampled_from(sorted(bundled_scenarios())),
    st.lists(st.binary(max_size=60), max_size=12),
    st.integers(0, 9),
)
def test_any_bytes_are_taken_in_any_scenario(name: str, chunks: list[bytes], seed: int) -> None:
    simulation = Simulation.of(
        f"{bundled_scenarios()[name]}\n"
        if "seed" in bundled_scenarios()[name]
        else f"{bundled_scenarios()[name]}\nseed: {seed}\n"
    )
    chance = Random(seed)
    simulation.answerer.on_connect("a", 0)
    for chunk in chunks:
        simulation.wait(chance.choice((0, 1, 500)))
        raw = b"\x01" + (len(chunk) + 5).to_bytes(4, "little") + chunk
        for data in (chunk, raw, encode_frame(1, 0, 64, [Variant(VT.BSTR, "slvMove")])):
            simulation.answerer.on_datagram("b", data, simulation.now)
            simulation.answerer.on_segment("a", data, simulation.now)
    simulation.wait(5000)
