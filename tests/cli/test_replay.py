"""``bcapscope replay`` as a user runs it."""

from __future__ import annotations

import json
import re
import signal
import socket
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from bcapscope.cli.common.exit_codes import ExitCode
from tests.cli.run import CAPTURES, run
from tests.cli.test_sim import simulator

SESSION = CAPTURES / "slave-session.pcapng"
STORY = CAPTURES / "retry-story.pcapng"


@contextmanager
def recorded_controller(*words: str | Path) -> Iterator[tuple[subprocess.Popen[str], int]]:
    """Let a recorded controller answer on a free port; yield the process and the port."""
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        port = probe.getsockname()[1]
    argv = [sys.executable, "-m", "bcapscope", "replay", *words, "--as", "server", "--port", str(port)]
    pipe = subprocess.PIPE
    with subprocess.Popen(list(map(str, argv)), stdout=pipe, stderr=pipe, text=True) as process:
        assert process.stderr is not None
        try:
            assert re.match(r"\d+ frames", process.stderr.readline())
            assert "only this machine can connect" in process.stderr.readline()
            yield process, port
        finally:
            process.kill()


def test_as_client_to_the_simulator() -> None:
    # Without set points, which a loaded machine sends too late: tests/replay plays them without a real clock.
    words = ("--json", "-f", "not command == slvMove")
    with simulator("-q") as (_, port):
        done = run("replay", SESSION, "127.0.0.1", "--as", "client", "--port", str(port), *words)
    assert done.code == ExitCode.OK, done.err
    records = [json.loads(line) for line in done.lines]
    assert [record["command"] for record in records].count("slvChangeMode") == 2
    assert len(records) == 17
    assert not any(record["differs"] for record in records)
    assert "17 calls made, all results as recorded; at most" in done.err


def test_as_client_and_as_server_at_once() -> None:
    with recorded_controller(SESSION, "--no-delay", "-q") as (process, port):
        words = ("replay", SESSION, "127.0.0.1", "--port", str(port), "--as", "client")
        refused = run(*words)
        assert refused.code == ExitCode.UNARMED
        assert "the recording was not sent. It may move or energise a robot" in refused.err
        assert "Add --arm" in refused.err
        done = run(*words, "--arm", "-f", "function != Robot_Execute")
        assert (done.code, len(done.lines)) == (ExitCode.OK, 7)
        process.send_signal(signal.SIGINT)
        _, err = process.communicate(timeout=30)
    assert process.returncode == 0
    assert re.fullmatch(r"\d+ calls, 1 of them not in the recording\n", err), err


def test_armed_calls_are_logged(tmp_path: Path) -> None:
    # Over TCP, where nothing is sent again: beside other tests a set point may wait longer than 2 ms.
    words = ("replay", SESSION, "127.0.0.1", "--as", "client", "--anywhere", "--arm", "--tcp")
    with recorded_controller(SESSION, "--no-delay", "-q") as (_, port):
        done = run(*words, "--port", str(port), XDG_STATE_HOME=str(tmp_path))
    assert "all results as recorded" in done.err, done.err
    paths = (tmp_path / "bcapscope").rglob("actions-*.jsonl")
    lines = [json.loads(line) for path in paths for line in path.read_bytes().splitlines()]
    assert {(line["program"], line["port"]) for line in lines} == {("replay", port)}
    sent = [line["sent"].removeprefix("Robot_Execute ") for line in lines if "sent" in line]
    moves = ["Robot_Move", "slvChangeMode", "slvMove", "slvMove"]
    assert sent == ["TakeArm", "Motor", "ExtSpeed", *moves]
    assert lines[-1]["set_points"] == 240
    assert any(line.get("call") == "Robot_Execute Motor" and line["received"] == "S_OK" for line in lines)


def test_a_failure_ends_it_unless_told(tmp_path: Path) -> None:
    with simulator("-q") as (_, port):
        words = ("replay", SESSION, "127.0.0.1", "--port", str(port), "--as", "client")
        chosen = ("-f", "command != slvChangeMode and function != Service_Stop and call < 40")
        ended = run(*words, *chosen)
        went_on = run(*words, *chosen, "--keep-going")
    assert ended.code == went_on.code == ExitCode.REFUSED
    assert "recorded: S_OK" in ended.lines[-1]
    assert len(ended.lines) < len(went_on.lines)


@pytest.mark.parametrize(
    ("words", "code", "reason"),
    [
        ((SESSION, "--as", "client"), ExitCode.USAGE, "--as client needs a controller: give HOST"),
        ((SESSION, "127.0.0.1", "--as", "server"), ExitCode.USAGE, "--as server takes no HOST"),
        ((SESSION,), ExitCode.USAGE, "--as"),
        ((CAPTURES / "none.pcap", "--as", "server"), ExitCode.UNREADABLE, "cannot be opened"),
        ((SESSION, "127.0.0.1", "--as", "client", "--client", "1.2.3.4"), ExitCode.NO_DATA, "no calls"),
        (
            (SESSION, "--as", "server", "--listen", "300.1.1.1"),
            ExitCode.UNREADABLE,
            "cannot listen on 300.1.1.1",
        ),
    ],
)
def test_what_cannot_be_is_told_in_a_sentence(
    words: tuple[str | Path, ...], code: ExitCode, reason: str
) -> None:
    done = run("replay", *words)
    assert (done.code, "Traceback" in done.err) == (code, False)
    assert reason in done.err


def test_set_points_that_are_not_fit_to_be_played_are_not_sent() -> None:
    with simulator("-q") as (_, port):
        words = ("replay", SESSION, "127.0.0.1", "--port", str(port), "--as", "client", "--arm")
        done = run(*words, "--limit", "J1.speed=1")
        wrong = run(*words, "--limit", "J1.sped=1")
    assert (done.code, done.lines) == (ExitCode.UNFIT, [])
    assert "J1 reaches" in done.err
    assert "not fit to play" in done.err
    assert (wrong.code, "is not a limit" in wrong.err) == (ExitCode.USAGE, True)


def test_nobody_there() -> None:
    done = run("replay", STORY, "127.0.0.1", "--as", "client", "--arm", "--port", "9", "--timeout", "50")
    assert done.code == ExitCode.UNANSWERED
    assert "Traceback" not in done.err
