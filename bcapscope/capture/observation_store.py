"""Observations on disk: fast access to any of millions, in constant memory.

One process writes while others read. The format is the same for observations from a file, an interface, a
proxy or a client.
"""

from __future__ import annotations

import struct
from collections.abc import Sequence
from pathlib import Path

import msgspec

from bcapscope.capture.append_log import AppendLogReader, AppendLogWriter, CachedFileReader
from bcapscope.messages.message_codec import decode_message, encode_message
from bcapscope.protocol.codec.frame import Frame, Malformed, Problem
from bcapscope.protocol.codec.frame_template import FrameTemplates
from bcapscope.traffic.call_kind import CallKind
from bcapscope.traffic.filter.getters import AnnotatedFrame
from bcapscope.traffic.observation import Conversation, Direction, Endpoint, Flow, Observation, Transport

MAX_FLOWS = 4096
"""Maximum number of conversations that the writer and each reader keep in memory."""

_FRAMES, _CONVERSATIONS = "frames", "conversations"
_HEAD = struct.Struct("<qqQQiIIIB")
"""Head of a record, little-endian: arrival time of the last and the first byte (ns since 1970), packet
number, offset of the conversation, function id; sizes of the command, the item and the rare fields in bytes;
flags."""

_RESPONSE, _MALFORMED, _HAS_CALL_KIND, _HAS_COMMAND = 1, 2, 4, 8
_SIZE = struct.Struct("<I")
_RareFields = tuple[int, list[tuple[int, bytes, bytes]], list[bytes]]
"""Missing bytes, problems and comments. Few observations have any."""

_encode = msgspec.msgpack.encode
_rare_fields_decoder = msgspec.msgpack.Decoder(_RareFields)
_Ends = tuple[bytes, int, bytes, int, str, bytes]
_ends_decoder = msgspec.msgpack.Decoder(_Ends)


def encode_text(text: str) -> bytes:
    """Encode any text as UTF-8, including lone surrogates."""
    return text.encode("utf-8", "surrogatepass")


def decode_text(data: bytes) -> str:
    return data.decode("utf-8", "surrogatepass")


class ObservationStoreWriter:
    """Writes observations in the order of their numbers, which start at 1."""

    def __init__(self, folder: Path) -> None:
        """Create the files in an existing folder that does not hold such files yet."""
        self._frames = AppendLogWriter(folder / _FRAMES)
        self._conversations = (folder / _CONVERSATIONS).open("xb", buffering=0)
        self._next_offset = 0
        self._offsets: dict[Conversation, int] = {}

    @property
    def count(self) -> int:
        return self._frames.count

    def add(self, observation: Observation, call_kind: CallKind | None, comments: Sequence[str] = ()) -> None:
        """Add an observation, the kind of its call, and the comments that its packet has in the capture.

        Raises:
            OSError: A file cannot be written, such as on a full disk.
        """
        _, time, began, flow, item, packet = observation
        place = self._offsets.get(flow.conversation)
        if place is None:
            place = self._write_conversation(flow.conversation)
        kind = _RESPONSE if flow.direction is Direction.RESPONSE else 0
        function_id, command = 0, b""
        if call_kind is not None:
            function_id = call_kind.function_id
            kind |= _HAS_CALL_KIND
            if call_kind.command is not None:
                kind |= _HAS_COMMAND
                command = encode_text(call_kind.command)
        raw, rest = item.raw, b""
        if isinstance(item, Malformed):
            kind |= _MALFORMED
            rest = _encode_rare_fields(item.missing, item.problems, comments)
        elif comments or item.external_problem is not None:
            rest = _encode_rare_fields(
                0, () if item.external_problem is None else (item.external_problem,), comments
            )
        head = _HEAD.pack(time, began, packet, place, function_id, len(command), len(raw), len(rest), kind)
        self._frames.add(b"".join((head, command, raw, rest)))

    def _write_conversation(self, conversation: Conversation) -> int:
        client, server = conversation.client, conversation.server
        ends: _Ends = (
            encode_text(client.host),
            client.port,
            encode_text(server.host),
            server.port,
            conversation.transport.value,
            encode_text(conversation.server_known_by),
        )
        data = _encode(ends)
        self._conversations.write(_SIZE.pack(len(data)) + data)
        if len(self._offsets) >= MAX_FLOWS:
            self._offsets.clear()
        place = self._offsets[conversation] = self._next_offset
        self._next_offset += _SIZE.size + len(data)
        return place

    def flush(self) -> None:
        """Make all added observations visible to readers.

        Raises:
            OSError: A file cannot be written, such as on a full disk.
        """
        self._frames.flush()

    def close(self) -> None:
        self._frames.close()
        self._conversations.close()


