"""The screen in a browser."""

from __future__ import annotations

import os
import select
import shlex
import signal
import socket
import subprocess
import sys
import time
import urllib.request

import pytest

from bcapscope.cli.exits import Exit
from bcapscope.cli.tuiserve import HOST, PORT, command_line
from tests.cli.run import CAPTURES, run

LIMIT = 30.0


def test_the_command_that_is_served_is_that_without_the_option() -> None:
    words = ["tui", "a b.pcap", "--serve", "-p", "5007"]
    wanted = [sys.executable, "-m", "bcapscope", "tui", "a b.pcap", "-p", "5007"]
    assert shlex.split(command_line(words)) == wanted


def test_a_port_that_is_taken_is_told() -> None:
    with socket.socket() as taken:
        taken.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            taken.bind((HOST, PORT))
        except OSError:
            pytest.skip(f"port {PORT} is taken by another program")
        taken.listen()
        ran = run("tui", "--serve")
    assert ran.code == Exit.UNREADABLE
    assert ran.err == f"http://{HOST}:{PORT}/ cannot be served: address already in use\n"


def test_what_is_not_installed_is_told() -> None:
    source = "import sys; sys.modules['textual_serve'] = None; from bcapscope.cli import main; main()"
    done = subprocess.run(
        [sys.executable, "-c", source, "tui", "--serve"], capture_output=True, text=True, check=False
    )
    assert done.returncode == Exit.NOT_INSTALLED
    assert done.stderr == "textual-serve is not installed; pip install 'bcapscope[serve]'\n"


@pytest.mark.skipif(sys.platform == "win32", reason="no such signal")
def test_a_browser_finds_the_screen() -> None:
    pytest.importorskip("textual_serve")
    argv = [sys.executable, "-m", "bcapscope", "tui", "--serve", str(CAPTURES / "retry-story.pcapng")]
    process = subprocess.Popen(argv, stdout=subprocess.PIPE, stderr=subprocess.STDOUT)
    assert process.stdout is not None
    try:
        said = b""
        end = time.monotonic() + LIMIT
        while b"shows the screen" not in said and process.poll() is None and time.monotonic() < end:
            if select.select([process.stdout], [], [], 0.1)[0]:
                said += os.read(process.stdout.fileno(), 4096)
        if b"cannot be served" in said:
            pytest.skip(f"port {PORT} is taken by another program")
        page = ""
        while not page and time.monotonic() < end:
            try:
                page = urllib.request.urlopen(f"http://{HOST}:{PORT}/", timeout=5).read().decode()
            except OSError:
                time.sleep(0.05)
        assert "textual" in page
        assert "bcapscope" in page
    finally:
        process.send_signal(signal.SIGINT)
        process.communicate(timeout=LIMIT)
