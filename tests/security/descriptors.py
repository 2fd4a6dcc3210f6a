"""Processes that may open only a few files, and more clients than they have file descriptors for.

Run as ``python -m tests.security.descriptors``.
"""

from __future__ import annotations

import socket
import sys
import time
from contextlib import ExitStack

from bcapscope.protocol.codec.frame import encode_frame
from bcapscope.protocol.codec.variant import VT, Variant
from tests.cli.proxying import simulator
from tests.security.connections import BUSIEST
from tests.security.harness import HALT_LIMIT, PATIENCE, Outcome, attacker, proxied, under_attack

_START = encode_frame(1, 0, 1, (Variant(VT.BSTR, ""),))
_HALT = encode_frame(2, 0, 70, (Variant(VT.I4, 1), Variant(VT.BSTR, "")))
_RENEWED_EACH = 0.01


def attack(port: int, count: int) -> None:
    """Keep so many TCP clients, half of them silent, and as many UDP clients; never return."""
    streams: list[socket.socket | None] = [None] * count
    datagrams = [socket.socket(socket.AF_INET, socket.SOCK_DGRAM) for _ in range(count)]
    shown = False
    while True:
        for number, known in enumerate(streams):
            streams[number] = sock = known or _connect(port, number)
            datagrams[number].sendto(_START, ("127.0.0.1", port))
            if _has_ended(sock):
                sock.close()
                streams[number] = None
            time.sleep(_RENEWED_EACH)
        if not shown:
            shown = True
            print("under way", flush=True)


def _connect(port: int, number: int) -> socket.socket:
    sock = socket.socket()
    sock.settimeout(1.0)
    try:
        sock.connect(("127.0.0.1", port))
        if number % 2:
            sock.sendall(_START)
    except OSError:  # closed at once, or nobody takes connections: it has ended, as will be seen
        pass
    sock.setblocking(False)
    return sock


def _has_ended(sock: socket.socket) -> bool:
    try:
        return not sock.recv(1024)
    except BlockingIOError:
        return False
    except OSError:
        return True


def withstand(count: int, seconds: float, descriptors: int = 24) -> list[Outcome]:
    """Attack a proxy and a simulator that may open so many files; return the figures."""
    outcomes = [
        under_attack(
            f"{count} clients of a {name} with {descriptors} file descriptors",
            server,
            lambda port: attacker("tests.security.descriptors", port, count),
            seconds=seconds,
        )
        for name, server in (
            ("proxy", proxied("-q", "--control", "127.0.0.1:0", descriptors=descriptors)),
            ("sim", simulator(descriptors=descriptors)),
        )
    ]
    assert all(each.busy < BUSIEST for each in outcomes), [each.line for each in outcomes]
    return outcomes


def stop_each(count: int, descriptors: int = 40) -> None:
    """Take all file descriptors, then send stops from ever new TCP clients that stay; each is answered."""
    for name, server in (
        ("proxy", proxied("-q", "--control", "127.0.0.1:0", descriptors=descriptors)),
        ("sim", simulator(descriptors=descriptors)),
    ):
        with server as process, ExitStack() as stack:
            for _ in range(descriptors):
                stack.enter_context(_connect(process.port, 1))
            delays = [_stop(stack.enter_context(socket.socket()), process.port) for _ in range(count)]
            print(f"{count} stops of a {name}: {max(delays) * 1e3:.0f} ms at most", flush=True)
            assert max(delays) < HALT_LIMIT


def _stop(sock: socket.socket, port: int) -> float:
    """Send Robot_Halt once; return the seconds until its reply."""
    began = time.monotonic()
    sock.settimeout(PATIENCE)
    sock.connect(("127.0.0.1", port))
    sock.sendall(_HALT)
    assert sock.recv(1024), "a stop was not answered"
    return time.monotonic() - began


def main() -> None:
    """Run the attacks in their full size."""
    withstand(60, 5.0)
    stop_each(200)


if __name__ == "__main__":
    if sys.argv[1:2] == ["attack"]:
        attack(*map(int, sys.argv[2:]))
    main()
