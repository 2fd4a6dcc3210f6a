"""``bcapscope ping`` against a server on loopback."""

from __future__ import annotations

import json
import signal
import socket
import subprocess
import sys
import threading
import time

import pytest

from bcapscope.cli.common.exit_codes import ExitCode
from bcapscope.protocol.codec.variant import EMPTY, VT, Variant
from bcapscope.protocol.guard import needs_arming
from bcapscope.protocol.tables.function_table import ID
from bcapscope.protocol.tables.hresult import E_INVALIDARG, S_OK
from bcapscope.protocol.tables.simulator_marker import SIMULATOR_TEXT
from tests.cli.run import run_here
from tests.client.peer import Answer, Peer
from tests.client.server import breaking_server, udp_server

_FEW = ("-n", "5", "--interval", "1")


def test_what_is_there_and_how_fast() -> None:
    def prepare(peer: Peer) -> None:
        peer.answers["Variable_GetValue"] = S_OK, (Variant(VT.BSTR, "1.2\x1b[31m"),)

    with udp_server(prepare) as server:
        ran = run_here("ping", "127.0.0.1", "--port", str(server.port), *_FEW)
    assert ran.code == ExitCode.OK
    first, calls, spread, *verdicts = ran.lines
    said = "1.2\\x1b[31m"
    assert first == (
        f"127.0.0.1:{server.port} over UDP: a controller, version {said}, robot type {said}, "
        f"robot type number {said}"
    )
    assert calls == "5 calls, 0 lost"
    assert spread.startswith("round trip, ms: p50 ")
    assert [line.partition(" for ")[2].partition(":")[0] for line in verdicts] == [
        "set points every 8 ms",
        "set points every 1 ms",
    ]
    (peer,) = server.peers.values()
    assert not any(needs_arming(ID[str(name)], ()) for name in peer.functions)
    assert peer.functions.count("Controller_GetAttribute") == 5
    assert peer.functions[-1] == "Service_Stop"


def test_what_is_empty_is_left_out() -> None:
    def prepare(peer: Peer) -> None:
        peer.answers["Variable_GetValue"] = S_OK, (EMPTY,)

    with udp_server(prepare) as server:
        words = ("ping", "127.0.0.1", "--port", str(server.port), *_FEW)
        assert run_here(*words).lines[0] == f"127.0.0.1:{server.port} over UDP: a controller"
        assert json.loads(run_here(*words, "--json").out)["facts"] == {}


def test_json_and_the_simulator() -> None:
    def prepare(peer: Peer) -> None:
        peer.answers["Variable_GetValue"] = S_OK, (Variant(VT.BSTR, SIMULATOR_TEXT),)

    with udp_server(prepare) as server:
        ran = run_here("ping", "127.0.0.1", "--port", str(server.port), "--json", *_FEW)
    record = json.loads(ran.out)
    assert record["simulator"] is True
    assert record["calls"] == 5
    assert record["round_trip_ms"]["count"] == 5
    assert set(record["fit"]) == {"8 ms", "1 ms"}


def test_a_controller_that_refuses_the_connection_answers_all_the_same() -> None:
    def prepare(peer: Peer) -> None:
        peer.answers["Controller_Connect"] = E_INVALIDARG, ()

    with udp_server(prepare) as server:
        ran = run_here("ping", "127.0.0.1", "--port", str(server.port), *_FEW)
    assert ran.code == ExitCode.OK
    assert "connection refused: Controller_Connect was refused: E_INVALIDARG" in ran.out
    assert "5 calls, 0 lost" in ran.out


def test_losses_are_counted_and_not_repeated() -> None:
    def prepare(peer: Peer) -> None:
        peer.answers["Controller_GetAttribute"] = None

    with udp_server(prepare) as server:
        words = ("--timeout", "250", *_FEW)
        ran = run_here("ping", "127.0.0.1", "--port", str(server.port), *words)
    assert ran.code == ExitCode.UNANSWERED
    assert "5 calls, 5 lost" in ran.lines
    assert ran.lines[-1] == "not fit for set points every 1 ms: no call was answered"


