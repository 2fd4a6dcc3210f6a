"""What systems say of datagrams, and how it is said to people."""

from __future__ import annotations

import errno
import os
import select
import socket
import sys
import time
from contextlib import suppress

import pytest

from bcapscope.messages.os_errors import os_reason
from bcapscope.proxy.sockets import (
    RECEIVE_BUFFER,
    SO_RCVBUFFORCE,
    ProxyListenError,
    UnreachableError,
    connect_datagrams,
    dropped_datagrams,
    keep_alive,
    listen_on,
    local_address_for,
    prepare_datagrams,
    resolve,
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


@pytest.mark.parametrize("transport", Transport)
@pytest.mark.parametrize("host", ["127.0.0.1", "::1"])
def test_a_socket_for_clients_blocks_nobody_and_leaves_other_families_alone(
    host: str, transport: Transport
) -> None:
    with listen_on(Endpoint(host, 0), transport) as sock:
        assert sock.gettimeout() == 0.0
        assert sock.getsockname()[0] == host
        if host == "::1":
            assert sock.getsockopt(socket.IPPROTO_IPV6, socket.IPV6_V6ONLY)
        if transport is Transport.TCP and sys.platform == "linux":
            assert sock.getsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR)


@pytest.mark.skipif(sys.platform != "linux", reason="buffers and times differ elsewhere")
def test_a_socket_toward_the_controller_has_times_and_room() -> None:
    with datagrams() as server, datagrams() as plain:
        family, address = resolve(Endpoint(*server.getsockname()), Transport.UDP)
        with connect_datagrams(family, address) as sock:
            assert (sock.gettimeout(), sock.getpeername()) == (0.0, server.getsockname())
            usual = plain.getsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF)
            plain.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, RECEIVE_BUFFER)
            with suppress(PermissionError):  # without root, the system's limit applies to both sockets
                plain.setsockopt(socket.SOL_SOCKET, SO_RCVBUFFORCE, RECEIVE_BUFFER)
            room, largest = (each.getsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF) for each in (sock, plain))
            assert usual < room == largest
            server.sendto(b"x", sock.getsockname())
            assert select.select([sock], (), (), 10)[0]
            _, control, _, _ = receive_function(sock)(100, ANCILLARY_SIZE)
            assert kernel_timestamp(control, 0)


@pytest.mark.parametrize("transport", Transport)
def test_a_controller_has_an_address(transport: Transport) -> None:
    assert resolve(Endpoint("127.0.0.1", 5007), transport) == (socket.AF_INET, ("127.0.0.1", 5007))
    with pytest.raises(UnreachableError, match="no-such-host"):
        resolve(Endpoint("no-such-host.invalid", 5007), transport)


@pytest.mark.parametrize(("listens", "reached"), [("127.0.0.1", "127.0.0.1"), ("0.0.0.0", "127.0.0.1")])
def test_a_client_reaches_the_address_that_leads_to_it(listens: str, reached: str) -> None:
    with listen_on(Endpoint(listens, 0), Transport.UDP) as sock, datagrams() as client:
        port = sock.getsockname()[1]
        assert local_address_for(sock, client.getsockname()) == Endpoint(reached, port)
