"""Thousands of TCP connections that say nothing, and new ones all the time.

Run as ``python -m tests.security.connections``.
"""

from __future__ import annotations

import socket
import sys
import time
from collections import deque
from contextlib import suppress

from tests.cli.proxying import simulator
from tests.security.harness import Outcome, allow_descriptors, attacker, proxied, under_attack

BUSIEST = 0.9
"""Share of a processor that an attack may cost; a loop without a wait takes all of it."""

_RESERVED = 50
_RENEWED_EACH = 0.001


def attack(port: int, count: int) -> None:
    """Hold so many silent connections, then make a new one each millisecond; never return."""
    count = min(count, allow_descriptors(count + _RESERVED) - _RESERVED)
    held: deque[socket.socket] = deque()
    while len(held) < count:
        held.append(_connect(port))
    print("under way", flush=True)
    while True:
        held.popleft().close()
        held.append(_connect(port))
        time.sleep(_RENEWED_EACH)


def _connect(port: int) -> socket.socket:
    sock = socket.socket()
    sock.setblocking(False)
    with suppress(BlockingIOError):
        sock.connect(("127.0.0.1", port))
    return sock


def withstand(count: int, seconds: float) -> list[Outcome]:
    """Attack a proxy and a simulator; return the figures."""
    outcomes = [
        under_attack(
            f"{count} silent connections to {name}",
            server,
            lambda port: attacker("tests.security.connections", port, count),
            seconds=seconds,
        )
        for name, server in (("proxy", proxied("-q")), ("sim", simulator()))
    ]
    assert all(each.busy < BUSIEST for each in outcomes), [each.line for each in outcomes]
    return outcomes


def main() -> None:
    """Run the attack in its full size."""
    withstand(2000, 5.0)


if __name__ == "__main__":
    if sys.argv[1:2] == ["attack"]:
        attack(*map(int, sys.argv[2:]))
    main()
