"""A flood of UDP requests, each from a port that was never heard before.

Run as ``python -m tests.security.sources``.
"""

from __future__ import annotations

import socket
import sys
import time

from bcapscope.protocol.codec.frame import encode_frame
from bcapscope.protocol.codec.variant import VT, Variant
from tests.cli.proxying import simulator
from tests.security.connections import BUSIEST
from tests.security.harness import Outcome, attacker, proxied, under_attack

_START = encode_frame(1, 0, 1, (Variant(VT.BSTR, ""),))


def attack(port: int, pause_us: int) -> None:
    """Send a request from a new port, pause, and again; never return."""
    sent = 0
    while True:
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sock:
            sock.sendto(_START, ("127.0.0.1", port))
        sent += 1
        if sent == 300:
            print("under way", flush=True)
        time.sleep(pause_us / 1e6)


def withstand(seconds: float, pause_us: int) -> list[Outcome]:
    """Attack a proxy and a simulator; return the figures."""
    outcomes = [
        under_attack(
            f"datagrams from ever new ports to {name}",
            server,
            lambda port: attacker("tests.security.sources", port, pause_us),
            seconds=seconds,
            transport="udp",
        )
        for name, server in (("proxy", proxied("-q")), ("sim", simulator()))
    ]
    assert all(each.busy < BUSIEST for each in outcomes), [each.line for each in outcomes]
    return outcomes


def main() -> None:
    """Run the attack in its full size."""
    withstand(5.0, 100)


if __name__ == "__main__":
    if sys.argv[1:2] == ["attack"]:
        attack(*map(int, sys.argv[2:]))
    main()
