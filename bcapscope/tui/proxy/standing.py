"""How a proxy stands: what it answers on its control socket, with types."""

from __future__ import annotations

from typing import TypeVar

import msgspec

from bcapscope.proxy.control_client import Answer
from bcapscope.traffic.observation import Conversation, Direction, Endpoint, Flow, Transport
from bcapscope.traffic.question import Question

T = TypeVar("T")


class Client(msgspec.Struct, frozen=True):
    """A client, as `proxy.control` tells of it."""

    number: int
    client: str
    server: str
    transport: str
    upstream: str
    since_s: float
    up: int
    heard_s: float | None
    down: int
    answered_s: float | None


class Rule(msgspec.Struct, frozen=True):
    """A fault, as `proxy.control` tells of it."""

    name: str
    on: bool
    struck: int
    rule: str


class Held(msgspec.Struct, frozen=True):
    """A message that waits, as `proxy.control` tells of it."""

    number: int
    client: str
    server: str
    transport: Transport
    direction: Direction
    function_id: int | None
    function: str | None
    command: str | None
    waited_s: float
    left_s: float
    hex: str

    @property
    def data(self) -> bytes:
        """The message."""
        return bytes.fromhex(self.hex)

    @property
    def flow(self) -> Flow:
        """Who speaks to whom."""
        ends = _endpoint(self.client), _endpoint(self.server)
        return Flow(Conversation(*ends, self.transport, "the proxy"), self.direction)

    @property
    def question(self) -> Question | None:
        """What it asks or answers, where that is known."""
        return None if self.function_id is None else Question(self.function_id, self.command)


class Delays(msgspec.Struct, frozen=True):
    """How long the relay holds what it passes on as it came: ns; `slow` counts what took too long."""

    p50_up: int = 0
    p99_up: int = 0
    p999_up: int = 0
    most_up: int = 0
    p50_down: int = 0
    p99_down: int = 0
    p999_down: int = 0
    most_down: int = 0
    slow: int = 0


class Figures(msgspec.Struct, frozen=True):
    """The figures, as `proxy.control` tells them."""

    struck: dict[str, int]
    refused: int
    guard: bool
    intercept: str | None
    held_so_far: int
    came_up: int = 0
    left_up: int = 0
    came_down: int = 0
    left_down: int = 0
    bytes_up: int = 0
    bytes_down: int = 0
    full: int = 0
    lost: int = 0
    denied: int = 0
    unwatched: int = 0
    ruled: int = 0
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


class Standing(msgspec.Struct, frozen=True):
    """All of it."""

    clients: list[Client]
    rules: list[Rule]
    held: list[Held]
    figures: Figures


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
    return Endpoint(host.strip("[]"), int(port))