def _encode_rare_fields(missing: int, problems: Sequence[Problem], comments: Sequence[str]) -> bytes:
    coded = [
        (problem.offset, encode_text(problem.code), encode_message(problem.reason)) for problem in problems
    ]
    rest: _RareFields = (missing, coded, [encode_text(comment) for comment in comments])
    return _encode(rest)


class ObservationStore:
    """Reads the files of an `ObservationStoreWriter`, even while the writer adds observations."""

    def __init__(self, folder: Path) -> None:
        """Open the files of an `ObservationStoreWriter` in a folder.

        Raises:
            OSError: The folder holds no observations.
        """
        self._records = AppendLogReader(folder / _FRAMES)
        self._conversations = CachedFileReader(folder / _CONVERSATIONS)
        self._flows: dict[int, tuple[Flow, Flow]] = {}
        self._templates = FrameTemplates()

    def __len__(self) -> int:
        return len(self._records)

    def refresh(self) -> int:
        return self._records.refresh()

    def read_frame(self, number: int) -> AnnotatedFrame:
        """Return an observation by its number, the kind of its call, and the comments on its packet.

        Raises:
            IndexError: No observation has that number.
        """
        start = self._records.offset_of(number - 1)
        time, began, packet, place, function_id, asked, size, more, kind = _HEAD.unpack(
            self._records.read(start, _HEAD.size)
        )
        data = self._records.read(start + _HEAD.size, asked + size + more)
        question = None
        if kind & _HAS_CALL_KIND:
            question = CallKind(function_id, decode_text(data[:asked]) if kind & _HAS_COMMAND else None)
        raw = data[asked : asked + size]
        missing, problems, comments = _decode_rare_fields(data[asked + size :]) if more else (0, (), ())
        item: Frame | Malformed
        if kind & _MALFORMED:
            item = Malformed(raw, problems, missing)
        else:
            item = Frame(raw, problems[0] if problems else None, self._templates)
        flow = self._flows_at(place)[kind & _RESPONSE]
        return AnnotatedFrame(Observation(number, time, began, flow, item, packet), question, comments)

    def time_of(self, number: int) -> int:
        """Return the arrival time of an observation by its number, ns since 1970.

        Raises:
            IndexError: No observation has that number.
        """
        return int.from_bytes(
            self._records.read(self._records.offset_of(number - 1), 8), "little", signed=True
        )

    def _flows_at(self, offset: int) -> tuple[Flow, Flow]:
        pair = self._flows.get(offset)
        if pair is None:
            (size,) = _SIZE.unpack(self._conversations.read(offset, _SIZE.size))
            ends = _ends_decoder.decode(self._conversations.read(offset + _SIZE.size, size))
            client, server = Endpoint(decode_text(ends[0]), ends[1]), Endpoint(decode_text(ends[2]), ends[3])
            conversation = Conversation(client, server, Transport(ends[4]), decode_text(ends[5]))
            pair = Flow(conversation, Direction.REQUEST), Flow(conversation, Direction.RESPONSE)
            if len(self._flows) >= MAX_FLOWS:
                self._flows.clear()
            self._flows[offset] = pair
        return pair

    def close(self) -> None:
        self._records.close()
        self._conversations.close()


def _decode_rare_fields(data: bytes) -> tuple[int, tuple[Problem, ...], tuple[str, ...]]:
    missing, problems, comments = _rare_fields_decoder.decode(data)
    decoded = tuple(
        Problem(offset, decode_text(code), decode_message(reason)) for offset, code, reason in problems
    )
    return missing, decoded, tuple(map(decode_text, comments))
