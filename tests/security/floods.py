"""Bombs sent to a running `sim` and `proxy`: packed frames, unfinished frames and long ones, over UDP and
TCP.

An honest client calls meanwhile. Run as ``python -m tests.security.floods``.
"""

from __future__ import annotations

import socket
import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager, suppress

from bcapscope.protocol.codec.frame_content import LARGEST_UNPACKED
from tests.cli.proxying import Process, proxy, simulator
from tests.security.bombs import (
    ARRAY,
    ELEMENTS,
    EXECUTE,
    HANDLE,
    MEGABYTE,
    UI1,
    argument,
    command,
    compressed,
    frame,
    payload,
)
from tests.security.harness import Outcome, under_attack

CLIENTS = 8
_PAUSE = 0.25  # seconds between two messages of each client
_FAULTS = ("--fault", "delay=200ms if arg[2] contains 3", "--read-only", "--intercept", "arg[2] contains 3")


def _requests() -> list[bytes]:
    """Return requests that unpack to as much as is read, and fit into a datagram."""
    packed = [
        frame(1, EXECUTE, HANDLE, command("slvMove"), payload(name, LARGEST_UNPACKED - 200))
        for name in ELEMENTS
    ]
    return [raw for raw in map(compressed, packed) if len(raw) < 60_000]


def _unfinished() -> list[bytes]:
    """Return the beginnings of frames of 16 MB."""
    whole = frame(1, EXECUTE, argument(ARRAY | UI1, 15 * MEGABYTE, bytes(15 * MEGABYTE)))
    return [whole[:MEGABYTE], *(whole[at : at + MEGABYTE] for at in range(MEGABYTE, 14 * MEGABYTE, MEGABYTE))]


def _send_datagrams(port: int, stopping: threading.Event) -> None:
    messages = _requests()
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as client:
        client.connect(("127.0.0.1", port))
        number = 0
        while not stopping.wait(_PAUSE):
            number += 1
            raw = messages[number % len(messages)]
            with suppress(OSError):
                client.send(raw[:5] + number.to_bytes(2, "little") + raw[7:])


def _send_streams(pieces: list[bytes]) -> Callable[[int, threading.Event], None]:
    def send(port: int, stopping: threading.Event) -> None:
        while not stopping.is_set():
            with suppress(OSError), socket.create_connection(("127.0.0.1", port), timeout=1) as client:
                for piece in pieces:
                    if stopping.wait(_PAUSE):
                        return
                    client.sendall(piece)
                stopping.wait(1)

    return send


def flood(
    send: Callable[[int, threading.Event], None], clients: int
) -> Callable[[int], AbstractContextManager[None]]:
    """Return an attack by so many clients."""

    @contextmanager
    def attack(port: int) -> Iterator[None]:
        stopping = threading.Event()
        threads = [threading.Thread(target=send, args=(port, stopping), daemon=True) for _ in range(clients)]
        for thread in threads:
            thread.start()
        try:
            yield
        finally:
            stopping.set()
            for thread in threads:
                thread.join(10)

    return attack


@contextmanager
def _proxied(*words: str) -> Iterator[Process]:
    with simulator() as behind, proxy(behind.port, "-q", *words) as process:
        yield process


_FLOODS: dict[str, Callable[[], Callable[[int, threading.Event], None]]] = {
    "packed datagrams": lambda: _send_datagrams,
    "packed frames": lambda: _send_streams(_requests()),
    "unfinished frames": lambda: _send_streams(_unfinished()),
}
_SERVERS: dict[str, Callable[[], AbstractContextManager[Process]]] = {
    "sim": simulator,
    "proxy": _proxied,
    "proxy with rules": lambda: _proxied(*_FAULTS),
}


def names() -> list[str]:
    """Return the names of the attacks."""
    return [f"{name} to {server}" for server in _SERVERS for name in _FLOODS]


def attack(name: str, seconds: float, clients: int = CLIENTS) -> Outcome:
    """Attack `sim`, `proxy`, or `proxy` with rules; return what an honest client saw."""
    what, server = name.split(" to ")
    return under_attack(name, _SERVERS[server](), flood(_FLOODS[what](), clients), seconds=seconds)


def main() -> None:
    """Attack for five seconds each."""
    failed = []
    for name in names():
        try:
            attack(name, 5.0)
        except AssertionError as error:
            print(f"{name}: {error}", flush=True)
            failed.append(name)
    sys.exit(bool(failed))


if __name__ == "__main__":
    main()
