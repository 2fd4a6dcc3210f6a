"""The built-in simulator: a process of its own on a free loopback port, so that the first start always works.

It ends with the program that started it, however that ends: the pipe between them is closed then.
"""

from __future__ import annotations

import multiprocessing
import signal
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from multiprocessing.connection import Connection
from typing import NamedTuple

from bcapscope.simulator.kinematics import Joints
from bcapscope.simulator.machine import Start
from bcapscope.simulator.profile import PROFILES
from bcapscope.simulator.server import Server
from bcapscope.simulator.simulator import Simulator

PROFILE = "rc7"
"""The controller that the screen of b-CAP Tester shows (DENSO Wave 2009, How to use the Slave mode)."""

JOINTS: Joints = (12.422607, 60.360718, 17.631958, 35.814331, 20.427979, 23.947922, 0.0, 0.0)
"""Where the robot stands at first: where that of the same pages stands after its slvMove, as R4 tells it."""

STARTING = 10.0
"""Seconds that the simulator may take to start."""

_STEP = 0.2
_HOST = "127.0.0.1"


class Place(NamedTuple):
    """Where the simulator listens, UDP and TCP."""

    host: str
    port: int


@contextmanager
def builtin_simulator(profile: str = PROFILE) -> Iterator[Place]:
    """Run the simulator for the length of a block.

    Raises:
        OSError: it does not start; TimeoutError is one of these.
    """
    context = multiprocessing.get_context("spawn")
    ours, theirs = context.Pipe()
    process = context.Process(target=_serve, args=(theirs, profile), name="simulator", daemon=True)
    process.start()
    theirs.close()
    try:
        if not ours.poll(STARTING):
            raise TimeoutError("the built-in simulator does not start")
        yield Place(_HOST, _port(ours))
    finally:
        ours.close()
        process.join(2 * _STEP + 1)
        if process.is_alive():
            process.terminate()
            process.join(1)
        process.close()


def _port(pipe: Connection) -> int:
    try:
        port = pipe.recv()
    except EOFError:
        raise ConnectionError("the built-in simulator has ended before it began") from None
    assert isinstance(port, int)
    return port


def _serve(pipe: Connection, profile: str) -> None:
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is for the screen, and the pipe tells of its end
    now = time.monotonic_ns()
    start = Start(joints=JOINTS, motor=True, epoch=time.time_ns() - now)
    server = Server(Simulator(PROFILES[profile], start, now), _HOST, 0)
    ended = threading.Event()

    def watch() -> None:
        try:
            pipe.recv()
        except EOFError:
            ended.set()

    threading.Thread(target=watch, daemon=True).start()
    try:
        pipe.send(server.address[1])
        while not ended.is_set():
            server.step(_STEP)
    except BrokenPipeError:
        pass
    finally:
        server.close()
