"""The simulator as a context manager: it answers, shows what it received, and leaves nothing behind."""

from __future__ import annotations

import asyncio
import socket
import subprocess
import sys
import threading
from pathlib import Path

import pytest

import bcapscope
from bcapscope.client import connect, over_udp
from bcapscope.errors import BcapError, FileWriteError, InputError
from bcapscope.protocol.tables.function_table import FUNCTIONS
from bcapscope.traffic.call import Call
from tests.testing.client_session import SESSION, run_session


def _names(calls: list[Call]) -> list[str]:
    return [FUNCTIONS[call.kind.function_id].name for call in calls]


def _threads() -> set[str]:
    return {thread.name for thread in threading.enumerate()} - {"MainThread"}


def _is_free(port: int) -> bool:
    with socket.socket() as tcp, socket.socket(type=socket.SOCK_DGRAM) as udp:
        tcp.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        tcp.bind(("127.0.0.1", port))
        udp.bind(("127.0.0.1", port))
    return True


@pytest.mark.parametrize("tcp", [False, True])
def test_it_answers_and_lists_the_calls(tcp: bool) -> None:
    with bcapscope.Simulator() as simulator:
        assert simulator.host == "127.0.0.1"
        run_session(simulator.host, simulator.port, tcp=tcp)
        assert _names(simulator.calls) == SESSION
        assert simulator.findings == []
        recording = simulator.recording
        assert recording.exists()
    assert _names(simulator.calls) == SESSION
    assert not recording.parent.exists()


def test_a_call_is_listed_as_soon_as_its_reply_has_arrived() -> None:
    async def talk(host: str, port: int) -> None:
        async with connect(over_udp(host, port)):
            assert _names(simulator.calls) == SESSION[:1]

    with bcapscope.Simulator() as simulator:
        assert simulator.calls == []
        asyncio.run(talk(simulator.host, simulator.port))


def test_a_recording_stays_and_is_never_overwritten(tmp_path: Path) -> None:
    path = tmp_path / "new.pcapng"
    with bcapscope.Simulator(record=path) as simulator:
        run_session(simulator.host, simulator.port)
    argv = [sys.executable, "-m", "bcapscope", "calls", "--json", str(path)]
    done = subprocess.run(argv, capture_output=True, text=True, check=True)
    assert len(done.stdout.splitlines()) == len(SESSION)
    before = path.read_bytes()
    with pytest.raises(FileWriteError), bcapscope.Simulator(record=str(path)):
        pass
    assert path.read_bytes() == before


def test_everything_is_released() -> None:
    before = _threads()
    simulator = bcapscope.Simulator()

    def fail_inside() -> None:
        with simulator:
            assert _threads() > before
            raise ZeroDivisionError

    with pytest.raises(ZeroDivisionError):
        fail_inside()
    assert _threads() == before
    assert _is_free(simulator.port)


def test_faults_and_seed_repeat_the_same_disturbance() -> None:
    def attempts() -> list[int]:
        with bcapscope.Simulator(faults=["loss=40%"], seed=3) as simulator:
            run_session(simulator.host, simulator.port)
        return [len(call.attempts) for call in simulator.calls]

    first = attempts()
    assert sum(first) > len(SESSION)
    assert attempts() == first


def test_a_scenario_is_played_with_its_profile() -> None:
    with bcapscope.Simulator(scenario="slow-line", faults=["delay=1ms"]) as simulator:
        run_session(simulator.host, simulator.port)
    assert _names(simulator.calls) == SESSION


def test_async_with() -> None:
    async def use() -> list[Call]:
        async with (
            bcapscope.Simulator(profile="rc9") as simulator,
            connect(over_udp(simulator.host, simulator.port)) as service,
        ):
            await service.connect("", "CaoProv.DENSO.VRC9", "localhost")
        return simulator.calls

    assert _names(asyncio.run(use())) == SESSION


def test_a_cancelled_task_releases_everything() -> None:
    before = _threads()

    async def stay(entered: asyncio.Event) -> None:
        async with bcapscope.Simulator():
            entered.set()
            await asyncio.Event().wait()

    async def cancel(at_once: bool) -> None:
        entered = asyncio.Event()
        task = asyncio.create_task(stay(entered))
        await (asyncio.sleep(0) if at_once else entered.wait())
        task.cancel()
        with pytest.raises(asyncio.CancelledError):
            await task

    for at_once in (True, False):
        asyncio.run(cancel(at_once))
        assert _threads() == before


@pytest.mark.parametrize(
    ("options", "reason"),
    [
        ({"profile": "rc6"}, "there is no profile 'rc6'"),
        ({"scenario": "slow-lime"}, "there is no scenario 'slow-lime'"),
        ({"scenario": "slow-line", "profile": "rc7"}, "the scenario needs profile rc8"),
        ({"faults": ["los=5%"]}, "los"),
    ],
)
def test_a_wrong_option_is_an_error_of_ours(options: dict[str, str], reason: str) -> None:
    with pytest.raises(InputError, match=reason):
        bcapscope.Simulator(**options)  # type: ignore[arg-type]


def test_calls_before_the_block_are_an_error() -> None:
    with pytest.raises(BcapError, match="nothing has run yet"):
        _ = bcapscope.Simulator().calls


def test_an_error_of_the_controller_is_raised(monkeypatch: pytest.MonkeyPatch) -> None:
    def fail(*args: object) -> None:
        raise OSError("broken")

    before = _threads()
    monkeypatch.setattr("bcapscope.simulator.simulator.Simulator.on_datagram", fail)

    def send_datagram() -> None:
        with bcapscope.Simulator() as simulator, socket.socket(type=socket.SOCK_DGRAM) as udp:
            udp.sendto(b"x", (simulator.host, simulator.port))

    with pytest.raises(OSError, match="broken"):
        send_datagram()
    assert _threads() == before


def test_the_findings_are_those_of_diagnose() -> None:
    with bcapscope.Simulator(faults=["loss=100% reply"]) as simulator:
        with pytest.raises(TimeoutError):
            run_session(simulator.host, simulator.port)
        assert simulator.findings
        assert not any(call.reply for call in simulator.calls)
