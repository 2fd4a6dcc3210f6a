"""Requests to a running proxy, and the proxy's responses. Each request and each response is one line of JSON.

    {"do": "rules"}                              the faults, their switches and counts
    {"do": "add", "rule": "loss=5% request"}     one line, or "fault" as in a file
    {"do": "remove", "name": "drop"}
    {"do": "on", "name": "drop"}                 also off
    {"do": "intercept", "if": "command == slvMove", "patience": "60s"}    without "if": hold nothing
    {"do": "held"}                               the held messages
    {"do": "forward", "number": 3}
    {"do": "edit", "number": 3, "hex": "01 …"}   or "rewrite": "set arg[2][0]=10"
    {"do": "drop", "number": 3}
    {"do": "clients"}                            clients, and their connections to the controller
    {"do": "stats"}

A response has "ok": true and the result, or "ok": false and "error". The client checks the types and bounds
of a response, because any program may listen on the address.
"""

from __future__ import annotations

import json
from typing import Annotated, Any, TypeAlias, TypeVar

import msgspec
import orjson
from msgspec import Meta
from msgspec.structs import force_setattr

from bcapscope.errors import InputError
from bcapscope.faults.document import convert_data
from bcapscope.messages import Message
from bcapscope.messages.message import foreign_text
from bcapscope.messages.message_codec import message_from_data
from bcapscope.traffic.call_kind import CallKind
from bcapscope.traffic.observation import (
    SERVER_PARTICIPANT,
    Conversation,
    Direction,
    Endpoint,
    Flow,
    Transport,
)

T = TypeVar("T")

JsonCount: TypeAlias = Annotated[int, Meta(ge=0, le=2**63 - 1)]
JsonCode: TypeAlias = Annotated[int, Meta(ge=0, lt=2**32)]
JsonEndpoint: TypeAlias = Annotated[str, Meta(pattern=r"^[ -~]+:[0-9]{1,5}\Z")]
JsonHex: TypeAlias = Annotated[str, Meta(pattern=r"^([0-9A-Fa-f]{2} ?)*\Z")]
Seconds: TypeAlias = Annotated[float, Meta(ge=-1e9, le=1e9)]

LONGEST_LINE = 1 << 20
"""Maximum size of a line in bytes. A line can contain the bytes of a held message."""


class _Request(msgspec.Struct, frozen=True, forbid_unknown_fields=True, omit_defaults=True, tag_field="do"):
    pass


class ListFaults(_Request, frozen=True, tag="rules"):
    pass


class AddFault(_Request, frozen=True, tag="add"):
    """The fault is either one line of text (`rule`), or has the form of a fault in a file (`fault`)."""

    rule: str = ""
    fault: dict[str, Any] = {}


class RemoveFault(_Request, frozen=True, tag="remove"):
    name: str


class EnableFault(_Request, frozen=True, tag="on"):
    name: str


class DisableFault(_Request, frozen=True, tag="off"):
    name: str


class SetIntercept(_Request, frozen=True, tag="intercept", rename={"condition": "if"}):
    """Sets which messages the proxy holds from now on. Without `condition`, the proxy holds no further
    messages. Without `patience`, the maximum hold time stays the same.
    """

    condition: str | None = None
    patience: str | None = None


class ListHeld(_Request, frozen=True, tag="held"):
    pass


class ForwardHeld(_Request, frozen=True, tag="forward"):
    number: int


class EditHeld(_Request, frozen=True, tag="edit"):
    """Replaces a held message by the bytes `hex`, or changes it with the rewrite fault `rewrite`."""

    number: int
    hex: str = ""
    rewrite: str = ""


class DropHeld(_Request, frozen=True, tag="drop"):
    number: int


class ListClients(_Request, frozen=True, tag="clients"):
    pass


class GetStats(_Request, frozen=True, tag="stats"):
    pass


FaultChange: TypeAlias = AddFault | RemoveFault | EnableFault | DisableFault
HoldChange: TypeAlias = SetIntercept | ForwardHeld | EditHeld | DropHeld
ControlRequest: TypeAlias = FaultChange | HoldChange | ListFaults | ListHeld | ListClients | GetStats


class ErrorResponse(msgspec.Struct, frozen=True):
    """Response to a rejected request. `error` holds the reason as English text. `message` holds the reason in
    the format of `message_to_data`. The client first decodes every response as an `ErrorResponse`.
    """

    ok: bool
    error: str = "the proxy refused"
    message: dict[str, Any] | None = None

    @property
    def reason(self) -> Message:
        """Reason of the rejection. If `message` is missing, invalid or unknown, for example because another
        program or a newer proxy sent the response, the reason is the text of `error`.
        """
        try:
            found = message_from_data(self.message or {})
            is_known = str(found) != found.id
        except (LookupError, TypeError, AttributeError, ValueError):
            is_known = False
        return found if is_known else foreign_text(self.error)


class DoneResponse(msgspec.Struct, frozen=True, kw_only=True):
    ok: bool = True


class FaultResponse(DoneResponse, frozen=True, kw_only=True):
    """Response to a `FaultChange`."""

    name: str


