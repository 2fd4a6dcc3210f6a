"""A proxy's answers on its control socket, with types and bounds, since any program may listen there."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, Any, TypeAlias, TypeVar

import msgspec
from msgspec import Meta

from bcapscope.traffic.observation import Conversation, Direction, Endpoint, Flow, Transport
from bcapscope.traffic.question import Question

T = TypeVar("T")

Answer: TypeAlias = Mapping[str, Any]
Count: TypeAlias = Annotated[int, Meta(ge=0, le=2**63 - 1)]
Code: TypeAlias = Annotated[int, Meta(ge=0, lt=2**32)]
Seconds: TypeAlias = Annotated[float, Meta(ge=-1e9, le=1e9)]


class Client(msgspec.Struct, frozen=True):
    """A client, as `proxy.control` reports it."""

    number: Count
    client: str
    server: str
    transport: str
    upstream: str
    since_s: Seconds
    up: Count
    heard_s: Seconds | None
    down: Count
    answered_s: Seconds | None


class Rule(msgspec.Struct, frozen=True):
    """A fault, as `proxy.control` reports it."""

    name: str
    on: bool
    struck: Count
    rule: str


class Held(msgspec.Struct, frozen=True):
    """A message that waits, as `proxy.control` reports it."""

    number: Count
    client: str
    server: str
    transport: Transport
    direction: Direction
    function_id: Code | None
    function: str | None
    command: str | None
    waited_s: Seconds
    left_s: Seconds
    hex: str
    given_up: str = ""
    more: Count = 0

    def __post_init__(self) -> None:
        """Refuse what the properties could not read."""
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
    def question(self) -> Question | None:
        """The function that it calls or answers, if known."""
        return None if self.function_id is None else Question(self.function_id, self.command)


class Delays(msgspec.Struct, frozen=True):
    """How long the relay holds what it passes on as it came: ns; `slow` counts what took too long."""

    p50_up: Count = 0
    p99_up: Count = 0
    p999_up: Count = 0
    most_up: Count = 0
    p50_down: Count = 0
    p99_down: Count = 0
    p999_down: Count = 0
    most_down: Count = 0
    slow: Count = 0


class Figures(msgspec.Struct, frozen=True):
    """The figures that `proxy.control` reports."""

    struck: dict[str, Count]
    refused: Count
    guard: bool
    intercept: str | None
    held_so_far: Count
    came_up: Count = 0
    left_up: Count = 0
    came_down: Count = 0
    left_down: Count = 0
    bytes_up: Count = 0
    bytes_down: Count = 0
    full: Count = 0
    lost: Count = 0
    denied: Count = 0
    unwatched: Count = 0
    ruled: Count = 0
    held_up_ns: Delays = Delays()
    recording: str | None = None
    listening: tuple[str, ...] = ()
    scripts: str | None = None

    @property
    def is_script_off(self) -> bool:
        """Whether a script was switched off."""
        return self.scripts not in (None, "on")

    @property
    def ports(self) -> tuple[int, ...]:
        """Where it listens."""
        return tuple(int(way.partition(" > ")[0].rpartition(":")[2]) for way in self.listening)


def figures_of(answer: Answer) -> Figures:
    """Read an answer to ``stats``.

    Raises:
        msgspec.ValidationError: what answered is no proxy of this version.
    """
    return msgspec.convert(answer, Figures)


def list_of(answer: Answer, name: str, kind: type[T]) -> list[T]:
    """Read an answer that is a list.

    Raises:
        msgspec.ValidationError: what answered is no proxy of this version.
    """
    return msgspec.convert(answer.get(name), list[kind])  # type: ignore[valid-type]  # it is a type when it runs


def _endpoint(text: str) -> Endpoint:
    host, _, port = text.rpartition(":")
    if not host.isprintable() or not (port.isascii() and port.isdecimal() and len(port) <= 5):
        raise ValueError(f"{text!r} is no address")
    return Endpoint(host.strip("[]"), int(port))
