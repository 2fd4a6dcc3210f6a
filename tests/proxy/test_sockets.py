"""What systems say of datagrams, and how it is said to people."""

from __future__ import annotations

import errno
import os
import socket
import struct
import sys
import time

import pytest

from bcapscope.proxy import sockets
from bcapscope.proxy.sockets import drops, kernel_time, prepare_datagrams, reason, receiver
from tests.proxy.relaying import datagrams


def test_the_kernels_time() -> None:
    stamp = struct.pack("@ll", 1_700_000_000, 123_456_789)
    assert kernel_time([(1, 35, stamp)], 5) == 1_700_000_000_123_456_789
    assert kernel_time([(1, 35, b"odd")], 5) == 5
    assert kernel_time([], 5) == 5
    assert abs(kernel_time([], 0) - time.time_ns()) < 10**9


@pytest.mark.skipif(sys.platform != "linux", reason="only Linux tells")
def test_datagrams_have_times_and_lost_ones_are_counted() -> None:
    with datagrams() as server, datagrams(to=server.getsockname()) as client:
        prepare_datagrams(server)
        client.send(b"x")
        data, control, _, address = receiver(server)(100, sockets.CONTROL)
        assert (data, address) == (b"x", client.getsockname())
        assert 0 <= time.time_ns() - kernel_time(control, 0) < 10**10
        assert drops(server) == 0
        server.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 2048)
        for _ in range(100):
            client.send(bytes(1000))
        assert drops(server) > 50


def test_without_recvmsg() -> None:
    with datagrams() as server, datagrams(to=server.getsockname()) as client:
        client.send(b"x")
        assert sockets._receive_plainly(server, 100, 0) == (b"x", [], 0, client.getsockname())


@pytest.mark.parametrize(
    ("error", "words"),
    [
        (OSError(errno.ECONNREFUSED, "Odd"), os.strerror(errno.ECONNREFUSED).lower()),
        (socket.gaierror(socket.EAI_NONAME, "Name or service not known"), "name or service not known"),
        (UnicodeError("label too long"), "label too long"),
    ],
)
def test_reasons(error: Exception, words: str) -> None:
    assert reason(error) == words