class FaultStatus(msgspec.Struct, frozen=True):
    """A fault, and how often the proxy injected it. `struck` is the old name of `injected`."""

    name: str
    on: bool
    injected: JsonCount
    rule: str
    fault: dict[str, Any] = {}
    struck: JsonCount = 0

    def __post_init__(self) -> None:
        force_setattr(self, "struck", self.injected)


class FaultsResponse(DoneResponse, frozen=True, kw_only=True):
    rules: list[FaultStatus]


class ClientStatus(msgspec.Struct, frozen=True):
    """A client of the proxy. `up` counts datagrams from the client, and `down` datagrams from the controller.
    Over TCP, `up` and `down` count how often the proxy has read bytes from the client and from the
    controller. The time of an event is None if the event never happened.
    """

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


class ClientsResponse(DoneResponse, frozen=True, kw_only=True):
    clients: list[ClientStatus]


class HeldStatus(msgspec.Struct, frozen=True):
    """A held message. `given_up` says why the client no longer waits. `more` is an old name of `retries`."""

    number: JsonCount
    client: JsonEndpoint
    server: JsonEndpoint
    transport: Transport
    direction: Direction
    function_id: JsonCode | None
    function: str | None
    command: str | None
    waited_s: Seconds
    left_s: Seconds
    hex: JsonHex
    given_up: str = ""
    retries: JsonCount = 0
    more: JsonCount = 0

    def __post_init__(self) -> None:
        force_setattr(self, "more", self.retries)

    @property
    def data(self) -> bytes:
        return bytes.fromhex(self.hex)

    @property
    def flow(self) -> Flow:
        ends = parse_endpoint(self.client), parse_endpoint(self.server)
        return Flow(Conversation(*ends, self.transport, SERVER_PARTICIPANT), self.direction)

    @property
    def call_kind(self) -> CallKind | None:
        return None if self.function_id is None else CallKind(self.function_id, self.command)


class HeldResponse(DoneResponse, frozen=True, kw_only=True):
    held: list[HeldStatus]


class RelayDelays(msgspec.Struct, frozen=True):
    """Delays in ns of data that the relay forwards unchanged. `slow` counts delays of more than 2 ms."""

    p50_up: JsonCount = 0
    p99_up: JsonCount = 0
    p999_up: JsonCount = 0
    most_up: JsonCount = 0
    p50_down: JsonCount = 0
    p99_down: JsonCount = 0
    p999_down: JsonCount = 0
    most_down: JsonCount = 0
    slow: JsonCount = 0


class ProxyStats(DoneResponse, frozen=True, kw_only=True):
    """Figures of the proxy. `RelayCounter` describes the figures that the relay counts. `struck` and
    `held_up_ns` are the old names of `injected` and `delays_ns`.
    """

    injected: dict[str, JsonCount]
    refused: JsonCount
    guard: bool
    intercept: str | None
    held: JsonCount
    held_so_far: JsonCount
    addon_errors: JsonCount
    scripts: str | None
    clients_now: JsonCount = 0
    came_up: JsonCount = 0
    left_up: JsonCount = 0
    came_down: JsonCount = 0
    left_down: JsonCount = 0
    bytes_up: JsonCount = 0
    bytes_down: JsonCount = 0
    full: JsonCount = 0
    lost: JsonCount = 0
    denied: JsonCount = 0
    clients: JsonCount = 0
    unwatched: JsonCount = 0
    ruled: JsonCount = 0
    delays_ns: RelayDelays = RelayDelays()
    recording: str | None = None
    listening: tuple[str, ...] = ()
    struck: dict[str, JsonCount] = {}
    held_up_ns: RelayDelays = RelayDelays()

    def __post_init__(self) -> None:
        force_setattr(self, "struck", self.injected)
        force_setattr(self, "held_up_ns", self.delays_ns)

    @property
    def are_scripts_off(self) -> bool:
        return self.scripts not in (None, "on")

    @property
    def ports(self) -> tuple[int, ...]:
        return tuple(int(each.partition(" > ")[0].rpartition(":")[2]) for each in self.listening)


def encode_line(message: ControlRequest | DoneResponse | ErrorResponse) -> bytes:
    try:
        return msgspec.json.encode(message) + b"\n"
    # A file name, or a text from the wire, may contain a lone surrogate, which UTF-8 cannot encode.
    except UnicodeEncodeError:
        text = json.dumps(msgspec.to_builtins(message), ensure_ascii=False)
        return text.encode("utf-8", "replace") + b"\n"


def decode_request(line: bytes) -> ControlRequest:
    """Decode a request. If the line is not JSON, and the sender therefore is no control client, raise a
    `JSONDecodeError`. If a field is invalid, raise a `DocumentError` that names the field.
    """
    request: ControlRequest = convert_data(orjson.loads(line), ControlRequest)
    return request


def decode_response(line: bytes, kind: type[T]) -> T:
    """Decode a response. An invalid line raises a `ValueError`."""
    try:
        return msgspec.json.decode(line, type=kind)
    except RecursionError as error:
        raise InputError(Message("document.endless")) from error


def parse_endpoint(text: str) -> Endpoint:
    host, _, port = text.rpartition(":")
    return Endpoint(host.strip("[]"), int(port))
