"""Calls of one conversation inside the calls of another."""

from __future__ import annotations

import pytest

from bcapscope.traffic.joining.twin_recognition import (
    CLIENT_LEG,
    CONTROLLER_LEG,
    FEWEST_CALLS,
    NestedCalls,
    fewest_calls,
    may_be_twins,
    nested_calls,
)
from bcapscope.traffic.observation import SERVER_PORT, Conversation, Endpoint, Observation, Transport
from tests.traffic.playbook import MOVE, MS, Script


def call(asked: float, replied: float) -> list[Observation]:
    client = Script().client()
    return [client.ask(asked, 1, 0, MOVE), client.reply(replied, 1)]


@pytest.mark.parametrize(
    ("inner", "contradicted"),
    [((1, 8), False), ((0, 9), False), ((-1 / MS, 8), True), ((1, 9 + 1 / MS), True)],
)
def test_a_call_is_nested_if_it_begins_no_earlier_and_ends_no_later(
    inner: tuple[float, float], contradicted: bool
) -> None:
    nested = nested_calls(call(0, 9), call(*inner))
    assert nested == NestedCalls(1, round(inner[0] * MS), contradicted)
    assert nested.proves_twins(1) is not contradicted
    assert not nested.proves_twins(2)


PROXY_HOST, CLIENT_HOST = "10.0.0.3", "10.0.0.2"


def legs(proxy: str, *interfaces: str) -> tuple[Conversation, Conversation]:
    """Return a client's conversation with `proxy`, and one of PROXY_HOST with a controller."""
    found = (
        Conversation(Endpoint(CLIENT_HOST, 50001), Endpoint(proxy, 5008), Transport.UDP, SERVER_PORT),
        Conversation(Endpoint(PROXY_HOST, 60001), Endpoint("10.0.0.1", 5007), Transport.UDP, SERVER_PORT),
    )
    for conversation, interface in zip(found, interfaces, strict=False):
        conversation.interface = interface
    return found


@pytest.mark.parametrize(
    ("proxy", "interfaces", "fewest"),
    [
        (PROXY_HOST, (), 1),
        ("10.0.0.4", (), FEWEST_CALLS),
        (CLIENT_HOST, (), FEWEST_CALLS),
        ("10.0.0.4", (f"{CLIENT_LEG}x", f"{CONTROLLER_LEG}y"), 1),
        (PROXY_HOST, (f"{CLIENT_LEG}x", f"{CLIENT_LEG}y"), None),
        (PROXY_HOST, (f"{CONTROLLER_LEG}x", f"{CONTROLLER_LEG}y"), None),
        (PROXY_HOST, (f"{CONTROLLER_LEG}x", f"{CLIENT_LEG}y"), None),
    ],
)
def test_how_many_nested_calls_prove_a_proxy(
    proxy: str, interfaces: tuple[str, ...], fewest: int | None
) -> None:
    assert fewest_calls(*legs(proxy, *interfaces)) == fewest


def test_one_controller_or_two_transports_make_no_twins() -> None:
    outer, inner = legs(PROXY_HOST)
    assert may_be_twins(outer, inner)
    assert not may_be_twins(outer, outer)
    stream = Conversation(inner.client, inner.server, Transport.TCP, SERVER_PORT)
    assert not may_be_twins(outer, stream)
