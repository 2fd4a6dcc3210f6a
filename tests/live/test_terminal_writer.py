"""A terminal that stops, is closed, or shows a line at its bottom."""

from __future__ import annotations

import os
import subprocess
import sys

import pytest

_SCREEN = """
import sys, time
from bcapscope.live import terminal_writer
{setup}
it = terminal_writer.TerminalWriter()
{do}
it.close()
"""


def ran(do: str, setup: str = "", stdout: int = subprocess.PIPE) -> tuple[str, str]:
    """Run a program that has a screen; return what it wrote."""
    code = _SCREEN.format(setup=setup, do=do)
    done = subprocess.run(
        [sys.executable, "-c", code], stdout=stdout, stderr=subprocess.PIPE, check=True, timeout=60
    )
    return (done.stdout or b"").decode(), done.stderr.decode()


def test_lines_and_sentences() -> None:
    out, err = ran(
        'it.write_lines(["one", b"two", "三"]); it.write_message("a sentence"); it.write_lines([])'
    )
    assert (out, err) == ("one\ntwo\n三\n", "a sentence\n")


@pytest.mark.lifecycle
def test_a_closed_pipe_is_told_once_and_the_rest_goes_on() -> None:
    reading, writing = os.pipe()
    os.close(reading)
    wait = 'time.sleep(0.2); it.write_lines(["two"]); it.write_message("still here")'
    _, err = ran(f'it.write_lines(["one"]); {wait}', stdout=writing)
    os.close(writing)
    sentence = "standard output is closed: nothing is shown there any more, all else goes on"
    assert err == f"{sentence}\nstill here\n"


@pytest.mark.lifecycle
@pytest.mark.skipif(not os.path.exists("/dev/full"), reason="there is no such file")
def test_a_full_disk_is_told_as_that() -> None:
    with open("/dev/full", "wb") as full:
        _, err = ran('it.write_lines(["one"])', stdout=full.fileno())
    assert err == "standard output has no room: nothing is shown there any more, all else goes on\n"


@pytest.mark.lifecycle
def test_a_terminal_that_has_stopped_holds_nobody_up() -> None:
    reading, writing = os.pipe()
    try:
        do = (
            "began = time.monotonic()\n"
            'for number in range(50): it.write_lines(["x" * 99] * 1000)\n'
            "assert time.monotonic() - began < 10"
        )
        _, err = ran(
            f'{do}; it.write_message("a sentence")', "terminal_writer._LINES_WITHIN = 0.5", stdout=writing
        )
        assert err.startswith("a sentence\n")
        missing = int(err.split()[2].replace(",", ""))
        assert err.endswith(" lines are not shown: standard output takes nothing\n")
        shown = os.read(reading, 1 << 20).count(b"\n")
        assert shown + missing == pytest.approx(50_000, abs=41)  # it is written 4096 bytes at a time
    finally:
        os.close(reading)
        os.close(writing)


def test_a_pipe_that_does_not_wait_is_waited_for() -> None:
    out, err = ran('it.write_lines(["x" * 99] * 1000)', "import os; os.set_blocking(1, False)")
    assert (out, err) == (("x" * 99 + "\n") * 1000, "")


def test_what_there_was_no_time_for_is_counted() -> None:
    out, err = ran('it.write_lines(["x"] * 30)', "terminal_writer.MAX_WAITING = 20")
    assert out == "x\n" * 20
    assert err == "10 lines are not shown: there was no time to write them\n"


def test_the_line_at_the_bottom_is_for_terminals_only() -> None:
    setup = "sys.stderr.isatty = lambda: True"
    do = 'it.set_status("12 calls"); time.sleep(0.3); it.write_message("news"); time.sleep(0.3)'
    assert ran(do, setup)[1] == "12 calls\r\x1b[Knews\n"
    assert ran(do)[1] == "news\n"
