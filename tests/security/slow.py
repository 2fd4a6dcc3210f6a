"""Clients that send one byte a second: of their first frame, or of a later one.

Run as ``python -m tests.security.slow``.
"""

from __future__ import annotations

import socket
import sys
import time
from contextlib import suppress

from bcapscope.protocol.codec.frame import encode_frame
from bcapscope.protocol.codec.variant import VT, Variant
from tests.cli.proxying import simulator
from tests.security.connections import BUSIEST
from tests.security.harness import Outcome, allow_descriptors, attacker, proxied, under_attack

_START = encode_frame(1, 0, 1, (Variant(VT.BSTR, ""),))
_RESERVED = 50


def attack(port: int, count: int, pause_ms: int) -> None:
    """Send a byte on each of so many connections, pause, and again; never return.

    One in ten of the connections has sent a whole frame before.
    """
    count = min(count, allow_descriptors(count + _RESERVED) - _RESERVED)
    socks: list[socket.socket | None] = [None] * count
    step = 0
    while True:
        for number, known in enumerate(socks):
            sock = known or _connect(port, whole=number % 10 == 0)
            try:
                sock.send(_START[step % len(_START) :][:1])
            except OSError:  # the connection was closed
                sock.close()
                socks[number] = None
            else:
                socks[number] = sock
        step += 1
        if step == 1:
            print("under way", flush=True)
        time.sleep(pause_ms / 1000)


def _connect(port: int, *, whole: bool) -> socket.socket:
    """Connect; perhaps send a whole frame."""
    sock = socket.create_connection(("127.0.0.1", port))
    sock.setblocking(False)
    if whole:
        with suppress(OSError):  # it was closed at once
            sock.send(_START)
    return sock


def withstand(count: int, seconds: float, pause_ms: int) -> list[Outcome]:
    """Attack a proxy and a simulator; return the figures."""
    outcomes = [
        under_attack(
            f"{count} slow connections to {name}",
            server,
            lambda port: attacker("tests.security.slow", port, count, pause_ms),
            seconds=seconds,
        )
        for name, server in (("proxy", proxied("-q")), ("sim", simulator()))
    ]
    assert all(each.busy < BUSIEST for each in outcomes), [each.line for each in outcomes]
    return outcomes


def main() -> None:
    """Run the attack in its full size."""
    withstand(500, 15.0, 1000)


if __name__ == "__main__":
    if sys.argv[1:2] == ["attack"]:
        attack(*map(int, sys.argv[2:]))
    main()
