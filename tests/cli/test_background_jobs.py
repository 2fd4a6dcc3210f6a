"""Servers as background jobs of a script, whose shell starts them with SIGINT ignored."""

from __future__ import annotations

import shlex
import socket
import subprocess
import sys
from pathlib import Path

import pytest

from bcapscope.cli.common.exit_codes import ExitCode
from tests.cli.run import CAPTURES, run_here

SESSION = CAPTURES / "slave-session.pcapng"
SERVERS = {
    "sim": ("-p", "0", "--record", "{record}"),
    "proxy": ("--listen", "127.0.0.1:0", "--to", "127.0.0.1:9", "--record", "{record}"),
    "replay": (str(SESSION), "--as", "server", "-p", "{port}", "--record", "{record}"),
}


@pytest.mark.parametrize("command", SERVERS)
def test_the_help_says_how_a_script_ends_it(command: str) -> None:
    assert "with SIGTERM, as in kill $!" in " ".join(run_here(command, "--help").out.split())


@pytest.mark.skipif(sys.platform == "win32", reason="Windows has no such shell")
@pytest.mark.parametrize("command", SERVERS)
def test_sigterm_ends_a_background_job(command: str, tmp_path: Path) -> None:
    record, said = tmp_path / "all.pcapng", shlex.quote(str(tmp_path / "said"))
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        port = probe.getsockname()[1]
    words = [word.format(record=record, port=port) for word in SERVERS[command]]
    program = shlex.join([sys.executable, "-m", "bcapscope", command, *words])
    script = f"""
        {program} 2> {said} > /dev/null &
        while ! grep -q "can connect" {said}; do kill -0 $! || exit 99; sleep 0.05; done
        kill $!
        wait $!
    """
    done = subprocess.run(["sh", "-c", script], stdin=subprocess.DEVNULL, check=False, timeout=60)
    assert done.returncode == ExitCode.OK, (tmp_path / "said").read_text()
    assert run_here("decode", record).code == ExitCode.OK
