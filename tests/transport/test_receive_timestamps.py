"""When datagrams came."""

from __future__ import annotations

import socket
import struct
import sys
import time

import pytest

from bcapscope.transport import receive_timestamps
from bcapscope.transport.receive_timestamps import (
    ANCILLARY_SIZE,
    enable_receive_timestamps,
    kernel_timestamp,
    receive_function,
)


def pair() -> tuple[socket.socket, socket.socket]:
    """Open two sockets, the second of which sends to the first."""
    server, client = socket.socket(type=socket.SOCK_DGRAM), socket.socket(type=socket.SOCK_DGRAM)
    server.bind(("127.0.0.1", 0))
    client.connect(server.getsockname())
    server.settimeout(5)
    return server, client


def test_the_kernels_time() -> None:
    stamp = struct.pack("@ll", 1_700_000_000, 123_456_789)
    assert kernel_timestamp([(1, 35, stamp)], 5) == 1_700_000_000_123_456_789
    assert kernel_timestamp([(1, 35, b"odd")], 5) == 5
    assert kernel_timestamp([], 5) == 5
    assert abs(kernel_timestamp([], 0) - time.time_ns()) < 10**9


@pytest.mark.skipif(sys.platform != "linux", reason="only Linux tells")
def test_the_time_is_that_of_the_arrival() -> None:
    server, client = pair()
    with server, client:
        enable_receive_timestamps(server)
        client.send(b"x")
        sent = time.time_ns()
        data, control, _, address = receive_function(server)(100, ANCILLARY_SIZE)
        assert (data, address) == (b"x", client.getsockname())
        assert control
        assert 0 <= sent - kernel_timestamp(control, 0) < 10**10


def test_without_recvmsg() -> None:
    server, client = pair()
    with server, client:
        client.send(b"x")
        assert receive_timestamps._receive_without_ancillary(server, 100, 0) == (
            b"x",
            [],
            0,
            client.getsockname(),
        )
