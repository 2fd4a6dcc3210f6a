"""Observations on disk. A store can hold millions of observations.

One process writes the store while other processes read it. Reading one observation takes constant memory.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import msgspec

from bcapscope.capture.append_log import AppendLogReader, AppendLogWriter
from bcapscope.messages.message_codec import decode_message, encode_message
from bcapscope.protocol.codec.frame import Frame, Malformed, Problem
from bcapscope.protocol.codec.frame_template import FrameTemplates
from bcapscope.traffic.call_kind import CallKind
from bcapscope.traffic.filter.getters import AnnotatedFrame
from bcapscope.traffic.observation import (
    Conversation,
    Direction,
    Endpoint,
    Flow,
    Observation,
    ServerEvidence,
    ServerEvidenceKind,
    Transport,
)

MAX_FLOWS = 4096
"""Maximum number of conversations that the writer and each reader keep in memory."""

_FRAMES, _CONVERSATIONS = "frames", "conversations"


class _FrameRecord(msgspec.Struct, array_like=True):
    """Stored form of an observation. Text is stored as bytes (see `encode_text`). `function_id` is None if
    the kind of the call is unknown. `missing` is None for a frame. `problems` holds the offset, code and
    reason of problems. For a frame, `problems` holds only the problem that the bytes in `raw` do not show.
    """

    time: int
    began: int
    packet: int
    conversation: int
    is_reply: bool
    function_id: int | None
    command: bytes | None
    raw: bytes
    missing: int | None = None
    problems: list[tuple[int, bytes, bytes]] = []
    comments: list[bytes] = []


_encode = msgspec.msgpack.encode
_frame_decoder = msgspec.msgpack.Decoder(_FrameRecord)
_Ends = tuple[bytes, int, bytes, int, str, str, int]
_ends_decoder = msgspec.msgpack.Decoder(_Ends)


def encode_text(text: str) -> bytes:
    """Encode any text as UTF-8, including lone surrogates."""
    return text.encode("utf-8", "surrogatepass")


def decode_text(data: bytes) -> str:
    return data.decode("utf-8", "surrogatepass")


class ObservationStoreWriter:
    def __init__(self, folder: Path) -> None:
        """Create the files in a folder that holds no store yet. The first observation has number 1."""
        self._frames = AppendLogWriter(folder / _FRAMES)
        self._conversations = AppendLogWriter(folder / _CONVERSATIONS)
        self._numbers: dict[Conversation, int] = {}

    @property
    def count(self) -> int:
        return self._frames.count

    def add(self, observation: Observation, call_kind: CallKind | None, comments: Sequence[str] = ()) -> None:
        _, time, began, flow, item, packet = observation
        number = self._numbers.get(flow.conversation)
        if number is None:
            number = self._add_conversation(flow.conversation)
        record = _FrameRecord(
            time,
            began,
            packet,
            number,
            flow.direction is Direction.RESPONSE,
            None if call_kind is None else call_kind.function_id,
            None if call_kind is None or call_kind.command is None else encode_text(call_kind.command),
            item.raw,
        )
        if isinstance(item, Malformed):
            record.missing, record.problems = item.missing, _encode_problems(item.problems)
        elif item.external_problem is not None:
            record.problems = _encode_problems((item.external_problem,))
        if comments:
            record.comments = [encode_text(comment) for comment in comments]
        self._frames.add(_encode(record))

    def _add_conversation(self, conversation: Conversation) -> int:
        client, server = conversation.client, conversation.server
        ends: _Ends = (
            encode_text(client.host),
            client.port,
            encode_text(server.host),
            server.port,
            conversation.transport.value,
            *conversation.server_evidence,
        )
        if len(self._numbers) >= MAX_FLOWS:
            self._numbers.clear()
        number = self._numbers[conversation] = self._conversations.count
        self._conversations.add(_encode(ends))
        return number

    def flush(self) -> None:
        """Make all added observations visible to readers, or raise OSError."""
        self._conversations.flush()
        self._frames.flush()

    def close(self) -> None:
        self._frames.close()
        self._conversations.close()


def _encode_problems(problems: Sequence[Problem]) -> list[tuple[int, bytes, bytes]]:
    return [(each.offset, encode_text(each.code), encode_message(each.reason)) for each in problems]


def _decode_problems(problems: Sequence[tuple[int, bytes, bytes]]) -> tuple[Problem, ...]:
    return tuple(
        Problem(offset, decode_text(code), decode_message(reason)) for offset, code, reason in problems
    )


class ObservationStore:
    def __init__(self, folder: Path) -> None:
        self._records = AppendLogReader(folder / _FRAMES)
        self._conversations = AppendLogReader(folder / _CONVERSATIONS)
        self._flows: dict[int, tuple[Flow, Flow]] = {}
        self._templates = FrameTemplates()

    def __len__(self) -> int:
        return len(self._records)

    def refresh(self) -> int:
        return self._records.refresh()

    def read_frame(self, number: int) -> AnnotatedFrame:
        """Return an observation by its number, with the kind of its call and the comments on its packet.

        Raises:
            IndexError: No observation has this number.
        """
        record = _frame_decoder.decode(self._records.read_record(number - 1))
        kind = None
        if record.function_id is not None:
            command = None if record.command is None else decode_text(record.command)
            kind = CallKind(record.function_id, command)
        problems = _decode_problems(record.problems) if record.problems else ()
        item: Frame | Malformed
        if record.missing is not None:
            item = Malformed(record.raw, problems, record.missing)
        else:
            item = Frame(record.raw, problems[0] if problems else None, self._templates)
        flow = self._flows_of(record.conversation)[record.is_reply]
        observation = Observation(number, record.time, record.began, flow, item, record.packet)
        comments = tuple(map(decode_text, record.comments)) if record.comments else ()
        return AnnotatedFrame(observation, kind, comments)

    def time_of(self, number: int) -> int:
        """Return the arrival time of an observation, ns since 1970, or raise IndexError."""
        return _frame_decoder.decode(self._records.read_record(number - 1)).time

    def _flows_of(self, number: int) -> tuple[Flow, Flow]:
        pair = self._flows.get(number)
        if pair is None:
            ends = _ends_decoder.decode(self._conversations.read_record(number))
            client, server = Endpoint(decode_text(ends[0]), ends[1]), Endpoint(decode_text(ends[2]), ends[3])
            conversation = Conversation(
                client, server, Transport(ends[4]), ServerEvidence(ServerEvidenceKind(ends[5]), ends[6])
            )
            pair = Flow(conversation, Direction.REQUEST), Flow(conversation, Direction.RESPONSE)
            if len(self._flows) >= MAX_FLOWS:
                self._flows.clear()
            self._flows[number] = pair
        return pair

    def close(self) -> None:
        self._records.close()
        self._conversations.close()
