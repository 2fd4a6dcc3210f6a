"""A proxy's answers on its control socket, with types and bounds, since any program may listen there."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, Any, TypeAlias, TypeVar

import msgspec
from msgspec import Meta

from bcapscope.traffic.call_kind import CallKind
from bcapscope.traffic.observation import Conversation, Direction, Endpoint, Flow, Transport

T = TypeVar("T")

ControlAnswer: TypeAlias = Mapping[str, Any]
JsonCount: TypeAlias = Annotated[int, Meta(ge=0, le=2**63 - 1)]
JsonCode: TypeAlias = Annotated[int, Meta(ge=0, lt=2**32)]
Seconds: TypeAlias = Annotated[float, Meta(ge=-1e9, le=1e9)]


class ClientStatus(msgspec.Struct, frozen=True):
    """A client, as `proxy.control_api` reports it."""

    number: JsonCount
    client: str
    server: str
    transport: str
    upstream: str
    since_s: Seconds
    up: JsonCount
    heard_s: Seconds | None
    down: JsonCount
    answered_s: Seconds | None


class FaultStatus(msgspec.Struct, frozen=True):
    """A fault, as `proxy.control_api` reports it."""

    name: str
    on: bool
    struck: JsonCount
    rule: str


class HeldStatus(msgspec.Struct, frozen=True):
    """A held message, as `proxy.control_api` reports it."""

    number: JsonCount
    client: str
    server: str
    transport: Transport
    direction: Direction
    function_id: JsonCode | None
    function: str | None
    command: str | None
    waited_s: Seconds
    left_s: Seconds
    hex: str
    given_up: str = ""
    more: JsonCount = 0

    def __post_init__(self) -> None:
        """Reject values that the properties cannot read."""
        bytes.fromhex(self.hex)
        _endpoint(self.client)
        _endpoint(self.server)

    @property
    def data(self) -> bytes:
        """The message."""
        return bytes.fromhex(self.hex)

    @property
    def flow(self) -> Flow:
        """Sender and receiver."""
        ends = _endpoint(self.client), _endpoint(self.server)
        return Flow(Conversation(*ends, self.transport, "the proxy"), self.direction)

    @property
    def call_kind(self) -> CallKind | None:
        """The call that it requests or answers; None if unknown."""
        return None if self.function_id is None else CallKind(self.function_id, self.command)


class RelayDelays(msgspec.Struct, frozen=True):
    """Delays in the relay of data forwarded unchanged, in ns; `slow` counts delays that are too long."""

    p50_up: JsonCount = 0
    p99_up: JsonCount = 0
    p999_up: JsonCount = 0
    most_up: JsonCount = 0
    p50_down: JsonCount = 0
    p99_down: JsonCount = 0
    p999_down: JsonCount = 0
    most_down: JsonCount = 0
    slow: JsonCount = 0


class ProxyStats(msgspec.Struct, frozen=True):
    """The figures that `proxy.control_api` reports."""

    struck: dict[str, JsonCount]
    refused: JsonCount
    guard: bool
    intercept: str | None
    held_so_far: JsonCount
    came_up: JsonCount = 0
    left_up: JsonCount = 0
    came_down: JsonCount = 0
    left_down: JsonCount = 0
    bytes_up: JsonCount = 0
    bytes_down: JsonCount = 0
    full: JsonCount = 0
    lost: JsonCount = 0
    denied: JsonCount = 0
    unwatched: JsonCount = 0
    ruled: JsonCount = 0
    held_up_ns: RelayDelays = RelayDelays()
    recording: str | None = None
    listening: tuple[str, ...] = ()
    scripts: str | None = None

    @property
    def are_scripts_off(self) -> bool:
        """Whether scripts were switched off."""
        return self.scripts not in (None, "on")

    @property
    def ports(self) -> tuple[int, ...]:
        """The ports that the proxy listens on."""
        return tuple(int(way.partition(" > ")[0].rpartition(":")[2]) for way in self.listening)


def parse_stats(answer: ControlAnswer) -> ProxyStats:
    """Read an answer to ``stats``.

    Raises:
        msgspec.ValidationError: The answer is not from a proxy of this version.
    """
    return msgspec.convert(answer, ProxyStats)


def parse_list(answer: ControlAnswer, name: str, kind: type[T]) -> list[T]:
    """Read an answer that is a list.

    Raises:
        msgspec.ValidationError: The answer is not from a proxy of this version.
    """
    return msgspec.convert(answer.get(name), list[kind])  # type: ignore[valid-type]  # it is a type when it runs


def _endpoint(text: str) -> Endpoint:
    host, _, port = text.rpartition(":")
    if not host.isprintable() or not (port.isascii() and port.isdecimal() and len(port) <= 5):
        raise ValueError(f"{text!r} is no address")
    return Endpoint(host.strip("[]"), int(port))
