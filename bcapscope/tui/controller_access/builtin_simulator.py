"""The built-in simulator: a process of its own on a free loopback port, so that the first start always works.

It ends with the program that started it, however that ends: the pipe between them is closed then.
"""

from __future__ import annotations

import signal
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass

from bcapscope.player.realtime import realtime_priority
from bcapscope.simulator.kinematics import Joints
from bcapscope.simulator.machine import InitialState
from bcapscope.simulator.profile import PROFILES
from bcapscope.simulator.simulator import Simulator
from bcapscope.simulator.simulator_server import SimulatorServer

DEFAULT_PROFILE = "rc7"
"""The controller that the screen of b-CAP Tester shows (DENSO Wave 2009, How to use the Slave mode)."""

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
"""Where the robot stands at first: where that of the same pages stands after its slvMove, as R4 tells it."""

END_TIMEOUT = 2.0
"""Seconds that the simulator has to end by itself."""

_STEP = 0.2
_HOST = "127.0.0.1"


@dataclass(frozen=True, slots=True)
class BuiltInSimulator:
    """Where the simulator listens, UDP and TCP.

    Attributes:
        host: loopback.
        port: a free one.
        process: that listens there.
    """

    host: str
    port: int
    process: subprocess.Popen[bytes]

    @property
    def has_ended(self) -> bool:
        """Whether it has ended by itself, or was killed."""
        return self.process.poll() is not None


@contextmanager
def run_builtin_simulator(profile: str = DEFAULT_PROFILE) -> Iterator[BuiltInSimulator]:
    """Run the simulator for the length of a block.

    Raises:
        OSError: it does not start.
    """
    process = subprocess.Popen(
        [sys.executable, "-m", __name__, profile],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        stderr=subprocess.DEVNULL,
        start_new_session=True,  # Ctrl-C is for the screen
    )
    with process:
        assert process.stdin is not None
        assert process.stdout is not None
        try:
            line = process.stdout.readline()
            if not line:
                raise ConnectionError("the built-in simulator has ended before it began")
            yield BuiltInSimulator(_HOST, int(line), process)
        finally:
            process.stdin.close()
            try:
                process.wait(END_TIMEOUT)
            except subprocess.TimeoutExpired:
                process.kill()


def serve(profile: str) -> None:
    """Serve until stdin ends; write the port to stdout first."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    now = time.monotonic_ns()
    start = InitialState(joints=START_JOINTS, motor=True, epoch=time.time_ns() - now)
    server = SimulatorServer(Simulator(PROFILES[profile], start, now), _HOST, 0)
    ended = threading.Event()

    def watch() -> None:
        sys.stdin.read()
        ended.set()

    threading.Thread(target=watch, daemon=True).start()
    try:
        sys.stdout.write(f"{server.address[1]}\n")
        sys.stdout.flush()
        with realtime_priority():  # a controller keeps its 8 ms, whatever else this machine has to do
            while not ended.is_set():
                server.step(_STEP)
    finally:
        server.close()


if __name__ == "__main__":
    serve(sys.argv[1])
