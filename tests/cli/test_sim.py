"""``bcapscope sim`` as a user runs it."""

from __future__ import annotations

import re
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from bcapscope.protocol.codec.frame import Frame, encode_frame
from bcapscope.protocol.codec.variant import EMPTY
from bcapscope.simulator.argument_values import bstr
from tests.cli.run import run, run_here


@contextmanager
def simulator(*words: str) -> Iterator[tuple[subprocess.Popen[str], int]]:
    """Run it on a free port; yield the process and the port."""
    argv = [sys.executable, "-m", "bcapscope", "sim", "--port", "0", *words]
    pipe = subprocess.PIPE
    with subprocess.Popen(argv, stdin=pipe, stdout=pipe, stderr=pipe, text=True) as process:
        assert process.stderr is not None
        try:
            greeting = process.stderr.readline()
            match = re.search(r"port (\d+)", greeting)
            assert match, greeting
            process.stderr.readline()
            yield process, int(match[1])
        finally:
            process.kill()


def ask(port: int) -> Frame:
    """Start a service session."""
    with socket.create_connection(("127.0.0.1", port), 20) as sock:
        sock.sendall(encode_frame(1, 0, 1, [bstr(",WDT=400")]))
        return Frame(sock.recv(4096))


def wait_for(condition: Callable[[], bool]) -> None:
    """Wait until something is true."""
    end = time.monotonic() + 60
    while not condition():
        assert time.monotonic() < end


@pytest.mark.lifecycle
@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_it_answers_logs_and_ends(number: signal.Signals) -> None:
    with simulator("--profile", "rc7") as (process, port):
        assert ask(port).code == 0
        process.send_signal(number)
        out, err = process.communicate(timeout=30)
        assert process.returncode == 0
        assert re.fullmatch(r'tcp 127\.0\.0\.1:\d+ Service_Start "?,WDT=400"? -> S_OK\n', out), out
        assert err.startswith("1 calls; 0 datagrams")


@pytest.mark.lifecycle
@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_it_ends_in_order_as_soon_as_it_listens(number: signal.Signals) -> None:
    with simulator() as (process, _):
        process.send_signal(number)
        out, err = process.communicate(timeout=30)
    assert (process.returncode, out) == (0, "")
    assert err.endswith("0 calls; 0 datagrams dropped (invalid requests, or too many clients)\n")


def test_a_stdout_that_nobody_reads_holds_no_client_up() -> None:
    request = encode_frame(1, 0, 1, [bstr(",WDT=400" + " " * 200)])
    longest = 0.0
    with simulator() as (process, port), socket.create_connection(("127.0.0.1", port), 20) as sock:
        for _ in range(1000):  # lines of more than 100 characters, where a pipe holds 64 kB
            began = time.monotonic()
            sock.sendall(request)
            assert Frame(sock.recv(4096)).code == 0
            longest = max(longest, time.monotonic() - began)
        assert process.stdin is not None
        process.stdin.write("nonsense\n")
        process.stdin.flush()
        assert process.stderr is not None
        assert process.stderr.readline().startswith("commands: reset (forget all clients)")
        process.send_signal(signal.SIGINT)
        notices = process.stderr.read()
        assert process.wait(30) == 0
    assert longest < 10
    assert re.fullmatch(
        r"1000 calls; 0 datagrams .*\n[\d,]+ lines are not shown: standard output accepts no data\n", notices
    ), notices


@pytest.mark.lifecycle
def test_it_goes_on_when_the_reader_of_its_log_has_gone() -> None:
    with simulator() as (process, port):
        assert process.stdout is not None
        process.stdout.close()
        for _ in range(3):
            assert ask(port).code == 0
        assert process.stderr is not None
        assert process.stderr.readline().startswith("standard output is closed")
        assert ask(port).code == 0


def test_commands_are_taken_while_it_runs() -> None:
    with simulator("-q") as (process, port):
        with socket.create_connection(("127.0.0.1", port), 20) as sock:
            sock.sendall(encode_frame(1, 0, 1, [bstr("")]))
            assert sock.recv(4096)
            assert process.stdin is not None
            process.stdin.write("reset\n")
            process.stdin.flush()
            assert sock.recv(4096) == b""
        out, err = process.communicate("nonsense\nq\n", timeout=30)
        assert (process.returncode, out) == (0, "")
        assert err.startswith("all clients are forgotten\ncommands: reset (forget all clients)")


