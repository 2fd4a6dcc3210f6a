"""A simulator and a proxy before it, as a user runs them, and clients that talk through both."""

from __future__ import annotations

import asyncio
import re
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from bcapscope.client import RetryPolicies, Session, open_session, over_tcp, over_udp
from bcapscope.errors import BcapError, CallTimeout
from bcapscope.protocol.codec.variant import EMPTY, VT, Variant
from bcapscope.protocol.retry.requester import (
    CallAnswered,
    CallRefused,
    CallTimedOut,
    RequesterEvent,
    RetryPolicy,
)
from bcapscope.protocol.retry.reserved_convention import ReservedConvention
from bcapscope.traffic.observation import Observation

PATIENCE = 30.0
SLAVE_MODE = 0x102
"""Mode 1, joints: the answer comes at once, be it that there is no room for the set point."""


class Process:
    """A command that runs.

    Attributes:
        port: where it listens.
        popen: the process.
    """

    def __init__(self, words: list[str], stdout: int, descriptors: int | None = None) -> None:
        argv = [sys.executable, "-m", "bcapscope", *words]
        if descriptors is not None:
            argv = ["sh", "-c", f'ulimit -n {descriptors}; exec "$@"', "sh", *argv]
        self.popen = subprocess.Popen(argv, stdin=subprocess.DEVNULL, stdout=stdout, stderr=subprocess.PIPE)
        self._err: list[str] = []
        self._reader = threading.Thread(target=self._read, daemon=True)
        self._reader.start()
        self.port = int(self.wait_for(r"(?:port |:)(\d+)(?: UDP| TCP|,)")[1])

    def _read(self) -> None:
        assert self.popen.stderr is not None
        for line in self.popen.stderr:
            self._err.append(line.decode())

    @property
    def err(self) -> str:
        """What it told so far."""
        return "".join(self._err)

    def wait_for(self, pattern: str) -> re.Match[str]:
        """Wait until it tells something."""
        until = time.monotonic() + PATIENCE
        while (found := re.search(pattern, self.err)) is None:
            assert time.monotonic() < until, self.err
            assert self.popen.poll() is None, self.err
            time.sleep(0.01)
        return found

    def end(self, number: int, code: int = 0) -> str:
        """Send it a signal and wait for its end with an exit code; return all that it told."""
        self.popen.send_signal(number)
        assert self.popen.wait(PATIENCE) == code, self.err
        self.close()
        return self.err

    def close(self) -> None:
        """Kill it, if it still runs."""
        self.popen.kill()
        self.popen.wait(PATIENCE)
        self._reader.join(PATIENCE)
        for pipe in (self.popen.stdout, self.popen.stderr):
            if pipe is not None:
                pipe.close()


@contextmanager
def simulator(*words: str, descriptors: int | None = None) -> Iterator[Process]:
    """Run ``bcapscope sim``, perhaps with a limit of file descriptors."""
    process = Process(["sim", "-q", "--port", "0", *words], subprocess.DEVNULL, descriptors)
    try:
        yield process
    finally:
        process.close()


@contextmanager
def proxy(
    to: int, *words: str, stdout: int = subprocess.DEVNULL, descriptors: int | None = None
) -> Iterator[Process]:
    """Run ``bcapscope proxy`` before a port; it is recording when the block begins."""
    spec = ["proxy", "--listen", "127.0.0.1:0", "--to", f"127.0.0.1:{to}"]
    process = Process([*spec, *words], stdout, descriptors)
    try:
        yield process
    finally:
        process.close()


class Talk:
    """What a client saw of its session.

    Attributes:
        sent: the frames that it sent.
        heard: the frames that it heard.
        calls: of each call its tries and its result, None where there was none.
    """

    def __init__(self) -> None:
        self.sent: list[bytes] = []
        self.heard: list[bytes] = []
        self.calls: list[tuple[int, int | None]] = []

    def observe(self, seen: Observation) -> None:
        """See a frame."""
        (self.sent if seen.flow.direction == "request" else self.heard).append(seen.item.raw)

    def listen(self, event: RequesterEvent) -> None:
        """Hear of an end."""
        if isinstance(event, CallAnswered | CallRefused):
            self.calls.append((len(event.attempts), event.reply.code))
        elif isinstance(event, CallTimedOut):
            self.calls.append((len(event.attempts), None))


