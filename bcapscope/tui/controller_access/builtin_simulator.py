"""The built-in simulator: a process on a free loopback port, for users who have no controller."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from typing import NamedTuple

from bcapscope.player.realtime import realtime_priority
from bcapscope.simulator.kinematics import Joints
from bcapscope.simulator.machine import InitialState
from bcapscope.simulator.profile import DEFAULT_PROFILE, PROFILES
from bcapscope.simulator.simulator import Simulator
from bcapscope.simulator.simulator_server import SimulatorServer
from bcapscope.tui.reader_language import label

START_JOINTS: Joints = (
    12.422607421875,
    60.3607177734375,
    17.6319580078125,
    35.8143310546875,
    20.427978515625,
    23.947917938232422,
    0.0,
    0.0,
)
"""Joints in degrees (VT_R4): the position after slvMove in DENSO Wave 2009, How to use the Slave mode."""

END_TIMEOUT = 2.0
"""Maximum time in seconds for the simulator to end; then bcapscope kills the simulator."""

_STEP = 0.2
_HOST = "127.0.0.1"


class BuiltInSimulator(NamedTuple):
    host: str
    port: int
    process: subprocess.Popen[bytes]


@contextmanager
def run_builtin_simulator(profile: str = DEFAULT_PROFILE) -> Iterator[BuiltInSimulator]:
    """Run the built-in simulator during the `with` block; raises `OSError` if the start fails."""
    process = subprocess.Popen(
        [sys.executable, "-m", __name__, profile],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        stderr=subprocess.DEVNULL,
        start_new_session=True,  # Ctrl-C must not end the simulator, because the screen uses Ctrl-C as a key
    )
    with process:
        assert process.stdin is not None
        assert process.stdout is not None
        try:
            line = process.stdout.readline()
            if not line:
                raise ConnectionError(label("simulator.not-started"))
            yield BuiltInSimulator(_HOST, int(line), process)
        finally:
            process.stdin.close()
            try:
                process.wait(END_TIMEOUT)
            except subprocess.TimeoutExpired:
                process.kill()


def serve(profile: str) -> None:
    """Write the port to stdout, then simulate a controller until stdin closes."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    now = time.monotonic_ns()
    start = InitialState(joints=START_JOINTS, motor=True, epoch=time.time_ns() - now)
    server = SimulatorServer(Simulator(PROFILES[profile], start, now), _HOST, 0)

    def end_with_stdin() -> None:
        sys.stdin.read()
        os._exit(0)

    threading.Thread(target=end_with_stdin, daemon=True).start()
    sys.stdout.write(f"{server.address[1]}\n")
    sys.stdout.flush()
    with realtime_priority():  # a simulated controller must keep its 8 ms cycle even on a busy computer
        while True:
            server.step(_STEP)


if __name__ == "__main__":
    serve(sys.argv[1])
