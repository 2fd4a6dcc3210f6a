"""The bounds of the values in a response, which any program may have sent."""

from __future__ import annotations

import json

import pytest

from bcapscope.messages import Message
from bcapscope.messages.message_codec import message_to_data
from bcapscope.proxy.control_messages import (
    ErrorResponse,
    HeldResponse,
    HeldStatus,
    ProxyStats,
    RelayDelays,
    decode_response,
)
from bcapscope.traffic.call_kind import CallKind
from bcapscope.traffic.observation import Direction, Endpoint, Transport

HELD = {
    "number": 1,
    "client": "10.0.0.2:50001",
    "server": "10.0.0.1:5007",
    "transport": "udp",
    "direction": "request",
    "function_id": 64,
    "function": "Robot_Execute",
    "command": "slvMove",
    "waited_s": 1.5,
    "left_s": 3.5,
    "hex": "01 02",
}


def held(field: str, value: object) -> bytes:
    """Return a response with a value in one of its fields."""
    return json.dumps({"ok": True, "held": [HELD | {field: value}]}).encode()


def one_held(**fields: object) -> HeldStatus:
    data = json.dumps({"ok": True, "held": [HELD | fields]}).encode()
    return decode_response(data, HeldResponse).held[0]


def proxy_stats(**fields: object) -> ProxyStats:
    stats = {"ok": True, "injected": {}, "refused": 0, "guard": False, "intercept": None, "held": 0}
    stats |= {"held_so_far": 0, "addon_errors": 0, "scripts": None}
    return decode_response(json.dumps(stats | fields).encode(), ProxyStats)


def test_the_ports_on_which_the_proxy_listens() -> None:
    listening = ["127.0.0.1:5008 > 192.168.0.1:5007", "[::1]:5009 > [fe80::1]:5007"]
    assert proxy_stats(listening=listening).ports == (5008, 5009)


def test_figures_that_a_response_lacks_are_zero() -> None:
    stats = proxy_stats()
    counts = [getattr(stats, name) for name in ProxyStats.__struct_fields__]
    assert {each for each in counts if type(each) is int} == {0}
    assert (stats.delays_ns, stats.recording, stats.listening) == (RelayDelays(), None, ())
    assert {getattr(RelayDelays(), name) for name in RelayDelays.__struct_fields__} == {0}


@pytest.mark.parametrize(("scripts", "are_off"), [(None, False), ("on", False), ("off", True)])
def test_scripts_that_do_not_run_are_off(scripts: str | None, are_off: bool) -> None:
    assert proxy_stats(scripts=scripts).are_scripts_off is are_off


def test_what_is_held_is_read_from_its_status() -> None:
    status = one_held(retries=2, more=7)
    assert (status.data, status.retries, status.more) == (b"\x01\x02", 2, 2)
    assert status.call_kind == CallKind(64, "slvMove")
    assert one_held(function_id=None).call_kind is None
    conversation = status.flow.conversation
    assert (conversation.client, conversation.server) == (
        Endpoint("10.0.0.2", 50001),
        Endpoint("10.0.0.1", 5007),
    )
    assert (conversation.transport, status.flow.direction) == (Transport.UDP, Direction.REQUEST)
    assert (one_held().retries, one_held().given_up) == (0, "")


@pytest.mark.parametrize(
    "message",
    [
        None,
        {},
        {"id": 5},
        {"id": None},
        {"id": "there is no such message"},
        {"id": "control.no-message", "places": 5},
        {"id": "control.no-message", "places": {"number": {"type": "?"}}},
        {"id": "control.no-message", "english": 5},
    ],
)
def test_the_reason_of_a_refusal_is_its_text_unless_its_message_is_known(message: object) -> None:
    line = json.dumps({"ok": False, "error": "why", "message": message}).encode()
    assert str(decode_response(line, ErrorResponse).reason) == "why"


def test_the_reason_of_a_refusal_is_its_message() -> None:
    reason = Message("control.no-message", number=8)
    line = json.dumps({"ok": False, "error": "why", "message": message_to_data(reason)}).encode()
    assert decode_response(line, ErrorResponse).reason == reason


@pytest.mark.parametrize(
    ("field", "value"),
    [
        ("function_id", 0),
        ("function_id", 0xFFFFFFFF),
        ("function_id", None),
        ("number", 0),
        ("number", 2**63 - 1),
        ("waited_s", -1e9),
        ("left_s", 1e9),
        ("client", "[fe80::1]:65535"),
        ("hex", ""),
    ],
)
def test_a_value_at_its_bound_is_read(field: str, value: object) -> None:
    (found,) = decode_response(held(field, value), HeldResponse).held
    assert getattr(found, field) == value


@pytest.mark.parametrize(
    ("field", "value"),
    [
        ("function_id", -1),
        ("function_id", 1 << 32),
        ("number", -1),
        ("number", 2**63),
        ("waited_s", -1.1e9),
        ("waited_s", 1_000_000_000.5),
        ("left_s", -1_000_000_000.5),
        ("left_s", 1.1e9),
        ("client", "10.0.0.2"),
        ("client", "10.0.0.2:123456"),
        ("hex", "0"),
        ("hex", "01\n"),
    ],
)
def test_a_value_beyond_its_bound_is_refused(field: str, value: object) -> None:
    with pytest.raises(ValueError, match=field):
        decode_response(held(field, value), HeldResponse)