def test_what_was_pressed_is_told() -> None:
    done = run("sim", "--port", "0", stdin=b"s\ngo\nquit\n")
    notices = [line for line in done.err.splitlines() if line.startswith("the emergency stop is ")]
    assert notices == ["the emergency stop is pressed", "the emergency stop is released"]


def test_what_passes_is_recorded(tmp_path: Path) -> None:
    path = tmp_path / "a.pcapng"
    with simulator("--record", str(path), "-q") as (process, port):
        assert ask(port).code == 0
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sock:
            sock.settimeout(20)
            sock.connect(("127.0.0.1", port))
            sock.send(encode_frame(1, 0, 1, [bstr("")]))
            assert sock.recv(4096)
        wait_for(lambda: len(run_here("decode", path, "--port", str(port)).lines) == 4)
        process.kill()
        process.communicate(timeout=30)
    ran = run_here("decode", path, "--port", str(port))
    assert ran.code == 0, ran.err
    assert [(" tcp " in line, " response " in line) for line in ran.lines] == [
        (True, False),
        (True, True),
        (False, False),
        (False, True),
    ]


def test_a_capture_is_never_written_over(tmp_path: Path) -> None:
    path = tmp_path / "a.pcapng"
    path.write_bytes(b"mine")
    ran = run("sim", "--port", "0", "--record", path)
    assert (ran.code, ran.err) == (6, f"Error: {path}: file exists\n")
    assert path.read_bytes() == b"mine"


def test_a_port_in_use_is_one_sentence(tmp_path: Path) -> None:
    with socket.create_server(("127.0.0.1", 0)) as taken:
        port = taken.getsockname()[1]
        ran = run("sim", "--port", str(port), "--record", tmp_path / "a.pcapng")
    assert (ran.code, ran.out, list(tmp_path.iterdir())) == (4, "", [])
    assert ran.err == f"cannot listen on 127.0.0.1 TCP port {port}: address already in use\n"


def test_who_reaches_it_is_said() -> None:
    argv = [sys.executable, "-m", "bcapscope", "sim", "--port", "0", "--listen", "0.0.0.0"]
    done = subprocess.run(argv, input="quit\n", capture_output=True, text=True, check=False, timeout=60)
    assert done.returncode == 0
    assert "every machine on every network of this machine can connect" in done.stderr


def test_the_detector_of_rc7_is_switched_as_on_its_pendant() -> None:
    argv = [sys.executable, "-m", "bcapscope", "sim", "--port", "0", "--profile", "rc7"]
    done = subprocess.run(argv, input="d\nd\nquit\n", capture_output=True, text=True, check=False, timeout=60)
    notices = [line for line in done.stderr.splitlines() if "late set point is" in line]
    assert [("no error" in line) for line in notices] == [False, True]


def test_stderr_says_why_a_provider_is_refused_also_if_calls_are_not_shown() -> None:
    with simulator("--quiet") as (process, port), socket.create_connection(("127.0.0.1", port), 20) as sock:
        texts = ("", "CaoProv.Canon.N10-W02\x1b[31m", "", "Server=192.168.0.90")
        for request in (encode_frame(1, 0, 1, [bstr("")]), encode_frame(2, 0, 3, [*map(bstr, texts)])):
            sock.sendall(request)
            reply = Frame(sock.recv(4096))
        assert reply.code == 0x80070057
        process.send_signal(signal.SIGINT)
        _, err = process.communicate(timeout=30)
    reason = next(line for line in err.splitlines() if "refused" in line)
    assert reason.startswith("tcp 127.0.0.1:")
    assert "provider 'CaoProv.Canon.N10-W02\\x1b[31m' is not simulated" in reason
    assert "CaoProv.DENSO.VRC" in reason
    assert "\x1b" not in err


def test_behaviours_are_listed_with_their_sources() -> None:
    ran = run_here("sim", "--behaviours")
    assert ran.code == 0
    lines = ran.out.splitlines()
    assert lines[0].split()[:2] == ["BEHAVIOUR", "CERTAINTY"]
    assert any(line.startswith("needs_robslave ") and "documented" in line for line in lines)


