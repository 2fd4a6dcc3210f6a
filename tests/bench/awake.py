"""Processors that do not sleep: on a virtual machine, waking one can take longer than answering a call.

`polling`: where the system has a driver for sleep states, a file of its quality of service asks for none of
them; a processor without work then polls, as with the kernel's option `idle=poll`, which people who need
short times set on real machines. `loops`, and where there is no such driver: a loop of idle priority runs
on each, as on a machine that has other things to do; that costs whoever wakes a change of programs, and
now and then a tick, until the loop is interrupted. What is compared does not come off alike in the two: only
who sleeps until the next packet comes pays for being woken.
"""

from __future__ import annotations

import argparse
import os
import subprocess
import sys
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path

_LATENCY = Path("/dev/cpu_dma_latency")
_DRIVER = Path("/sys/devices/system/cpu/cpuidle/current_driver")

_LOOP = """
import os, sys
os.sched_setscheduler(0, os.SCHED_IDLE, os.sched_param(0))
os.sched_setaffinity(0, {int(sys.argv[1])})
while True: pass
"""


_WAYS = ("polling", "loops")


def add_option(parser: argparse.ArgumentParser) -> None:
    """Let the command line say `--awake`, polling unless told."""
    text = "keep the processors from sleeping"
    parser.add_argument("--awake", nargs="?", choices=_WAYS, const=_WAYS[0], help=text)


@contextmanager
def awake(way: str | None) -> Iterator[None]:
    """Keep the processors that this process may use from sleeping, for the length of a block; Linux only.

    Args:
        way: `polling` or `loops`; None to let them sleep.

    Raises:
        SystemExit: the system is another one.
    """
    if way is None:
        yield
        return
    if sys.platform != "linux":
        raise SystemExit("processors can be kept awake on Linux only")
    with ExitStack() as stack:
        if way == "loops" or not _poll_when_idle(stack):
            for processor in os.sched_getaffinity(0):
                loop = stack.enter_context(subprocess.Popen([sys.executable, "-c", _LOOP, str(processor)]))
                stack.callback(loop.kill)
        yield


def _poll_when_idle(stack: ExitStack) -> bool:
    """Ask for 0 us to wake until the stack is closed (Linux, power/pm_qos_interface); tell if it is heard."""
    with suppress(OSError):
        if _DRIVER.read_text(encoding="ascii").strip() != "none":
            stack.enter_context(_LATENCY.open("wb", buffering=0)).write(bytes(4))
            return True
    return False
