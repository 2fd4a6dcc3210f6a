"""Listening on what is said, or on what is free."""

from __future__ import annotations

import errno
import os
import socket
from contextlib import suppress

import pytest

from bcapscope.messages.message import foreign_text
from bcapscope.proxy.listener_spec import ListenerSpec, parse_listener_specs
from bcapscope.proxy.listeners import open_listeners
from bcapscope.proxy.relay import Relay
from bcapscope.proxy.ring_buffer import RING_OVERHEAD, RingWriter
from bcapscope.proxy.sockets import ProxyListenError, UnreachableError
from bcapscope.proxy.udp_listener import UdpListener
from bcapscope.traffic.observation import Endpoint
from tests.proxy.relaying import listening, port_of


def opened(listen: str, to: str = "127.0.0.1:5007", transport: str = "both") -> tuple[Endpoint, int]:
    """Open ports, let go of them, and return where and how many they were."""
    relay = Relay(RingWriter(memoryview(bytearray(RING_OVERHEAD + 4096))))
    (listener,) = parse_listener_specs([listen], [to], transport)
    address, ports = open_listeners(relay, listener)
    relay.listen(ports)
    relay.close()
    return address, len(ports)


def test_a_free_port_is_free_on_both() -> None:
    address, count = opened("127.0.0.1:0")
    assert address.port
    assert count == 2


def test_a_port_that_is_free_on_one_transport_alone_is_not_chosen(monkeypatch: pytest.MonkeyPatch) -> None:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as taken:
        tried: list[int] = []

        def open_udp(relay: Relay, spec: ListenerSpec, forget_after: int) -> UdpListener:
            tried.append(spec.listen.port)
            if len(tried) == 1:
                with suppress(OSError):  # another program has it already
                    taken.bind(("127.0.0.1", spec.listen.port))
            return UdpListener(relay, spec, forget_after)

        monkeypatch.setattr("bcapscope.proxy.listeners.UdpListener", open_udp)
        address, count = opened("127.0.0.1:0")
    assert count == 2
    assert address.port != tried[0]


def test_after_twenty_ports_that_are_free_on_one_transport_alone_the_error_is_raised(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    tried: list[int] = []

    def open_udp(relay: Relay, spec: ListenerSpec, forget_after: int) -> UdpListener:
        tried.append(spec.listen.port)
        raise ProxyListenError(foreign_text(f"attempt {len(tried)}"))

    monkeypatch.setattr("bcapscope.proxy.listeners.UdpListener", open_udp)
    with pytest.raises(ProxyListenError, match=r"attempt 20$"):
        opened("127.0.0.1:0")
    with pytest.raises(ProxyListenError, match=r"attempt 21$"):  # it tries no other port
        opened(f"127.0.0.1:{tried[0]}")


def test_ipv6() -> None:
    if not socket.has_ipv6:
        pytest.skip("there is no IPv6 here")
    address, count = opened("[::1]:0", "[::1]:5007")
    assert address.host == "::1"
    assert count == 2


def _taken_datagram_port() -> socket.socket:
    """Take a UDP port whose TCP port is free. Systems give such low ports to no other test's connection."""
    for port in range(20_000 + os.getpid() % 8192, 32_000):
        taken = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        try:
            taken.bind(("127.0.0.1", port))
            with socket.socket() as same:
                same.bind(("127.0.0.1", port))
        except OSError:
            taken.close()
        else:
            return taken
    raise AssertionError("no port is free")


def test_a_port_of_somebody_else_is_refused_and_nothing_stays_open() -> None:
    with _taken_datagram_port() as taken:
        port = port_of(taken)
        expected = f"127.0.0.1 UDP port {port}: address already in use"
        with pytest.raises(ProxyListenError, match=expected) as refused:
            opened(f"127.0.0.1:{port}")
        assert opened(f"127.0.0.1:{port}", transport="tcp")[1] == 1
        del refused  # until here, its traceback kept the TCP socket from being closed by accident
    with listening() as door, pytest.raises(ProxyListenError, match="TCP port"):
        opened(f"127.0.0.1:{port_of(door)}")


@pytest.mark.parametrize("transport", ["tcp", "udp"])
def test_without_file_descriptors_nothing_can_be_listened_on(
    monkeypatch: pytest.MonkeyPatch, transport: str
) -> None:
    def none_left(*_: object) -> socket.socket:
        raise OSError(errno.EMFILE, "")

    relay = Relay(RingWriter(memoryview(bytearray(RING_OVERHEAD + 4096))))
    (listener,) = parse_listener_specs(["127.0.0.1:0"], ["127.0.0.1:5007"], transport)
    with monkeypatch.context() as patched:
        patched.setattr("bcapscope.proxy.sockets.socket.socket", none_left)
        with pytest.raises(ProxyListenError, match="too many open files"):
            open_listeners(relay, listener)
    relay.close()


def test_two_proxies_cannot_share_a_port() -> None:
    relay = Relay(RingWriter(memoryview(bytearray(RING_OVERHEAD + 4096))))
    (listener,) = parse_listener_specs(["127.0.0.1:0"], ["127.0.0.1:5007"])
    address, ports = open_listeners(relay, listener)
    relay.listen(ports)
    for transport in ("udp", "tcp"):
        with pytest.raises(ProxyListenError):
            opened(f"127.0.0.1:{address.port}", transport=transport)
    relay.close()


def test_a_controller_without_address() -> None:
    with pytest.raises(UnreachableError, match=r"no\.such\.host\.invalid:5007 cannot be reached"):
        opened("127.0.0.1:0", "no.such.host.invalid:5007")