def test_scenarios_are_listed_with_a_sentence_each() -> None:
    ran = run_here("sim", "--scenarios")
    assert (ran.code, ran.err) == (0, "")
    names = [line.split()[0] for line in ran.lines[1:]]
    assert names == sorted(names)
    assert "emergency-stop" in names


@pytest.mark.parametrize(
    ("words", "error"),
    [
        (("--scenario", "emergency-step"), "did you mean 'emergency-stop'?"),
        (("--scenario", "none.yaml"), "cannot read none.yaml: No such file or directory"),
        (("--scenario", "no-robslave", "--profile", "rc8"), "needs profile rc7"),
        (("--defect", "all"), "'all' is not one of 'forgets-first', 'serial-zero'"),
    ],
)
def test_a_scenario_that_is_none(words: tuple[str, ...], error: str) -> None:
    ran = run_here("sim", "--port", "0", *words)
    assert (ran.code, ran.out) == (2, "")
    assert error in ran.err


def test_a_scenario_file_that_makes_no_sense(tmp_path: Path) -> None:
    path = tmp_path / "own.yaml"
    path.write_text("title: x\nfaults:\n- {action: drop, tims: 3}\n")
    ran = run_here("sim", "--port", "0", "--scenario", path)
    assert ran.code == 2
    assert f"{path}: line 3: faults[0]: there is no field 'tims', did you mean 'times'?" in ran.err


@pytest.mark.parametrize("transport", ["--udp", "--tcp"])
def test_a_scenario_is_played_recorded_and_diagnosed(tmp_path: Path, transport: str) -> None:
    path, own = tmp_path / "a.pcapng", tmp_path / "own.yaml"
    title = "\u202ex"
    own.write_text(f"title: {title}\nstart: {{arm_taken: true}}\nfaults: [{{action: delay, time: 1ms}}]\n")
    with simulator("--scenario", str(own), "--seed", "3", "--record", str(path)) as (process, port):
        assert process.stderr is not None
        assert process.stderr.readline() == "scenario: \\u202ex\n"
        ran = run_here("call", "127.0.0.1", "-p", str(port), transport, "Robot_Execute", "TakeArm")
        assert ran.code == 8, ran.err
        process.send_signal(signal.SIGINT)
        out, _ = process.communicate(timeout=30)
    assert "# delay: delayed by 1 ms\n" in out
    findings = run_here("diagnose", path, "--port", str(port), "--json").lines
    assert '"rule":"arm-taken-by-other"' in findings[0].replace(" ", "")


@pytest.mark.parametrize(
    ("words", "count"),
    [
        (("--profile", "rc7"), 1),
        (("--profile", "rc7", "--no-argument", "always"), 0),
        (("--profile", "rc8"), 1),
        (("--scenario", "emergency-stop", "--no-argument", "always"), 0),
    ],
)
def test_replies_without_a_value_can_carry_no_argument(words: tuple[str, ...], count: int) -> None:
    with simulator(*words) as (_, port), socket.socket(type=socket.SOCK_DGRAM) as sock:
        sock.settimeout(20)
        sock.connect(("127.0.0.1", port))
        texts = ("", "CaoProv.DENSO.VRC", "localhost", "")
        sock.send(encode_frame(1, 0, 1, [bstr("")]))
        sock.recv(4096)
        sock.send(encode_frame(2, 0, 3, [*map(bstr, texts)]))
        handle = Frame(sock.recv(4096)).variants[0]
        sock.send(encode_frame(3, 0, 17, [handle, bstr("GetNothing"), EMPTY]))
        reply = Frame(sock.recv(4096))
        assert (reply.code, len(reply.variants)) == (0x80010005, count)


def test_defects_can_be_chosen() -> None:
    for words, code in (((), 0x80000902), (("--defect", "serial-zero"), 0)):
        with (
            simulator("--profile", "rc8", *words) as (_, port),
            socket.socket(type=socket.SOCK_DGRAM) as sock,
        ):
            sock.settimeout(20)
            sock.connect(("127.0.0.1", port))
            sock.send(encode_frame(0, 0, 64))
            assert Frame(sock.recv(4096)).code == code
