"""``bcapscope tui --proxy`` and ``--sim`` where they cannot begin, and where their terminal goes away."""

from __future__ import annotations

import os
import socket
import subprocess
import sys
import time
from pathlib import Path

import pytest

from tests.cli.run import run

pty = pytest.importorskip("pty", reason="there are no pseudo-terminals here")

LIMIT = 60.0
TO = ("--to", "127.0.0.1:9")


@pytest.mark.parametrize(
    ("words", "reason"),
    [
        (["--proxy", "--listen", "127.0.0.1:0"], "each --listen needs one --to"),
        (["--proxy", "--sim"], "only one of HOST, FILE, -i, --proxy and --sim"),
        (["--listen", "127.0.0.1:0", *TO], "add --proxy"),
        (["--read-only"], "add --proxy"),
        (["--scenario", "emergency-stop"], "add --sim"),
        (["--proxy", "127.0.0.1:1", "--fault", "loss=5%"], "leave out --listen, --to, --record and rules"),
        (["--proxy", "--listen", "127.0.0.1:0", *TO, "--fault", "los=5%"], "did you mean 'loss'"),
        (["--sim", "--scenario", "nix"], "there is no scenario 'nix'"),
    ],
)
def test_a_command_line_that_makes_no_sense(words: list[str], reason: str) -> None:
    ran = run("tui", *words)
    assert ran.code == 2
    assert reason in ran.err
    assert "Traceback" not in ran.err


@pytest.mark.parametrize("words", [["--sim", "-p"], ["--proxy", *TO, "--listen"]], ids=["sim", "proxy"])
def test_a_port_that_is_taken_is_told_in_one_sentence(words: list[str]) -> None:
    with socket.create_server(("127.0.0.1", 0)) as taken:
        port = taken.getsockname()[1]
        place = f"{port}" if "-p" in words else f"127.0.0.1:{port}"
        ran = run("tui", *words, place)
    assert ran.code == 4
    assert ran.err.lower() == f"cannot listen on 127.0.0.1 tcp port {port}: address already in use\n"


def test_a_child_starts_before_the_screens_are_loaded() -> None:
    code = "import sys, bcapscope.cli.common.tui_sources; print(*sys.modules)"
    ran = subprocess.run([sys.executable, "-c", code], capture_output=True, check=True, text=True)
    assert not {"textual", "bcapscope.tui.app", "bcapscope.proxy.control_client"} & {*ran.stdout.split()}


def test_no_proxy_is_there(tmp_path: Path) -> None:
    ran = run("tui", "--proxy", str(tmp_path / "nothing"))
    assert ran.code == 4
    assert ran.err.startswith("no proxy listens for control on ")
    assert ran.err.count("\n") == 1


@pytest.mark.lifecycle
def test_the_proxy_ends_with_its_terminal(tmp_path: Path) -> None:
    near, far = pty.openpty()
    spec = ["tui", "--proxy", "--listen", "127.0.0.1:0", *TO]
    argv = [sys.executable, "-m", "bcapscope", *spec]
    lead = f"import os; os.login_tty({far}); os.execv({argv[0]!r}, {argv!r})"
    env = {**os.environ, "TERM": "xterm-256color", "HOME": str(tmp_path), "XDG_CACHE_HOME": str(tmp_path)}
    with subprocess.Popen(
        [sys.executable, "-c", lead], pass_fds=[far], env=env, start_new_session=True
    ) as process:
        os.close(far)
        try:
            seen, end = b"", time.monotonic() + LIMIT
            while b"p99.9" not in seen:
                assert time.monotonic() < end, seen[-2000:]
                seen += os.read(near, 65536)
            os.close(near)
            assert process.wait(LIMIT) == 0
        finally:
            process.kill()
    assert [path for path in tmp_path.rglob("*") if "traffic-" in path.name] == []