def talk(port: int, convention: ReservedConvention, points: int, timeout: int = 1000) -> Talk:
    """Run a session with so many set points; tries after `timeout` ms, eight at most."""
    tcp = convention in (ReservedConvention.TCP0, ReservedConvention.TCP1)
    seen = Talk()
    pace = RetryPolicy(timeout * 1_000_000, 7)

    async def play() -> None:
        opener = (over_tcp if tcp else over_udp)("127.0.0.1", port)
        session = open_session(
            opener,
            convention=convention,
            retry_policies=RetryPolicies(pace, pace, pace),
            observer=seen.observe,
            listener=seen.listen,
        )
        async with session as link:
            await drive(link, points)

    asyncio.run(play())
    return seen


async def drive(session: Session, points: int, is_strict: bool = False) -> None:
    """Connect, take the arm, enter slave mode, send set points, and leave it all.

    Args:
        session: new.
        points: how many.
        is_strict: it may follow one that broke off; a set point that is not answered is an error.
    """
    await session.invoke("Service_Start", "")
    reply = await session.invoke("Controller_Connect", "", "CaoProv.DENSO.VRC", "localhost", "")
    controller = reply.arguments[0].variant.value
    robot = (await session.invoke("Controller_GetRobot", controller, "Arm", "")).arguments[0].variant.value
    if is_strict:
        await session.perform_call(17, (Variant(VT.I4, controller), Variant(VT.BSTR, "ClearError"), EMPTY))
    await session.invoke("Robot_Execute", robot, "TakeArm", [0, 0])
    await session.invoke("Robot_Execute", robot, "Motor", [1, 0])
    await session.invoke("Robot_Execute", robot, "slvChangeMode", Variant(VT.I4, SLAVE_MODE))
    for _ in range(points):
        try:
            await session.invoke(
                "Robot_Execute", robot, "slvMove", [0.0, 0.0, 90.0, 0.0, 90.0, 0.0, 0.0, 0.0]
            )
        except CallTimeout:
            if is_strict:
                raise
        except BcapError:  # the controller refuses what comes too fast or too late; that is an answer, too
            continue


def persistent_talk(
    port: int, convention: ReservedConvention, points: int, timeout: int, again: bool = True
) -> Talk:
    """Send so many set points over TCP, in a new session whenever the old one breaks or is not answered.

    Args:
        port: where to.
        convention: of the reserved field.
        points: how many.
        timeout: ms for each call.
        again: begin anew; else it ends there.
    """
    seen = Talk()
    # The motor takes 400 ms; in one session alone nothing must break off because a machine is slow.
    pace, others = RetryPolicy(timeout * 1_000_000, 0), RetryPolicy(500_000_000 if again else 800_000_000, 0)

    async def play() -> None:
        async with open_session(
            over_tcp("127.0.0.1", port),
            convention=convention,
            retry_policies=RetryPolicies(others, pace, pace),
            observer=seen.observe,
            listener=seen.listen,
        ) as link:
            await drive(link, points - sum(b"s\0l\0v\0M\0o\0v\0e\0" in raw for raw in seen.sent), True)

    until = time.monotonic() + PATIENCE
    while time.monotonic() < until:
        try:
            asyncio.run(play())
            return seen
        except (BcapError, OSError):
            # On TCP a call is one packet; the last one may have ended with the connection.
            seen.calls += [(1, None)] * (len(seen.sent) - len(seen.calls))
            if not again:
                return seen
            time.sleep(0.02)  # the controller has to see the end of the one before
    raise AssertionError(seen.calls[-20:])


def recording(path: Path) -> list[str]:
    """Return the options that record to a file."""
    return ["--record", str(path)]
