"""Send nonsense and every command to a running simulator: it still answers others, and no memory grows.

Run from the project's root as ``python -m tests.fuzz.sim SECONDS [SEED]``.
"""

from __future__ import annotations

import random
import signal
import socket
import sys
import time
from collections import deque
from collections.abc import Iterator
from contextlib import contextmanager, suppress

from bcapscope.client import Blocking, Robot, connect, over_tcp
from tests.cli.proxying import Process, simulator
from tests.fuzz.commanding import Commander
from tests.fuzz.proxy import nonsense, state
from tests.proxy.test_tcp_session import cut

MAX_OPEN = 12
"""Connections that are left open with half a frame in them; the honest client needs a place."""

SHOWN_EACH = 30.0


class Hostility:
    """Clients that mean no good.

    Attributes:
        datagrams: that were sent.
        pieces: of streams that were sent.
    """

    def __init__(self, port: int, chance: random.Random) -> None:
        self.datagrams = self.pieces = 0
        self._address = ("127.0.0.1", port)
        self._chance = chance
        self._open: deque[socket.socket] = deque()

    def flood(self) -> None:
        """Send datagrams as a new client, which does not wait for answers."""
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as client:
            client.connect(self._address)
            client.setblocking(False)
            for _ in range(self._chance.randrange(1, 400)):
                self.datagrams += 1
                with suppress(BlockingIOError):
                    client.send(nonsense(self._chance, 60_000 if self._chance.random() < 0.01 else 700))

    def intrude(self) -> None:
        """Connect, send a stream, and end it in one of the ways that there are, or never."""
        client = socket.create_connection(self._address, 30)
        with suppress(BlockingIOError, ConnectionError):  # who sends nonsense may be cut off
            client.setblocking(False)
            for _ in range(self._chance.randrange(20)):
                self.pieces += 1
                client.send(nonsense(self._chance, 20_000))
        end = self._chance.randrange(4)
        if end == 0:
            cut(client)
        elif end == 1:
            client.close()
        else:
            self._open.append(client)
            if end == 2:
                with suppress(OSError):
                    client.shutdown(socket.SHUT_WR)
        while len(self._open) > MAX_OPEN:
            self._open.popleft().close()


class Honest:
    """A client that asks and is answered, whatever the others do.

    Attributes:
        calls: so many were answered.
        longest: s that one took.
    """

    def __init__(self, wait: Blocking, robot: Robot) -> None:
        self.calls, self.longest = 0, 0.0
        self._wait = wait
        self._robot = robot

    def ask(self) -> None:
        """Ask where the robot stands."""
        began = time.monotonic()
        position = self._wait(self._robot.execute("CurJnt"))
        assert isinstance(position, tuple)
        assert len(position) == 8
        self.calls += 1
        self.longest = max(self.longest, time.monotonic() - began)


@contextmanager
def stage(chance: random.Random) -> Iterator[tuple[Process, Hostility, Commander, Honest]]:
    """Run a simulator with clients of each kind; at the end it has to end by itself."""
    with simulator() as process:
        with Blocking() as wait:
            service = wait.enter(connect(over_tcp("127.0.0.1", process.port)))
            controller = wait(service.connect("", "CaoProv.DENSO.VRC", "localhost"))
            robot = wait(controller.get_robot("Arm"))
            honest = Honest(wait, robot)
            yield process, Hostility(process.port, chance), Commander(process.port, chance), honest
        print(process.end(signal.SIGINT)[-3000:])


def main() -> None:
    """Fuzz for so many seconds."""
    seconds = float(sys.argv[1])
    chance = random.Random(int(sys.argv[2]) if len(sys.argv) > 2 else 1)
    with stage(chance) as (process, hostility, commander, honest):
        start = shown = time.monotonic()
        while (now := time.monotonic()) - start < seconds:
            hostility.flood()
            hostility.intrude()
            commander.command()
            honest.ask()
            if now - shown > SHOWN_EACH:
                shown = now
                print(_figures(now - start, process, hostility, commander, honest), flush=True)
        print(_figures(time.monotonic() - start, process, hostility, commander, honest))


def _figures(
    seconds: float, process: Process, hostility: Hostility, commander: Commander, honest: Honest
) -> str:
    sent = f"{hostility.datagrams} datagrams {hostility.pieces} pieces"
    sent += f" {commander.calls} commands ({commander.replies} answered in time)"
    heard = f"{honest.calls} calls answered, the longest in {honest.longest:.2f} s"
    return f"{seconds:5.0f} s {sent}; {heard}; {state(process)}"


if __name__ == "__main__":
    main()
