"""Observations kept on disk, so that any of a million is at hand at once and none takes memory.

One process writes while others read. All sources are alike in it: what a file, an interface, a proxy or a
client saw.
"""

from __future__ import annotations

import struct
from collections.abc import Sequence
from pathlib import Path

import msgspec

from bcapscope.capture.spool import Appender, Records, Window
from bcapscope.protocol.frame import Frame, Malformed, Problem
from bcapscope.traffic.getters import Told
from bcapscope.traffic.observation import Conversation, Direction, Endpoint, Flow, Observation, Transport
from bcapscope.traffic.question import Question

MOST_FLOWS = 4096
"""Conversations of which the texts are kept in memory, by writer and reader."""

_FRAMES, _CONVERSATIONS = "frames", "conversations"
_HEAD = struct.Struct("<qqQQIIIIB")
"""Time, when it began, packet, place of the conversation; function id; bytes of command, item and the rest;
what it is."""

_RESPONSE, _MALFORMED, _QUESTION, _COMMAND = 1, 2, 4, 8
_SIZE = struct.Struct("<I")
_Rest = tuple[int, list[tuple[int, bytes, bytes]], list[bytes]]
"""Missing bytes, problems, comments: what few observations have."""

_encode = msgspec.msgpack.encode
_rest_decoder = msgspec.msgpack.Decoder(_Rest)
_Ends = tuple[bytes, int, bytes, int, str, bytes]
_ends_decoder = msgspec.msgpack.Decoder(_Ends)


def to_bytes(text: str) -> bytes:
    """Encode any text, lone surrogates too."""
    return text.encode("utf-8", "surrogatepass")


def to_text(data: bytes) -> str:
    """Decode what `to_bytes` encoded."""
    return data.decode("utf-8", "surrogatepass")


class JournalWriter:
    """Writes observations, in their order and from number 1 on."""

    def __init__(self, folder: Path) -> None:
        """Begin a journal in a folder that exists and has none."""
        self._frames = Appender(folder / _FRAMES)
        self._conversations = (folder / _CONVERSATIONS).open("xb", buffering=0)
        self._place = 0
        self._known: dict[Conversation, int] = {}

    @property
    def count(self) -> int:
        """Observations so far."""
        return self._frames.count

    def add(self, seen: Observation, question: Question | None, comments: Sequence[str] = ()) -> None:
        """Note an observation, what is known about it and what the capture has on its packet.

        Raises:
            OSError: there is no room.
        """
        _, time, began, flow, item, packet = seen
        place = self._known.get(flow.conversation)
        if place is None:
            place = self._meet(flow.conversation)
        kind = _RESPONSE if flow.direction is Direction.RESPONSE else 0
        function_id, command = 0, b""
        if question is not None:
            function_id = question.function_id
            kind |= _QUESTION
            if question.command is not None:
                kind |= _COMMAND
                command = to_bytes(question.command)
        raw, rest = item.raw, b""
        if isinstance(item, Malformed):
            kind |= _MALFORMED
            rest = _rest(item.missing, item.problems, comments)
        elif comments or item.note is not None:
            rest = _rest(0, () if item.note is None else (item.note,), comments)
        head = _HEAD.pack(time, began, packet, place, function_id, len(command), len(raw), len(rest), kind)
        self._frames.add(b"".join((head, command, raw, rest)))

    def _meet(self, conversation: Conversation) -> int:
        client, server = conversation.client, conversation.server
        ends: _Ends = (
            to_bytes(client.host),
            client.port,
            to_bytes(server.host),
            server.port,
            conversation.transport.value,
            to_bytes(conversation.side_known_by),
        )
        data = _encode(ends)
        self._conversations.write(_SIZE.pack(len(data)) + data)
        if len(self._known) >= MOST_FLOWS:
            self._known.clear()
        place = self._known[conversation] = self._place
        self._place += _SIZE.size + len(data)
        return place

    def flush(self) -> None:
        """Let readers see all that was added.

        Raises:
            OSError: there is no room.
        """
        self._frames.flush()

    def close(self) -> None:
        """Close the files."""
        self._frames.close()
        self._conversations.close()


def _rest(missing: int, problems: Sequence[Problem], comments: Sequence[str]) -> bytes:
    told = [(problem.offset, to_bytes(problem.code), to_bytes(problem.reason)) for problem in problems]
    rest: _Rest = (missing, told, [to_bytes(comment) for comment in comments])
    return _encode(rest)


class Journal:
    """Reads what a `JournalWriter` wrote, while it does."""

    def __init__(self, folder: Path) -> None:
        """Open the journal of a folder.

        Raises:
            OSError: there is none.
        """
        self._records = Records(folder / _FRAMES)
        self._conversations = Window(folder / _CONVERSATIONS)
        self._flows: dict[int, tuple[Flow, Flow]] = {}

    def __len__(self) -> int:
        """How many observations there were when `refresh` was called last."""
        return len(self._records)

    def refresh(self) -> int:
        """Look how many there are by now."""
        return self._records.refresh()

    def told(self, number: int) -> Told:
        """Read an observation by its number, with what is known about it.

        Raises:
            IndexError: there is none of that number.
        """
        start = self._records.place(number - 1)
        time, began, packet, place, function_id, asked, size, more, kind = _HEAD.unpack(
            self._records.read(start, _HEAD.size)
        )
        data = self._records.read(start + _HEAD.size, asked + size + more)
        question = None
        if kind & _QUESTION:
            question = Question(function_id, to_text(data[:asked]) if kind & _COMMAND else None)
        raw = data[asked : asked + size]
        missing, problems, comments = _read_rest(data[asked + size :]) if more else (0, (), ())
        item: Frame | Malformed
        if kind & _MALFORMED:
            item = Malformed(raw, problems, missing)
        else:
            item = Frame(raw, problems[0] if problems else None)
        flow = self._pair(place)[kind & _RESPONSE]
        return Told(Observation(number, time, began, flow, item, packet), question, comments)

    def time(self, number: int) -> int:
        """Read when an observation was made.

        Raises:
            IndexError: there is none of that number.
        """
        return int.from_bytes(self._records.read(self._records.place(number - 1), 8), "little", signed=True)

    def _pair(self, place: int) -> tuple[Flow, Flow]:
        pair = self._flows.get(place)
        if pair is None:
            (size,) = _SIZE.unpack(self._conversations.read(place, _SIZE.size))
            ends = _ends_decoder.decode(self._conversations.read(place + _SIZE.size, size))
            client, server = Endpoint(to_text(ends[0]), ends[1]), Endpoint(to_text(ends[2]), ends[3])
            conversation = Conversation(client, server, Transport(ends[4]), to_text(ends[5]))
            pair = Flow(conversation, Direction.REQUEST), Flow(conversation, Direction.RESPONSE)
            if len(self._flows) >= MOST_FLOWS:
                self._flows.clear()
            self._flows[place] = pair
        return pair

    def close(self) -> None:
        """Close the files."""
        self._records.close()
        self._conversations.close()


def _read_rest(data: bytes) -> tuple[int, tuple[Problem, ...], tuple[str, ...]]:
    missing, problems, comments = _rest_decoder.decode(data)
    told = tuple(Problem(offset, to_text(code), to_text(reason)) for offset, code, reason in problems)
    return missing, told, tuple(map(to_text, comments))
