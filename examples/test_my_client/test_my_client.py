"""Tests of the client in `my_client.py`. The second one fails, and its report explains why."""

from __future__ import annotations

from collections.abc import Iterator

import pytest
from my_client import MyClient

import bcapscope


@pytest.fixture
def client(bcap_simulator: bcapscope.Simulator) -> Iterator[MyClient]:
    client = MyClient(bcap_simulator.host, bcap_simulator.port)
    yield client
    client.close()


def test_connect(client: MyClient, bcap_simulator: bcapscope.Simulator) -> None:
    client.disconnect(client.connect("cell 1"))
    assert len(bcap_simulator.calls) == 4
    assert bcap_simulator.findings == []


@pytest.mark.bcap(faults=["drop reply try 1"])
def test_connect_although_the_first_replies_are_lost(client: MyClient) -> None:
    client.disconnect(client.connect("cell 1"))
