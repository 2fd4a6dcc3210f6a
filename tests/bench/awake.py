"""Processors that do not sleep: on a virtual machine, waking one can take longer than answering a call.

Where the system has a driver for sleep states, a file of its quality of service asks for none of them: a
processor without work then polls, as with the kernel's option `idle=poll`, which people who need short times
set on real machines. Elsewhere a loop of the priority SCHED_IDLE runs on each; that costs whoever wakes a
change of programs, and now and then a tick, until the loop is interrupted.
"""

from __future__ import annotations

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


@contextmanager
def awake(wanted: bool = True) -> Iterator[None]:
    """Keep the processors that this process may use from sleeping, for the length of a block; Linux only.

    Raises:
        SystemExit: the system is another one.
    """
    if not wanted:
        yield
        return
    if sys.platform != "linux":
        raise SystemExit("processors can be kept awake on Linux only")
    with ExitStack() as stack:
        if not _poll_when_idle(stack):
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
