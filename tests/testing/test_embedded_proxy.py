"""The proxy as a context manager: it forwards, disturbs, records both sides, and leaves nothing behind."""

from __future__ import annotations

import asyncio
import socket
from pathlib import Path

import pytest

import bcapscope
from bcapscope.client import connect, over_udp
from bcapscope.errors import BcapError, InputError
from tests.testing.client_session import SESSION, run_session


@pytest.mark.parametrize("tcp", [False, True])
def test_it_forwards_and_lists_the_calls(tcp: bool, tmp_path: Path) -> None:
    path = tmp_path / "both.pcapng"
    with bcapscope.Simulator() as simulator:
        with bcapscope.Proxy(to=f"{simulator.host}:{simulator.port}", record=path) as proxy:
            run_session(proxy.host, proxy.port, tcp=tcp)
            assert len(proxy.calls) == len(SESSION)
            assert proxy.findings == []
        assert len(proxy.calls) == len(simulator.calls) == len(SESSION)
    assert path.exists()
    with socket.socket() as listener:
        listener.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        listener.bind((proxy.host, proxy.port))


def test_its_faults_disturb_the_traffic() -> None:
    with (
        bcapscope.Simulator() as simulator,
        bcapscope.Proxy(
            to=f"{simulator.host}:{simulator.port}", faults=["drop reply try 1"], seed=1
        ) as proxy,
    ):
        run_session(proxy.host, proxy.port)
        assert [len(call.attempts) for call in proxy.calls] == [2] * len(SESSION)
        assert proxy.recording.exists()
    assert not proxy.recording.exists()


def test_async_with() -> None:
    async def use() -> int:
        async with bcapscope.Simulator() as simulator:
            to = f"{simulator.host}:{simulator.port}"
            async with bcapscope.Proxy(to=to) as proxy, connect(over_udp(proxy.host, proxy.port)):
                pass
        return len(proxy.calls)

    assert asyncio.run(use()) == 2


def test_errors_are_ours() -> None:
    with pytest.raises(InputError, match="los"):
        bcapscope.Proxy(to="127.0.0.1:5007", faults=["los=5%"])
    with pytest.raises(BcapError, match="nowhere"), bcapscope.Proxy(to="nowhere"):
        pass
