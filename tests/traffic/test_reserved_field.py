"""What the reserved field is used for."""

from __future__ import annotations

import pytest

from bcapscope.traffic.observation import Transport
from bcapscope.traffic.reserved_field import ReplyReserved, ReservedConvention
from tests.traffic.playbook import (
    MOVE,
    OTHER,
    Script,
    calls_of,
)

CONVENTIONS: dict[str, tuple[Transport, list[tuple[int, int, object]], list[str]]] = {
    "0 first tells nothing yet": (Transport.UDP, [(1, 0, MOVE), (2, 0, OTHER)], ["unknown"] * 2),
    "a second try tells nothing either": (Transport.UDP, [(1, 0, MOVE), (2, 1, MOVE)], ["unknown"]),
    "the first serial in the third try": (
        Transport.UDP,
        [(1, 0, MOVE), (2, 1, MOVE), (3, 1, MOVE)],
        ["seed"],
    ),
    "the serial before in the third try": (
        Transport.UDP,
        [(1, 0, MOVE), (2, 1, MOVE), (3, 2, MOVE)],
        ["chain"],
    ),
    "the own serial": (Transport.UDP, [(1, 1, MOVE), (2, 1, MOVE), (3, 1, MOVE)], ["own"]),
    "the own serial, in a first try that a retry overtook": (
        Transport.UDP,
        [(2, 1, MOVE), (1, 1, MOVE)],
        ["own"],
    ),
    "another client on the same port": (Transport.UDP, [(1, 1, MOVE), (2, 0, OTHER)], ["unknown"] * 2),
    "first tries never seen, one before named": (Transport.UDP, [(8, 7, MOVE), (9, 8, MOVE)], ["chain"]),
    "first tries never seen, the first named": (Transport.UDP, [(8, 7, MOVE), (9, 7, MOVE)], ["unknown"]),
    "TCP, 0": (Transport.TCP, [(1, 0, MOVE)], ["tcp0"]),
    "TCP, 1": (Transport.TCP, [(2, 1, MOVE)], ["tcp1"]),
    "TCP, 1 of serial 1": (Transport.TCP, [(1, 1, MOVE)], ["unknown"]),
    "TCP, 1 again": (Transport.TCP, [(1, 1, MOVE), (2, 1, OTHER)], ["tcp1"] * 2),
    "TCP, the own serial": (Transport.TCP, [(1, 1, MOVE), (2, 2, OTHER)], ["own"] * 2),
    "TCP, something else": (Transport.TCP, [(1, 9, MOVE)], ["unknown"]),
}


@pytest.mark.parametrize("name", CONVENTIONS)
def test_the_convention_is_named(name: str) -> None:
    transport, requests, expected = CONVENTIONS[name]
    script = Script()
    client = script.client(transport=transport)
    for step, (serial, reserved, question) in enumerate(requests):
        client.ask(3 * step, serial, reserved, question)  # type: ignore[arg-type]  # a table of literals
    assert [call.convention for call in calls_of(script.track())] == [
        ReservedConvention(word) for word in expected
    ]


@pytest.mark.parametrize(
    ("asked", "answered", "expected"),
    [
        (1, 0, ReplyReserved.ZERO),
        (1, 1, ReplyReserved.ECHOED),
        (1, 9, ReplyReserved.UNKNOWN),
        (0, 0, ReplyReserved.UNKNOWN),
    ],
)
def test_what_replies_carry_is_noted(asked: int, answered: int, expected: ReplyReserved) -> None:
    script = Script()
    client = script.client()
    client.ask(0, 1, asked, MOVE)
    client.reply(1, 1, answered)
    assert calls_of(script.track())[0].reply_reserved is expected


@pytest.mark.parametrize("answered", [(0, 2), (1, 0)])
def test_the_first_reply_that_shows_what_replies_carry_decides(answered: tuple[int, int]) -> None:
    script = Script()
    client = script.client()
    for serial, reserved in enumerate(answered, 1):
        client.ask(8 * serial, serial, serial, MOVE)
        client.reply(8 * serial + 1, serial, reserved)
    expected = ReplyReserved.ECHOED if answered[0] else ReplyReserved.ZERO
    assert [call.reply_reserved for call in calls_of(script.track())] == [expected] * 2
