"""Messages between the proxy and the scripts' process: a length in four bytes, then MessagePack data. The
process runs the user's code, so this module checks types and lengths, and nothing in a message can run code.
"""

from __future__ import annotations

from typing import Annotated, Any, Generic, TypeAlias, TypeVar

import msgspec

from bcapscope.errors import BcapError
from bcapscope.messages import Message
from bcapscope.messages.message import foreign_text

T = TypeVar("T")

LARGEST_FRAME_SIZE = 32 << 20
"""Maximum size of one message in bytes: twice the size of the largest b-CAP frame that bcapscope reads."""

MAX_SENTENCES, LONGEST_SENTENCE = 32, 2000
"""Maximum number of messages for the user in one answer, and maximum length of each value in a message."""

_HEAD = 4

_Word = Annotated[str, msgspec.Meta(max_length=60)]
_Text = Annotated[str, msgspec.Meta(max_length=LONGEST_SENTENCE)]
_Result = Annotated[int, msgspec.Meta(ge=0, le=0xFFFF_FFFF)]


class ScriptError(BcapError):
    """A script failed to load, or has no add-on."""


class WireError(BcapError):
    """The received bytes are not a message of this protocol."""


class _WireFrame(msgspec.Struct, frozen=True, array_like=True, tag=True):
    pass


class ClientConnected(_WireFrame, frozen=True):
    """A client sent its first message. `ends` are the addresses of the client and the controller."""

    client: int
    ends: tuple[tuple[str, int], tuple[str, int]]
    transport: str


class MessageShown(_WireFrame, frozen=True):
    """Passes a datagram, a frame of a stream, or bytes that are not a frame to the scripts. `up` is True
    toward the controller. `now` is in ns of the relay's clock, `time` in ns since 1970.
    """

    client: int
    up: bool
    data: bytes
    now: int
    time: int


class ClientGone(_WireFrame, frozen=True):
    client: int


class ExpireCalls(_WireFrame, frozen=True):
    """Completes all calls whose clients no longer wait at `time`, in ns since 1970."""

    time: int


class FinishScripts(_WireFrame, frozen=True):
    """The proxy ends."""


ScriptOrder: TypeAlias = ClientConnected | MessageShown | ClientGone | ExpireCalls | FinishScripts
"""Instruction from the proxy to the scripts' process, which answers each instruction once, in order."""


class WireSentence(_WireFrame, frozen=True):
    """A message for the user: an id of the message catalogue, and the values to insert, as text."""

    id: _Word
    places: Annotated[dict[_Word, _Text], msgspec.Meta(max_length=16)]

    @property
    def message(self) -> Message:
        return Message(self.id, **self.places)


def wire_sentence(message: Message) -> WireSentence:
    """Convert each inserted value of `message` to text of at most `LONGEST_SENTENCE` characters."""
    places = {name: str(value)[:LONGEST_SENTENCE] for name, value in message.places.items()}
    return WireSentence(message.id, places)


class ScriptsLoaded(_WireFrame, frozen=True):
    hooks: frozenset[str]


class ScriptsUnusable(_WireFrame, frozen=True):
    reason: WireSentence


class ScriptAnswer(_WireFrame, frozen=True):
    """Answer of the scripts to one `ScriptOrder`.

    Attributes:
        errors: Number of errors in the scripts since the start.
        has_open_calls: True if the proxy must send `ExpireCalls` regularly.
        data: Bytes that replace the message; None if the message is unchanged.
        results: Result codes that the proxy sends to the client instead of the controller's reply.
    """

    notices: Annotated[tuple[WireSentence, ...], msgspec.Meta(max_length=MAX_SENTENCES)] = ()
    errors: int = 0
    has_open_calls: bool = False
    data: bytes | None = None
    dropped: bool = False
    results: Annotated[tuple[_Result, ...], msgspec.Meta(max_length=64)] = ()


ScriptStatement: TypeAlias = ScriptsLoaded | ScriptsUnusable | ScriptAnswer
"""Message from the scripts' process. Only the first message says whether the scripts are usable."""

_encoder = msgspec.msgpack.Encoder()


def pack(frame: ScriptOrder | ScriptStatement) -> bytes:
    body = _encoder.encode(frame)
    return len(body).to_bytes(_HEAD, "little") + body


class FrameUnpacker(Generic[T]):
    """Splits received bytes into messages. `kinds` is a union of message types, such as `ScriptOrder`."""

    def __init__(self, kinds: Any) -> None:
        self._decoder: msgspec.msgpack.Decoder[T] = msgspec.msgpack.Decoder(kinds)
        self._buffer = bytearray()

    def feed_bytes(self, data: bytes) -> None:
        self._buffer += data

    def next_frame(self) -> T | None:
        """Return the next message; None if its end is still missing. Invalid bytes raise a `WireError`."""
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
