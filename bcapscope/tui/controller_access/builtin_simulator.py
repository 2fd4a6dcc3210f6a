"""The built-in simulator: a separate process on a free loopback port, so that the first start always works.

The simulator also ends if its parent is killed, since the pipe between them closes then.
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
from bcapscope.tui.reader_language import label

DEFAULT_PROFILE = "rc7"
"""Profile of the controller that b-CAP Tester's screen shows (DENSO Wave 2009, How to use the Slave mode)."""

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
"""Joint angles at the start: those on the same pages after the slvMove, as R4 values."""

END_TIMEOUT = 2.0
"""Seconds that the simulator has to end before it is killed."""

_STEP = 0.2
_HOST = "127.0.0.1"


@dataclass(frozen=True, slots=True)
class BuiltInSimulator:
    """The address of the simulator, for UDP and TCP."""

    host: str
    port: int
    process: subprocess.Popen[bytes]

    @property
    def has_ended(self) -> bool:
        """Whether the process has ended or was killed."""
        return self.process.poll() is not None


@contextmanager
def run_builtin_simulator(profile: str = DEFAULT_PROFILE) -> Iterator[BuiltInSimulator]:
    """Run the simulator for the length of a block.

    Raises:
        OSError: The simulator does not start.
    """
    process = subprocess.Popen(
        [sys.executable, "-m", __name__, profile],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        stderr=subprocess.DEVNULL,
        start_new_session=True,  # Ctrl-C is a key of the screen
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
    """Write the port to stdout, then serve until stdin ends."""
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
        with realtime_priority():  # a controller keeps its 8 ms cycle under any load
            while not ended.is_set():
                server.step(_STEP)
    finally:
        server.close()


if __name__ == "__main__":
    serve(sys.argv[1])
