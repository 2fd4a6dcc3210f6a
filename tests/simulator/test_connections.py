"""Service_Start, Controller_Connect, and the places that clients take."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from bcapscope.protocol.codec.frame import Frame, encode_frame, parse_datagram
from bcapscope.simulator.argument_values import bstr, i4
from bcapscope.simulator.profile import PROFILES
from bcapscope.simulator.simulator import EVICTABLE_AFTER_NS, MAX_CLIENTS, STOP_CLIENTS, Simulator
from tests.simulator.simulation import Operator, SimulatedClient, Simulation

START = encode_frame(1, 0, 1, [bstr("")])
E_INVALIDARG = 0x80070057


def _framed(inner: bytes) -> bytes:
    return b"\x01" + (len(inner) + 6).to_bytes(4, "little") + inner + b"\x04"


def test_everything_before_service_start_is_refused(simulation: Simulation) -> None:
    person = SimulatedClient(simulation)
    assert person.call("Controller_Connect", *map(bstr, "abcd")).hresult == 0x80000902


@pytest.mark.parametrize(("option", "result"), [(",WDT=79", E_INVALIDARG), (",WDT=80", 0), ("WDT=400", 0)])
def test_wdt_has_a_least_value(simulation: Simulation, option: str, result: int) -> None:
    assert SimulatedClient(simulation).call("Service_Start", bstr(option)).hresult == result


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
    person = SimulatedClient(Simulation(profile))
    person.call("Service_Start", bstr(""))
    assert person.call("Controller_Connect", *map(bstr, ("", provider, "", ""))).hresult == result


def test_a_controller_connected_twice_under_one_name() -> None:
    person = SimulatedClient(Simulation("rc8"))
    person.call("Service_Start", bstr(""))
    texts = ("a", "CaoProv.DENSO.VRC", "localhost")
    first = person.call("Controller_Connect", *map(bstr, (*texts, "")))
    assert person.call("Controller_Connect", *map(bstr, (*texts, ""))).hresult == 0x80000205
    again = person.call("Controller_Connect", *map(bstr, (*texts, "@IfNotMember")))
    assert again.value == first.value


def test_a_name_is_in_use_as_long_as_any_client_has_it() -> None:
    simulation = Simulation("rc8")
    first, second = SimulatedClient(simulation, "first"), SimulatedClient(simulation, "second")
    names = [bstr(text) for text in ("Cell", "CaoProv.DENSO.VRC", "localhost", "")]
    first.call("Service_Start", bstr(""))
    second.call("Service_Start", bstr(""))
    assert first.call("Controller_Connect", *names).hresult == 0
    assert second.call("Controller_Connect", bstr("CELL"), *names[1:]).hresult == 0x80000205
    assert second.call("Controller_Connect", *names[:3], bstr("@IfNotMember")).hresult == 0
    assert second.call("Service_Stop").hresult == 0
    simulation.simulator.on_disconnect("first", simulation.now)
    second.call("Service_Start", bstr(""))
    assert second.call("Controller_Connect", *names).hresult == 0


@pytest.mark.parametrize("data", [b"", b"\x01", b"\x01\xff\xff\xff\xff" + bytes(20), b"x" * 600])
def test_a_bad_datagram_is_dropped_and_counted(simulation: Simulation, data: bytes) -> None:
    assert simulation.simulator.on_datagram("a", data, 0) == []
    assert (simulation.simulator.dropped, simulation.simulator.client_count) == (1, 0)


def test_a_bad_frame_ends_a_connection_without_reply(simulation: Simulation) -> None:
    assert simulation.simulator.on_connect("a", 0)
    outputs = simulation.simulator.on_segment(
        "a", encode_frame(1, 0, 1, [bstr("")])[:-1] + b"\x05" + b"\x01" * 40, 0
    )
    assert outputs == [("a", b"")]
    assert simulation.simulator.client_count == 0


def test_twenty_clients_of_each_kind() -> None:
    simulator = Simulation().simulator
    request = encode_frame(1, 0, 1, [bstr("")])
    for number in range(MAX_CLIENTS):
        assert simulator.on_connect(("tcp", number), 0)
        assert simulator.on_datagram(("udp", number), request, number)
    assert not simulator.on_connect("one more", 0)
    assert simulator.on_datagram("one more", request, EVICTABLE_AFTER_NS - 1) == []
    assert simulator.on_datagram("one more", request, EVICTABLE_AFTER_NS)
    assert simulator.on_datagram("another", request, EVICTABLE_AFTER_NS) == []


def test_stops_find_a_place_when_all_are_taken_and_others_keep_theirs() -> None:
    simulator = Simulation().simulator
    request, halt = encode_frame(1, 0, 1, [bstr("")]), encode_frame(1, 0, 70, [i4(1), bstr("")])
    for number in range(MAX_CLIENTS):
        assert simulator.on_connect(("tcp", number), 0)
        assert simulator.on_datagram(("udp", number), request, 0)
    for number in range(3 * STOP_CLIENTS):
        assert simulator.on_datagram(("stop", number), halt, 1)
        assert simulator.on_connect(("stop, TCP", number), 1, is_stop=True) is (number < STOP_CLIENTS)
        assert simulator.client_count <= 2 * (MAX_CLIENTS + STOP_CLIENTS)
    assert simulator.on_datagram("one more", request, 1) == []
    for number in range(MAX_CLIENTS):
        assert simulator.on_datagram(("udp", number), halt, 1)


def test_reset_lets_go_of_all() -> None:
    simulation = Simulation()
    first = Operator(simulation, "a", tcp=True)
    first.robot("TakeArm")
    assert simulation.simulator.reset(simulation.now) == [("a", b"")]
    assert Operator(simulation, "b").robot("TakeArm").hresult == 0


@given(
    st.binary(max_size=40)
    | st.binary(min_size=8, max_size=30).map(_framed)
    | st.binary(max_size=4).map(lambda more: START + more)
    | st.integers(0, len(START)).map(lambda stop: START[:stop])
)
def test_a_datagram_is_looked_at_or_dropped_as_its_frames_say(data: bytes) -> None:
    simulator = Simulator(PROFILES["rc8"])
    simulator.on_datagram("a", data, 0)
    items = parse_datagram(data)
    sound = len(items) == 1 and isinstance(items[0], Frame) and not items[0].problems
    assert simulator.dropped == (not sound)
