"""Processors that do not sleep: on a virtual machine, waking one can take longer than answering a call.

A loop at the priority SCHED_IDLE runs on each; whatever else has something to do takes its place at once. It
stands for the kernel's option `idle=poll`, which people who need short times set on real machines.
"""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager

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
        for processor in os.sched_getaffinity(0):
            loop = stack.enter_context(subprocess.Popen([sys.executable, "-c", _LOOP, str(processor)]))
            stack.callback(loop.kill)
        yield
