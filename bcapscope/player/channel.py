"""A way to one peer and a clock, for a thread that does nothing else: it waits, sends and receives itself.

No event loop stands between a deadline and its packet.
"""

from __future__ import annotations

import select
import socket
import time
from contextlib import suppress
from typing import Protocol

from bcapscope.transport.peer_link import Address, BaseLink
from bcapscope.transport.receive_timestamps import (
    ANCILLARY_SIZE,
    AncillaryData,
    enable_receive_timestamps,
    kernel_timestamp,
    receive_function,
)
from bcapscope.transport.udp_link import preferred_address

SPIN_TIME = 200_000
"""ns before a deadline from which on the clock is watched instead of slept on: no sleep overruns as much."""

_DATAGRAM_SIZE = 4096
"""Bytes that a datagram may have; controllers send 503 at most."""

_STREAM_READ_SIZE = 512
"""Bytes of a stream that are taken at once, a few replies: a controller that was held up sends a hundred
together, and to read all of them takes longer than there is between two set points."""

_CLOCK_TOLERANCE = 100_000
"""ns by which two clocks may drift apart while nobody sets one: none, but looking at both takes a moment."""


class Channel(BaseLink, Protocol):
    """What the player sends through and waits with. All times are ns of `now`."""

    @property
    def arrival_time(self) -> int:
        """When what was received last came; where the system does not say, when it was read."""

    def now(self) -> int:
        """Return ns of a clock that does not go back."""

    def wait_until(self, until: int) -> None:
        """Return at `until`, as exactly as it can be done; at once if that is over."""

    def sleep_until(self, until: int) -> None:
        """Sleep until about then, whatever comes; at once back where nobody would tell when that came."""

    def receive(self, until: int) -> bytes | None:
        """Return what comes next, no more than is quickly read; None if nothing came until `until`.

        Raises:
            ConnectionRefusedError: the peer's system says that nobody listens; on UDP tries may go on.
            OSError: the way is gone.
        """


class SocketChannel:
    """A socket connected to its peer, so that the system drops what others send.

    Attributes:
        datagrams: UDP, else TCP.
        local: our end.
        peer: the other end.
        arrival_time: when what was received last came.
    """

    def __init__(self, sock: socket.socket) -> None:
        self.datagrams = sock.type == socket.SOCK_DGRAM
        self.local: Address = sock.getsockname()[:2]
        self.peer: Address = sock.getpeername()[:2]
        self._socket = sock
        self._readable = [sock]
        self._read_size = _DATAGRAM_SIZE if self.datagrams else _STREAM_READ_SIZE
        self.arrival_time = self.now()
        self._epoch_offset = _measure_epoch_offset()
        self._has_kernel_times = False
        self._recvmsg = receive_function(sock)
        enable_receive_timestamps(sock)
        sock.setblocking(False)
        if not self.datagrams:
            sock.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)

    now = staticmethod(time.monotonic_ns)

    def wait_until(self, until: int) -> None:
        """Sleep, and spin for the last of it."""
        clock = time.monotonic_ns
        rest = until - SPIN_TIME - clock()
        if rest > 0:
            time.sleep(rest / 1e9)  # until the set point is due there is nothing to do
        while clock() < until:
            pass

    def sleep_until(self, until: int) -> None:
        """Sleep, where the system tells when what comes meanwhile came."""
        length = until - time.monotonic_ns()
        if self._has_kernel_times and length > 0:
            time.sleep(length / 1e9)  # nothing that comes is needed before

    def send(self, data: bytes) -> None:
        """Send; a stream takes all of it or is gone."""
        if self.datagrams:
            # Lost on the way, or word of an earlier packet: both are what tries are for.
            with suppress(BlockingIOError, ConnectionRefusedError):
                self._socket.send(data)
        else:
            self._socket.sendall(data)

    def receive(self, until: int) -> bytes | None:
        """Look first, then wait."""
        while True:
            try:
                data, control, _, _ = self._recvmsg(self._read_size, ANCILLARY_SIZE)
            except BlockingIOError:
                pass
            else:
                self._set_arrival_time(control)
                if data or self.datagrams:
                    return data
                raise ConnectionResetError("the peer closed the connection")
            rest = until - time.monotonic_ns()
            if rest <= 0:
                return None
            select.select(self._readable, (), (), rest / 1e9)

    def close(self) -> None:
        """Close the socket."""
        self._socket.close()

    def _set_arrival_time(self, control: AncillaryData) -> None:
        now = self.arrival_time = time.monotonic_ns()
        self._has_kernel_times = bool(control)
        if abs(time.time_ns() - now - self._epoch_offset) > _CLOCK_TOLERANCE:
            self._epoch_offset = (
                _measure_epoch_offset()
            )  # the clock by which the system tells was set, or we were held up just now
        elif control:
            self.arrival_time = min(now, kernel_timestamp(control, 0) - self._epoch_offset)


def _measure_epoch_offset() -> int:
    """Return the time, ns since 1970, when the clock of `now` was 0; the fastest of five readings counts."""
    return max(time.time_ns() - time.monotonic_ns() for _ in range(5))


def open_channel(host: str, port: int, tcp: bool, timeout: float = 5.0, local_port: int = 0) -> SocketChannel:
    """Open a way to a controller.

    Args:
        host: name or address.
        port: of the controller.
        tcp: TCP instead of UDP.
        timeout: seconds to connect in.
        local_port: to send from over UDP; 0 for any.

    Raises:
        OSError: there is no such host, no way to it, or nobody listens.
    """
    sock = (
        socket.create_connection((host, port), timeout) if tcp else _connect_datagrams(host, port, local_port)
    )
    try:
        return SocketChannel(sock)
    except OSError:  # the controller has reset the connection already
        sock.close()
        raise


def _connect_datagrams(host: str, port: int, local_port: int) -> socket.socket:
    found = socket.getaddrinfo(host, port, type=socket.SOCK_DGRAM)
    family, kind, protocol, _, address = preferred_address(found)
    sock = socket.socket(family, kind, protocol)
    try:
        if local_port:
            sock.bind(("", local_port))
        sock.connect(address)
    except OSError:
        sock.close()
        raise
    return sock
