"""Opening what listeners say."""

from __future__ import annotations

from dataclasses import replace

from bcapscope.proxy.relay import Relay
from bcapscope.proxy.sockets import ListenError
from bcapscope.proxy.spec import BOTH, Listener
from bcapscope.proxy.tcpport import TcpPort
from bcapscope.proxy.udp import FORGET_AFTER, UdpPort
from bcapscope.traffic.observation import Endpoint, Transport

_TRIES = 20


def open_ports(
    relay: Relay, listener: Listener, forget_after: int = FORGET_AFTER
) -> tuple[Endpoint, list[TcpPort | UdpPort]]:
    """Listen; return where, and the ports, which take clients when the relay is given them.

    Port 0 takes one that is free, on both transports if both are wanted.

    Raises:
        ListenError: it cannot be listened on.
        NoWay: the controller's name is unknown.
    """
    for last in range(_TRIES - 1, -1, -1):
        ports: list[TcpPort | UdpPort] = []
        address = listener.listen
        try:
            if Transport.TCP in listener.transports:
                ports.append(TcpPort(relay, listener))
                address = ports[0].address
            if Transport.UDP in listener.transports:
                ports.append(UdpPort(relay, replace(listener, listen=address), forget_after))
                address = ports[-1].address
            return address, ports
        except ListenError:
            for port in ports:
                port.close()
                port.release()
            if listener.listen.port or listener.transports != BOTH or not last:
                raise
    raise AssertionError("one of the tries returns or raises")
