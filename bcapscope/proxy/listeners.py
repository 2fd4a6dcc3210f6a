"""Open the listeners that a `ListenerSpec` describes."""

from __future__ import annotations

from dataclasses import replace

from bcapscope.proxy.listener_spec import BOTH, ListenerSpec
from bcapscope.proxy.relay import Relay
from bcapscope.proxy.sockets import ProxyListenError
from bcapscope.proxy.tcp_listener import TcpListener
from bcapscope.proxy.udp_listener import EXPIRE_AFTER_NS, UdpListener
from bcapscope.traffic.observation import Endpoint, Transport

_TRIES = 20


def open_listeners(
    relay: Relay, spec: ListenerSpec, forget_after: int = EXPIRE_AFTER_NS
) -> tuple[Endpoint, list[TcpListener | UdpListener]]:
    """Return the common address of the listeners of `spec`, and the listeners. Port 0 selects a free port for
    both transports. The listeners accept no clients until the relay opens them. Raise the errors of
    `listen_on` and `resolve`.
    """
    for left in reversed(range(_TRIES)):
        listeners: list[TcpListener | UdpListener] = []
        address = spec.listen
        try:
            if Transport.TCP in spec.transports:
                listeners.append(TcpListener(relay, spec))
                address = listeners[0].address
            if Transport.UDP in spec.transports:
                listeners.append(UdpListener(relay, replace(spec, listen=address), forget_after))
                address = listeners[-1].address
            return address, listeners
        except ProxyListenError:
            for listener in listeners:
                listener.release()
            if spec.listen.port or spec.transports != BOTH or not left:
                raise
    raise AssertionError("the last try must return listeners or raise an exception")
