"""A link to one peer and a clock, for a thread that waits, sends and receives without an event loop.

An event loop could delay a packet beyond its deadline.
"""

from __future__ import annotations

import select
import socket
import time
from contextlib import suppress

from bcapscope.messages import Message
from bcapscope.transport.peer_link import Address
from bcapscope.transport.receive_timestamps import (
    ANCILLARY_SIZE,
    AncillaryData,
    enable_receive_timestamps,
    kernel_timestamp,
    receive_function,
)
from bcapscope.transport.socket_link import preferred_address

SPIN_TIME = 200_000
"""Time in ns before a deadline from which the thread watches the clock; sleeps overrun by less."""

_DATAGRAM_SIZE = 4096
"""Largest datagram in bytes; controllers send at most 503."""

_STREAM_READ_SIZE = 512
"""Maximum number of bytes read from a stream at once, enough for a few replies. After a delay, a controller
sends a hundred replies together. Reading all of them takes longer than the time between two set points."""

_CONNECT_TIMEOUT = 5.0  # seconds

_CLOCK_TOLERANCE = 100_000
"""Change of the difference between both clocks, in ns, that shows a set clock or a delayed thread."""


class Channel:
    """A socket connected to the controller, so that the system drops datagrams from others.

    Times are ns of the monotonic clock `now`. `arrival_time` is that of the bytes received last, or the time
    of reading if the system gives none. Every method raises OSError if the link is gone.
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
        """Wait until a time as exactly as possible: sleep first, then watch the clock."""
        clock = time.monotonic_ns
        rest = until - SPIN_TIME - clock()
        if rest > 0:
            time.sleep(rest / 1e9)  # there is nothing to do until the set point is due
        while clock() < until:
            pass

    def sleep_until(self, until: int) -> None:
        """Sleep until about `until`, but only if the system records when data arrives."""
        length = until - time.monotonic_ns()
        if self._has_kernel_times and length > 0:
            time.sleep(length / 1e9)  # data that arrives during the sleep is not needed before its end

    def send(self, data: bytes) -> None:
        """Send bytes; on a stream, either all bytes are sent or the connection fails."""
        if self.datagrams:
            # The datagram is lost, or an earlier datagram reached a closed port; retries handle both cases.
            with suppress(BlockingIOError, ConnectionRefusedError):
                self._socket.send(data)
        else:
            self._socket.sendall(data)

    def receive(self, until: int) -> bytes | None:
        """Return a small portion of the next bytes; None if nothing arrives until the time `until`.

        Raises ConnectionRefusedError if the peer's port is closed; over UDP, retries may continue.
        """
        while True:
            try:
                data, control, _, _ = self._recvmsg(self._read_size, ANCILLARY_SIZE)
            except BlockingIOError:
                pass
            else:
                self._set_arrival_time(control)
                if data or self.datagrams:
                    return data
                raise ConnectionResetError(Message("connection.closed-by-peer"))
            rest = until - time.monotonic_ns()
            if rest <= 0:
                return None
            select.select(self._readable, (), (), rest / 1e9)

    def close(self) -> None:
        self._socket.close()

    def _set_arrival_time(self, control: AncillaryData) -> None:
        now = self.arrival_time = time.monotonic_ns()
        self._has_kernel_times = bool(control)
        if abs(time.time_ns() - now - self._epoch_offset) > _CLOCK_TOLERANCE:
            # The two clocks differ: the system's clock was set, or this thread was delayed just now.
            self._epoch_offset = _measure_epoch_offset()
        elif control:
            self.arrival_time = min(now, kernel_timestamp(control, 0) - self._epoch_offset)


def _measure_epoch_offset() -> int:
    """Return the time in ns since 1970 at which `now` was 0, from the fastest of five readings."""
    return max(time.time_ns() - time.monotonic_ns() for _ in range(5))


def open_channel(host: str, port: int, tcp: bool, local_port: int = 0) -> Channel:
    """Open a channel, from any local UDP port if `local_port` is 0; raise OSError if the host is unknown."""
    if tcp:
        sock = socket.create_connection((host, port), _CONNECT_TIMEOUT)
    else:
        sock = _connect_datagrams(host, port, local_port)
    try:
        return Channel(sock)
    except OSError:  # the controller has already reset the connection
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
