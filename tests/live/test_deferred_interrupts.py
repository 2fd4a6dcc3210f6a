"""Ctrl-C ends the wait for more; what was read until then is still told."""

from __future__ import annotations

import array
import fcntl
import os
import signal
import subprocess
import sys
import termios
import time
from collections.abc import Iterator
from contextlib import closing, contextmanager

import pytest

from bcapscope.cli.common.exit_codes import ExitCode
from bcapscope.live.deferred_interrupts import DeferredInterrupts
from tests.cli.run import CAPTURES, run_here

pytestmark = pytest.mark.lifecycle

LIMIT = 30.0
SESSION = CAPTURES / "slave-session.pcapng"

unix = pytest.mark.skipif(sys.platform == "win32", reason="pipes are looked into as Unix allows it")


@pytest.fixture
def interrupts() -> Iterator[DeferredInterrupts]:
    before = signal.getsignal(signal.SIGINT)
    with closing(DeferredInterrupts()) as found:
        yield found
    assert signal.getsignal(signal.SIGINT) is before


def interrupt() -> int:
    signal.raise_signal(signal.SIGINT)
    return 1


def test_a_wait_that_is_left_alone(interrupts: DeferredInterrupts) -> None:
    assert interrupts.read_or_stop(lambda: 1) == 1


def test_ctrl_c_ends_a_wait(interrupts: DeferredInterrupts) -> None:
    assert interrupts.read_or_stop(interrupt) is None


def test_ctrl_c_meanwhile_waits_for_the_next_wait(interrupts: DeferredInterrupts) -> None:
    interrupt()
    assert interrupts.read_or_stop(lambda: 1) is None


def test_ctrl_c_twice_ends_the_work_as_well(interrupts: DeferredInterrupts) -> None:
    interrupt()
    with pytest.raises(KeyboardInterrupt):
        interrupt()


def test_what_a_wait_raises_gets_through(interrupts: DeferredInterrupts) -> None:
    def fails() -> int:
        raise OSError("gone")

    with pytest.raises(OSError, match="gone"):
        interrupts.read_or_stop(fails)
    interrupt()
    assert interrupts.read_or_stop(lambda: 1) is None


@unix
def test_ctrl_c_while_lines_are_written_loses_none_of_them() -> None:
    """The program hangs in the middle of its output, or is about to, since nobody reads it."""
    with _decoding() as decoding:
        decoding.give(SESSION.read_bytes())
        assert decoding.process.stdout is not None
        _await_bytes(decoding.process.stdout.fileno(), 60_000, 1 << 30)
        decoding.process.send_signal(signal.SIGINT)
        lines, told = decoding.end()
    assert told == f"{len(lines)} frames in {len(lines)} packets\n"  # all, or up to where it hung
    assert sum(len(line) + 1 for line in lines) > 60_000


@unix
@pytest.mark.parametrize("size", [3, 40, 20_001])
def test_ctrl_c_in_the_middle_of_a_packet_is_not_where_the_capture_breaks_off(size: int) -> None:
    with _decoding() as decoding:
        decoding.give(SESSION.read_bytes()[:size])
        _await_bytes(decoding.there, 0, 0)
        decoding.process.send_signal(signal.SIGINT)
        lines, told = decoding.end()
    assert told == f"{len(lines)} frames in {len(lines)} packets\n"


@unix
def test_what_comes_slowly_through_a_pipe_that_does_not_block_is_waited_for() -> None:
    data = SESSION.read_bytes()
    with _decoding() as decoding:
        os.set_blocking(decoding.there, False)
        decoding.give(data[:50_000])
        _await_bytes(decoding.there, 0, 0)
        decoding.give(data[50_000:])
        lines, _ = decoding.end()
    assert lines == run_here("decode", SESSION).lines


class _Decoding:
    """A decoder and the pipe from which it reads, both of whose ends are open here."""

    def __init__(self, process: subprocess.Popen[bytes], there: int, here: int) -> None:
        self.process = process
        self.there = there
        self._here = here

    def give(self, data: bytes) -> None:
        """Write into the pipe; waits where there is no room."""
        view = memoryview(data)
        while view:
            view = view[os.write(self._here, view) :]

    def end(self) -> tuple[list[str], str]:
        """End the stream; return the lines, the first of the session's or all of them, and what was told."""
        os.close(self._here)
        out, told = self.process.communicate(timeout=LIMIT)
        os.close(self.there)
        assert self.process.returncode == ExitCode.OK
        lines = out.decode().splitlines()
        assert lines == run_here("decode", SESSION).lines[: len(lines)]
        return lines, told.decode()


@contextmanager
def _decoding() -> Iterator[_Decoding]:
    there, here = os.pipe()
    argv = [sys.executable, "-m", "bcapscope", "decode", "-"]
    pipe = subprocess.PIPE
    with subprocess.Popen(argv, stdin=there, stdout=pipe, stderr=pipe) as process:
        try:
            yield _Decoding(process, there, here)
        finally:
            process.kill()


def _await_bytes(pipe: int, least: int, most: int) -> None:
    """Wait until a pipe holds so many bytes."""
    count = array.array("i", [-1])
    until = time.monotonic() + LIMIT
    while not least <= count[0] <= most and time.monotonic() < until:
        fcntl.ioctl(pipe, termios.FIONREAD, count)
        time.sleep(0.01)  # nothing tells how full a pipe is but the pipe
    assert least <= count[0] <= most
