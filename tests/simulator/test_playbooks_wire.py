"""Each playbook over real sockets, and through a proxy: the replies and their times are the same."""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

import pytest

from bcapscope.simulator.simulator_server import SimulatorServer
from tests.cli.proxying import proxy
from tests.simulator.playbook import FOLDER, playbooks, read
from tests.simulator.wire import Wire, WirePerformance


class Reach(NamedTuple):
    """A server, what answers in it, and the port that clients connect to."""

    server: SimulatorServer
    wire: Wire
    port: int


@pytest.fixture(scope="module")
def direct() -> Iterator[Reach]:
    wire = Wire()
    server = SimulatorServer(wire, "127.0.0.1", 0)
    yield Reach(server, wire, server.address[1])
    server.close()


@pytest.fixture(scope="module")
def proxied(direct: Reach) -> Iterator[Reach]:
    with proxy(direct.port) as before:
        yield direct._replace(port=before.port)


def play(reach: Reach, name: str, profile: str) -> None:
    """Play a playbook to its end."""
    book = read(FOLDER / f"{name}.play", profile)
    performance = WirePerformance(book, profile, *reach)
    try:
        for step in book.steps:
            performance.play(step)
    finally:
        performance.close()


@pytest.mark.parametrize(("name", "profile"), tuple(playbooks()))
def test_a_playbook_is_played_over_real_sockets(direct: Reach, name: str, profile: str) -> None:
    play(direct, name, profile)


@pytest.mark.parametrize(("name", "profile"), tuple(playbooks()))
def test_a_playbook_is_played_through_a_proxy(proxied: Reach, name: str, profile: str) -> None:
    play(proxied, name, profile)