def test_what_was_found_is_shown_if_the_connection_breaks() -> None:
    with breaking_server("Controller_GetAttribute", 3) as port:
        ran = run_here("ping", "127.0.0.1", "--port", str(port), "--tcp", *_FEW)
    assert ran.code == ExitCode.UNANSWERED
    assert "ended early: the " in ran.out
    assert ran.lines[1] in (
        "2 calls, 0 lost",
        "3 calls, 0 lost",
    )  # the last answer may come with the end
    assert "round trip, ms: p50 " in ran.out
    assert ran.lines[-1] == "not fit for set points every 1 ms: the connection broke"


class _SlowOnce(dict[str, Answer | None]):
    """Answers of a peer whose first answer takes its time; `asked` is when each came to be answered, ns."""

    def __init__(self) -> None:
        self.asked: list[int] = []

    def get(self, name: str, default: Answer | None = None) -> Answer | None:  # type: ignore[override]
        if name == "Controller_GetAttribute":
            if not self.asked:
                threading.Event().wait(0.3)
            self.asked.append(time.monotonic_ns())
        return default


def test_after_a_long_wait_calls_do_not_hurry() -> None:
    answers = _SlowOnce()
    with udp_server(lambda peer: setattr(peer, "answers", answers)) as server:
        ran = run_here("ping", "127.0.0.1", "--port", str(server.port), "-n", "4", "--interval", "60")
    assert "4 calls, 0 lost" in ran.lines
    first, *_, last = answers.asked
    assert last - first >= 2 * 60_000_000  # one is sent at once, and two behind it


def test_nobody_is_there() -> None:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as silent:
        silent.bind(("127.0.0.1", 0))
        port = str(silent.getsockname()[1])
        ran = run_here("ping", "127.0.0.1", "--port", port, "--timeout", "5", "--retries", "1")
    assert ran.code == ExitCode.UNANSWERED
    assert "Service_Start got no reply in time, 2 attempts" in ran.err
    assert ran.out == ""


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM, signal.SIGHUP])
def test_a_signal_releases_everything_and_what_was_found_is_shown(number: signal.Signals) -> None:
    with udp_server() as server:
        words = ["ping", "127.0.0.1", "--port", str(server.port), "-n", "99999"]
        argv = [sys.executable, "-m", "bcapscope", *words]
        with subprocess.Popen(argv, stdout=subprocess.PIPE) as program:
            # Whoever asks for the third time has had answers.
            while not any(
                peer.functions[-3:] == ["Controller_GetAttribute"] * 3 for peer in [*server.peers.values()]
            ):
                assert program.poll() is None
                threading.Event().wait(0.02)
            program.send_signal(number)
            out, _ = program.communicate()
    (peer,) = server.peers.values()
    assert program.returncode == ExitCode.INTERRUPTED
    assert b" calls, 0 lost\nround trip, ms: p50 " in out
    assert peer.functions[-3:] == ["Robot_Release", "Controller_Disconnect", "Service_Stop"]


def test_a_signal_before_the_first_answer_makes_no_controller_of_nobody() -> None:
    with udp_server(lambda peer: peer.answers.update({"Service_Start": None})) as server:
        argv = [sys.executable, "-m", "bcapscope", "ping", "127.0.0.1", "--port", str(server.port)]
        with subprocess.Popen([*argv, "--timeout", "300"], stdout=subprocess.PIPE) as program:
            while not server.peers:
                assert program.poll() is None
                threading.Event().wait(0.02)
            program.send_signal(signal.SIGTERM)
            out, _ = program.communicate()
    assert program.returncode == ExitCode.INTERRUPTED
    assert out.decode() == f"127.0.0.1:{server.port} over UDP: no answer\n"


@pytest.mark.parametrize("transport", ["--udp", "--tcp"])
def test_a_closed_port_is_reported_after_the_first_refusal(transport: str) -> None:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        address = f"127.0.0.1:{probe.getsockname()[1]}"
    began = time.monotonic()
    done = run_here("ping", address, transport, "--timeout", "30000")
    assert time.monotonic() - began < 20
    assert done.code == ExitCode.UNANSWERED
    assert "nothing listens on this port (connection refused)" in done.err
    assert done.err.startswith(f"bcapscope: {address}")
    assert "このポートで待ち受けているものがありません" in run_here("ping", address, "--lang", "ja").err
