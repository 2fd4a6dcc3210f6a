"""A relay in a thread, on free ports of this machine, and what it tells."""

from __future__ import annotations

import socket
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager

from bcapscope.proxy.listener_spec import parse_listener_specs
from bcapscope.proxy.listeners import open_listeners
from bcapscope.proxy.pending_connections import Admit, PendingConnections
from bcapscope.proxy.relay import Relay
from bcapscope.proxy.ring_buffer import RING_OVERHEAD, RingReader, RingRecord, RingRecordKind, RingWriter
from bcapscope.proxy.rule_policy import RulePolicy
from bcapscope.proxy.sockets import SocketAddress
from bcapscope.proxy.udp_listener import EXPIRE_AFTER_NS
from bcapscope.traffic.observation import Endpoint
from tests.english import decoded

PATIENCE = 20.0
"""Seconds that anything may take on a busy machine."""


def eventually(test: Callable[[], object], what: str = "it") -> None:
    """Wait until `test` is true."""
    until = time.monotonic() + PATIENCE
    while not test():
        assert time.monotonic() < until, f"{what} did not happen"
        time.sleep(0.005)


class OpenEntrance(PendingConnections):
    """Admits clients before they have said anything, for tests of what becomes of clients."""

    def add(self, client: socket.socket, address: SocketAddress, admit: Admit) -> None:
        admit(client, address, b"", time.time_ns())


class Running:
    """A relay that runs.

    Attributes:
        relay: itself.
        address: where it listens.
        records: what it told so far, as far as `look` was called.
    """

    def __init__(self, relay: Relay, address: Endpoint, reader: RingReader) -> None:
        self.relay = relay
        self._thread = threading.Thread(target=relay.run)
        self._thread.start()
        self.address = address
        self.records: list[RingRecord] = []
        self._reader = reader

    def stop(self) -> None:
        """Pass nothing on any more."""
        self.relay.stop()
        self._thread.join(PATIENCE)

    def look(self) -> list[RingRecord]:
        """Take what was told."""
        self.records += self._reader.read_records()
        return self.records

    def of(self, kind: RingRecordKind) -> list[RingRecord]:
        """Return the records of one kind."""
        return [record for record in self.look() if record.kind is kind]

    def passed(self, up: bool) -> list[bytes]:
        """Return the bytes of one direction."""
        return [record.data for record in self.of(RingRecordKind.DATA) if record.up is up]

    def notices(self) -> str:
        """Return the messages for the user."""
        return "\n".join(decoded(record.data) for record in self.of(RingRecordKind.NOTICE))


@contextmanager
def running(
    to: int,
    transport: str = "both",
    *,
    allow: Sequence[str] = (),
    policy: RulePolicy | None = None,
    forget_after: int = EXPIRE_AFTER_NS,
    size: int = 1 << 20,
    waits: bool = False,
) -> Iterator[Running]:
    """Run a relay to a port of this machine for the length of a block.

    Args:
        to: the port.
        transport: to listen on.
        allow: whence clients may come.
        policy: the rules.
        forget_after: ns of silence after which UDP clients are forgotten.
        size: bytes of the ring.
        waits: TCP clients wait for their first frame to be complete, as in real life.
    """
    memory = memoryview(bytearray(RING_OVERHEAD + size))
    relay = Relay(RingWriter(memory), policy)
    if not waits:
        relay.pending_connections = OpenEntrance(relay)
    (listener,) = parse_listener_specs(["127.0.0.1:0"], [f"127.0.0.1:{to}"], transport, allow)
    address, ports = open_listeners(relay, listener, forget_after)
    relay.listen(ports)
    it = Running(relay, address, RingReader(memory))
    try:
        yield it
    finally:
        it.stop()
        relay.close()


@contextmanager
def datagrams(port: int = 0, to: Endpoint | None = None) -> Iterator[socket.socket]:
    """Open a UDP socket."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sock:
        sock.settimeout(PATIENCE)
        sock.bind(("127.0.0.1", port))
        if to is not None:
            sock.connect(to)
        yield sock


@contextmanager
def listening() -> Iterator[socket.socket]:
    """Open a TCP socket that takes connections."""
    with socket.create_server(("127.0.0.1", 0)) as sock:
        sock.settimeout(PATIENCE)
        yield sock


def port_of(sock: socket.socket) -> int:
    """Return the port of a socket."""
    return int(sock.getsockname()[1])
