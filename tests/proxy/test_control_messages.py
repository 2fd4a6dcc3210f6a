"""The bounds of the values in a response, which any program may have sent."""

from __future__ import annotations

import json

import pytest

from bcapscope.proxy.control_messages import HeldResponse, ProxyStats, decode_response

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


def test_the_ports_on_which_the_proxy_listens() -> None:
    listening = ["127.0.0.1:5008 > 192.168.0.1:5007", "[::1]:5009 > [fe80::1]:5007"]
    stats = {"ok": True, "injected": {}, "refused": 0, "guard": False, "intercept": None, "held": 0}
    stats |= {"held_so_far": 0, "addon_errors": 0, "scripts": None, "listening": listening}
    assert decode_response(json.dumps(stats).encode(), ProxyStats).ports == (5008, 5009)


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
