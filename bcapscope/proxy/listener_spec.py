"""The addresses on which a proxy listens, their controllers, and the clients that the proxy accepts."""

from __future__ import annotations

import ipaddress
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TypeAlias

from bcapscope.errors import BcapError
from bcapscope.messages import Message
from bcapscope.protocol.number_parsing import parse_integer
from bcapscope.protocol.text_format import shortened
from bcapscope.traffic.observation import Endpoint, Transport

BOTH = (Transport.UDP, Transport.TCP)

Network: TypeAlias = ipaddress.IPv4Network | ipaddress.IPv6Network

_TRANSPORTS = {"udp": (Transport.UDP,), "tcp": (Transport.TCP,), "both": BOTH}
_IPV6 = frozenset("0123456789abcdefABCDEF:.")


class ListenerSpecError(BcapError):
    """The options of a listener are invalid."""


@dataclass(frozen=True, slots=True)
class ListenerSpec:
    """At the address `listen`, the proxy accepts clients of the controller `to`. Port 0 selects a free port.
    The proxy accepts only clients from the networks `allow`; () allows all networks.
    """

    listen: Endpoint
    to: Endpoint
    transports: tuple[Transport, ...] = BOTH
    allow: tuple[Network, ...] = ()

    def allows(self, host: str) -> bool:
        if not self.allow:
            return True
        address = ipaddress.ip_address(host.partition("%")[0])
        return any(address in network for network in self.allow)


def parse_listener_specs(
    listen: Sequence[str], to: Sequence[str], transport: str = "both", allow: Sequence[str] = ()
) -> tuple[ListenerSpec, ...]:
    """Make one `ListenerSpec` per listener from the command line, or raise a `ListenerSpecError`.

    Args:
        listen: `HOST:PORT` of each listener, `[HOST]:PORT` for IPv6. The prefix `udp:` or `tcp:` selects a
            transport.
        to: `HOST:PORT` of the controller of each listener, in the order of the listeners.
        transport: Transport for listeners without a prefix: `udp`, `tcp` or `both`.
        allow: Addresses or networks in CIDR notation from which clients may connect.
    """
    if not listen:
        raise ListenerSpecError(Message("listener.none"))
    if len(listen) != len(to):
        raise ListenerSpecError(Message("listener.unpaired", listen=len(listen), to=len(to)))
    networks = tuple(map(_network, allow))
    listeners = []
    for own, controller in zip(listen, to, strict=True):
        address, transports = _address(own, transport)
        target = _endpoint(controller, "--to")
        if not target.port:
            raise ListenerSpecError(Message("listener.port-zero", address=controller))
        listeners.append(ListenerSpec(address, target, transports, networks))
    _check_conflicts(listeners)
    return tuple(listeners)


def _check_conflicts(listeners: Sequence[ListenerSpec]) -> None:
    taken: set[tuple[Endpoint, Transport]] = set()
    for listener in listeners:
        if (listener.listen, listener.to) in ((each.to, each.listen) for each in listeners):
            raise ListenerSpecError(Message("listener.loop", address=str(listener.listen)))
        for transport in listener.transports:
            if listener.listen.port and (listener.listen, transport) in taken:
                place = {"address": str(listener.listen), "transport": transport.upper()}
                raise ListenerSpecError(Message("listener.twice", **place))
            taken.add((listener.listen, transport))


def _address(text: str, transport: str) -> tuple[Endpoint, tuple[Transport, ...]]:
    word, colon, rest = text.partition(":")
    if colon and word.lower() in _TRANSPORTS:
        transport, text = word.lower(), rest
    endpoint = _endpoint(text, "--listen")
    host = "127.0.0.1" if endpoint.host == "localhost" else endpoint.host
    try:
        ipaddress.ip_address(host.partition("%")[0])
    except ValueError:
        raise ListenerSpecError(Message("listener.no-own-address", address=text, host=f"{host!r}")) from None
    return Endpoint(host, endpoint.port), _TRANSPORTS[transport]


def _endpoint(text: str, option: str) -> Endpoint:
    host, colon, number = text.rpartition(":")
    if not colon:
        example = f"127.0.0.1:{text}" if text.isdecimal() else f"{text or '192.168.0.1'}:5007"
        raise ListenerSpecError(Message("listener.no-port", option=option, address=text, example=example))
    if host.startswith("[") and host.endswith("]"):
        host = host[1:-1]
    elif ":" in host:
        bare = _IPV6.issuperset(host.partition("%")[0])
        why = Message("listener.brackets") if bare else Message("listener.no-host", host=f"{host!r}")
        raise ListenerSpecError(Message("listener.invalid", option=option, address=text, reason=why))
    if not host or not host.isprintable() or any(char in " []/" for char in host):
        raise ListenerSpecError(Message("listener.no-host-in", option=option, address=text, host=f"{host!r}"))
    port = parse_integer(number, 0, 0xFFFF)
    if port is None:
        address, shown = shortened(text, 80), f"{shortened(number, 40)!r}"
        raise ListenerSpecError(Message("listener.bad-port", option=option, address=address, port=shown))
    return Endpoint(host, port)


def _network(text: str) -> Network:
    try:
        return ipaddress.ip_network(text)
    except ValueError as error:
        raise ListenerSpecError(Message("listener.bad-network", address=text, reason=str(error))) from None
