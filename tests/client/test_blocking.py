"""The face without async."""

from __future__ import annotations

import asyncio

import pytest

from bcapscope.client import Blocking, connect
from tests.client.peer import Peer
from tests.memory_link import memory_link_pair, over_link
from tests.virtual_time import VirtualTimeLoop


def test_steps_are_waited_for_and_blocks_left() -> None:
    near, far = memory_link_pair()
    peer = Peer(far)
    with Blocking(asyncio.Runner(loop_factory=VirtualTimeLoop)) as wait:
        service = wait.enter(connect(over_link(near), ",WDT=400"))
        controller = wait(service.connect())
        assert wait(controller.get_name()) == "text"
    assert peer.executed == [
        ("Service_Start", ",WDT=400"),
        ("Controller_Connect", "", "", "", ""),
        ("Controller_GetName", 101),
        ("Controller_Disconnect", 101),
        ("Service_Stop",),
    ]


def test_blocks_are_left_when_something_fails() -> None:
    near, far = memory_link_pair()
    peer = Peer(far)

    def fail() -> None:
        with Blocking(asyncio.Runner(loop_factory=VirtualTimeLoop)) as wait:
            wait.enter(connect(over_link(near)))
            raise ZeroDivisionError

    with pytest.raises(ZeroDivisionError):
        fail()
    assert peer.functions == ["Service_Start", "Service_Stop"]
