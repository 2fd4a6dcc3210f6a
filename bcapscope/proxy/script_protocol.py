"""Messages between the proxy and the script process. Each is a length of four bytes, then MessagePack.

The process runs the user's code, so the proxy trusts nothing that it sends. Types and lengths are checked
here, and nothing in a message can run code.
"""

from __future__ import annotations

from typing import Annotated, Any, Generic, TypeAlias, TypeVar

import msgspec

from bcapscope.errors import BcapError
from bcapscope.messages import Message
from bcapscope.messages.message import foreign_text

T = TypeVar("T")

LARGEST_FRAME_SIZE = 32 << 20
"""Bytes of one frame: twice the size of the largest b-CAP frame that can be read."""

MAX_SENTENCES, LONGEST_SENTENCE = 32, 2000
"""Messages for the user in one answer, and characters of each of their places."""

_HEAD = 4

_Word = Annotated[str, msgspec.Meta(max_length=60)]
_Text = Annotated[str, msgspec.Meta(max_length=LONGEST_SENTENCE)]
_Result = Annotated[int, msgspec.Meta(ge=0, le=0xFFFF_FFFF)]


class ScriptError(BcapError):
    """A script cannot be used; the message gives the file and the reason."""


class WireError(BcapError):
    """The bytes are not a frame of this protocol; the message gives the reason."""


class _WireFrame(msgspec.Struct, frozen=True, array_like=True, tag=True):
    pass


class ClientConnected(_WireFrame, frozen=True):
    """A client sent its first message.

    Attributes:
        client: Number of the client.
        ends: Host and port of the client and of the controller.
        transport: Value of `Transport`.
    """

    client: int
    ends: tuple[tuple[str, int], tuple[str, int]]
    transport: str


class MessageShown(_WireFrame, frozen=True):
    """A message in transit.

    Attributes:
        client: Number of the client.
        up: True toward the controller.
        data: A datagram, or a frame or other bytes of a stream.
        now: Time of receipt, ns of the relay's clock.
        time: Time of receipt, ns since 1970.
    """

    client: int
    up: bool
    data: bytes
    now: int
    time: int


class ClientGone(_WireFrame, frozen=True):
    """A client is gone."""

    client: int


class ExpireCalls(_WireFrame, frozen=True):
    """The current time in ns since 1970: calls may have completed."""

    time: int


class FinishScripts(_WireFrame, frozen=True):
    """The proxy ends."""


ScriptOrder: TypeAlias = ClientConnected | MessageShown | ClientGone | ExpireCalls | FinishScripts
"""What the proxy sends. Each order has one answer, in the same sequence."""


class WireSentence(_WireFrame, frozen=True):
    """A message for the user: an id of the catalogue, and the text of its places."""

    id: _Word
    places: Annotated[dict[_Word, _Text], msgspec.Meta(max_length=16)]

    @property
    def message(self) -> Message:
        return Message(self.id, **self.places)


def wire_sentence(message: Message) -> WireSentence:
    """Return a message for the wire; its places become text."""
    places = {name: str(value)[:LONGEST_SENTENCE] for name, value in message.places.items()}
    return WireSentence(message.id, places)


class ScriptsLoaded(_WireFrame, frozen=True):
    """The scripts can be used.

    Attributes:
        hooks: Names of the hooks that they have.
    """

    hooks: frozenset[str]


class ScriptsUnusable(_WireFrame, frozen=True):
    """A script cannot be used; `reason` names it and the cause."""

    reason: WireSentence


class ScriptAnswer(_WireFrame, frozen=True):
    """The answer to an order.

    Attributes:
        notices: Messages for the user.
        errors: Number of errors in the scripts so far.
        has_open_calls: True if calls are open and `ExpireCalls` must be sent from time to time.
        data: Bytes that replace the message; None if it is unchanged.
        dropped: True if the message does not go on.
        results: Result codes that the client gets in place of the controller's reply.
    """

    notices: Annotated[tuple[WireSentence, ...], msgspec.Meta(max_length=MAX_SENTENCES)] = ()
    errors: int = 0
    has_open_calls: bool = False
    data: bytes | None = None
    dropped: bool = False
    results: Annotated[tuple[_Result, ...], msgspec.Meta(max_length=64)] = ()


ScriptStatement: TypeAlias = ScriptsLoaded | ScriptsUnusable | ScriptAnswer
"""A message from the script process: first whether the scripts are usable, then one answer after another."""

_encoder = msgspec.msgpack.Encoder()


def pack(frame: ScriptOrder | ScriptStatement) -> bytes:
    """Return the bytes of a frame."""
    body = _encoder.encode(frame)
    return len(body).to_bytes(_HEAD, "little") + body


class FrameUnpacker(Generic[T]):
    """Splits received bytes into frames."""

    def __init__(self, kinds: Any) -> None:
        """Decode frames of these kinds: a union such as `ScriptOrder`."""
        self._decoder: msgspec.msgpack.Decoder[T] = msgspec.msgpack.Decoder(kinds)
        self._buffer = bytearray()

    def feed_bytes(self, data: bytes) -> None:
        self._buffer += data

    def next_frame(self) -> T | None:
        """Return the next frame; None until more bytes arrive.

        Raises:
            WireError: The bytes are not a frame.
        """
        buffer = self._buffer
        if len(buffer) < _HEAD:
            return None
        size = int.from_bytes(buffer[:_HEAD], "little")
        if size > LARGEST_FRAME_SIZE:
            raise WireError(Message("script.wire.size", size=size))
        if len(buffer) < _HEAD + size:
            return None
        body = bytes(buffer[_HEAD : _HEAD + size])
        del buffer[: _HEAD + size]
        try:
            return self._decoder.decode(body)
        except (msgspec.DecodeError, UnicodeDecodeError, RecursionError) as error:
            raise WireError(foreign_text(str(error))) from None
