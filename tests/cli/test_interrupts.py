"""Ctrl-C ends the wait for more; what was read until then is still told."""

from __future__ import annotations

import array
import fcntl
import signal
import subprocess
import sys
import termios
import time
from collections.abc import Iterator

import pytest

from bcapscope.cli.exits import Exit
from bcapscope.cli.interrupts import Interrupts
from tests.cli.run import CAPTURES, run_here

LIMIT = 30.0


@pytest.fixture
def interrupts() -> Iterator[Interrupts]:
    before = signal.getsignal(signal.SIGINT)
    with Interrupts() as found:
        yield found
    assert signal.getsignal(signal.SIGINT) is before


def interrupt() -> int:
    signal.raise_signal(signal.SIGINT)
    return 1


def test_a_wait_that_is_left_alone(interrupts: Interrupts) -> None:
    assert interrupts.wait(lambda: 1, 0) == 1


def test_ctrl_c_ends_a_wait(interrupts: Interrupts) -> None:
    assert interrupts.wait(interrupt, 0) == 0


def test_ctrl_c_meanwhile_waits_for_the_next_wait(interrupts: Interrupts) -> None:
    interrupt()
    assert interrupts.wait(lambda: 1, 0) == 0


def test_ctrl_c_twice_ends_the_work_as_well(interrupts: Interrupts) -> None:
    interrupt()
    with pytest.raises(KeyboardInterrupt):
        interrupt()


def test_what_a_wait_raises_gets_through(interrupts: Interrupts) -> None:
    def fails() -> int:
        raise OSError("gone")

    with pytest.raises(OSError, match="gone"):
        interrupts.wait(fails, 0)
    interrupt()
    assert interrupts.wait(lambda: 1, 0) == 0


@pytest.mark.skipif(sys.platform == "win32", reason="pipes are looked into as Unix allows it")
def test_ctrl_c_while_lines_are_written_loses_none_of_them() -> None:
    """The program hangs in the middle of its output, or is about to, since nobody reads it."""
    argv = [sys.executable, "-m", "bcapscope", "decode", "-"]
    pipe = subprocess.PIPE
    with subprocess.Popen(argv, stdin=pipe, stdout=pipe, stderr=pipe) as process:
        assert process.stdin is not None
        assert process.stdout is not None
        process.stdin.write((CAPTURES / "slave-session.pcapng").read_bytes())
        process.stdin.flush()
        until = time.monotonic() + LIMIT
        while _waiting_in(process.stdout.fileno()) < 60_000 and time.monotonic() < until:
            time.sleep(0.01)
        process.send_signal(signal.SIGINT)
        out, err = process.communicate(timeout=LIMIT)
    lines = out.decode().splitlines()
    assert lines == run_here("decode", CAPTURES / "slave-session.pcapng").lines[: len(lines)]
    assert err.decode().startswith(f"{len(lines)} frames in ")  # all, or up to where it hung
    assert len(out) > 60_000
    assert process.returncode == Exit.OK


def _waiting_in(pipe: int) -> int:
    """Return how many bytes a pipe holds."""
    count = array.array("i", [0])
    fcntl.ioctl(pipe, termios.FIONREAD, count)
    return count[0]
