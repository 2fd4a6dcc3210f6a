"""What systems say of datagrams, and how it is said to people."""

from __future__ import annotations

import errno
import os
import socket
import sys
import time

import pytest

from bcapscope.messages.os_errors import os_reason
from bcapscope.proxy.sockets import (
    ProxyListenError,
    dropped_datagrams,
    keep_alive,
    listen_on,
    prepare_datagrams,
)
from bcapscope.traffic.observation import Endpoint, Transport
from bcapscope.transport.receive_timestamps import ANCILLARY_SIZE, kernel_timestamp, receive_function
from tests.proxy.relaying import datagrams


@pytest.mark.skipif(sys.platform != "linux", reason="only Linux tells")
def test_datagrams_have_times_and_lost_ones_are_counted() -> None:
    with datagrams() as server, datagrams(to=server.getsockname()) as client:
        prepare_datagrams(server)
        client.send(b"x")
        data, control, _, address = receive_function(server)(100, ANCILLARY_SIZE)
        assert (data, address) == (b"x", client.getsockname())
        assert 0 <= time.time_ns() - kernel_timestamp(control, 0) < 10**10
        assert dropped_datagrams(server) == 0
        server.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 2048)
        for _ in range(100):
            client.send(bytes(1000))
        assert dropped_datagrams(server) > 50


def test_a_closed_socket_has_dropped_nothing() -> None:
    with datagrams() as sock:
        pass
    assert dropped_datagrams(sock) == 0


@pytest.mark.parametrize(
    ("error", "words"),
    [
        (OSError(errno.ECONNREFUSED, "Odd"), os.strerror(errno.ECONNREFUSED).lower()),
        (socket.gaierror(socket.EAI_NONAME, "Name or service not known"), "name or service not known"),
        (UnicodeError("label too long"), "label too long"),
    ],
)
def test_reasons(error: Exception, words: str) -> None:
    assert str(os_reason(error)) == words


@pytest.mark.parametrize("transport", Transport)
def test_a_name_is_no_address_to_listen_on(transport: Transport) -> None:
    with pytest.raises(ProxyListenError, match="localhost"):
        listen_on(Endpoint("localhost", 0), transport)


def test_a_peer_that_has_vanished_is_noticed_within_minutes() -> None:
    with socket.socket(socket.AF_INET, socket.SOCK_STREAM) as sock:
        keep_alive(sock)
        assert sock.getsockopt(socket.SOL_SOCKET, socket.SO_KEEPALIVE)
        if hasattr(socket, "TCP_KEEPIDLE"):
            idle, interval, count = (
                sock.getsockopt(socket.IPPROTO_TCP, option)
                for option in (socket.TCP_KEEPIDLE, socket.TCP_KEEPINTVL, socket.TCP_KEEPCNT)
            )
            assert idle + interval * count == 120
