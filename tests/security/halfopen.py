"""Clients that end their side of the connection, or whose connection the controller ends, and stay.

Run as ``python -m tests.security.halfopen``.
"""

from __future__ import annotations

import socket
import sys
import time
from collections import deque
from contextlib import suppress

from bcapscope.protocol.codec.frame import encode_frame
from bcapscope.protocol.codec.variant import VT, Variant
from tests.cli.proxying import simulator
from tests.security.connections import BUSIEST
from tests.security.harness import Outcome, allow_descriptors, attacker, proxied, under_attack

_START = encode_frame(1, 0, 1, (Variant(VT.BSTR, ""),))
_DAMAGED = _START[:-1] + b"\x05"
_RESERVED = 50
_RENEWED_EACH = 0.002


def attack(port: int, count: int) -> None:
    """Keep so many connections half open, of each kind as many, and renew them; never return."""
    count = min(count, allow_descriptors(count + _RESERVED) - _RESERVED)
    held: deque[socket.socket] = deque()
    number = 0
    while True:
        sock = socket.create_connection(("127.0.0.1", port))
        held.append(sock)
        with suppress(OSError):  # it was closed already
            if number % 4 < 2:
                sock.sendall(_START)
            elif number % 4 == 2:
                sock.sendall(_DAMAGED)  # the controller closes the connection; this side stays
            if number % 4 in (0, 3):
                sock.shutdown(socket.SHUT_WR)
        number += 1
        if number == count:
            print("under way", flush=True)
        if number >= count:
            held.popleft().close()
            time.sleep(_RENEWED_EACH)


def withstand(count: int, seconds: float) -> list[Outcome]:
    """Attack a proxy and a simulator; return the figures."""
    outcomes = [
        under_attack(
            f"{count} half-open connections to {name}",
            server,
            lambda port: attacker("tests.security.halfopen", port, count),
            seconds=seconds,
        )
        for name, server in (("proxy", proxied("-q")), ("sim", simulator()))
    ]
    assert all(each.busy < BUSIEST for each in outcomes), [each.line for each in outcomes]
    return outcomes


def main() -> None:
    """Run the attack in its full size."""
    withstand(1000, 10.0)


if __name__ == "__main__":
    if sys.argv[1:2] == ["attack"]:
        attack(*map(int, sys.argv[2:]))
    main()
