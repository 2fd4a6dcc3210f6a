"""What the processes that read and search tell the screen, and how it travels through a pipe."""

from __future__ import annotations

import io
import os
import struct
import sys
from collections.abc import Iterator
from typing import BinaryIO, TypeVar

import msgspec

from bcapscope.analysis.finding import TrafficTotals

_NICE = 5
_LENGTH_PREFIX = struct.Struct("<I")
T = TypeVar("T")

STOP_READING = b"."
"""Sent after a job: its source has ended, so that what is there is all there will be."""


class ReadJob(msgspec.Struct, frozen=True):
    """What is to be read.

    Attributes:
        folder: where the journal is to be kept; it exists and is empty.
        path: a capture; "" for none.
        interface: of this machine, to capture live on; "" for none.
        follow: the capture is still being written.
        ports: where servers listen; none for 5007.
        leg: only what was captured on interfaces whose names begin so.
        language: of rendered lines, ``en`` or ``ja``.
        own_clients: the clients are our own, who are there as long as it is written.
    """

    folder: str
    path: str = ""
    interface: str = ""
    follow: bool = False
    ports: tuple[int, ...] = ()
    leg: str = ""
    language: str = "en"
    own_clients: bool = False


class ReadProgress(msgspec.Struct, tag=True, frozen=True):
    """How far reading has come.

    Attributes:
        position: bytes of the file read so far.
        size: of the file; 0 where it has none, such as a capture that goes on.
        ended: nothing more will come.
        problem: why reading ended early; "" where it did not.
        summary: what was found, in one line; "" until the end.
        clients: conversations met so far.
        packets: where the packets lie, as a capture that can be read; "" for none.
        lost: packets of a live capture for which there was no room.
    """

    position: int = 0
    size: int = 0
    ended: bool = False
    problem: str = ""
    summary: str = ""
    clients: int = 0
    packets: str = ""
    lost: int = 0


class ShownFinding(msgspec.Struct, frozen=True):
    """A finding, its strings harmless; `consequence_of` counts from 1, 0 for none."""

    rule: str
    severity: str
    sentence: str
    frames: tuple[int, ...]
    consequence_of: int
    advice: str
    source: str


class TrafficAnalysis(msgspec.Struct, tag=True, frozen=True):
    """What is to be thought of the traffic read so far.

    Attributes:
        findings: the first cause first.
        examined: how much was looked at.
        slave_sessions: about slave mode, rendered lines.
        statistics: rendered lines.
    """

    findings: tuple[ShownFinding, ...]
    examined: TrafficTotals
    slave_sessions: list[str]
    statistics: list[str]


NO_ANALYSIS = TrafficAnalysis((), TrafficTotals(0, 0, 0, 0), [], [])
"""Before anything was seen."""


class SearchRequest(msgspec.Struct, frozen=True):
    """What is to be searched for.

    Attributes:
        generation: counts the asks; answers repeat it.
        kind: ``frame`` or ``call``.
        expression: in the filter language; "" to stop searching.
    """

    generation: int
    kind: str
    expression: str


class SearchMatches(msgspec.Struct, frozen=True):
    """What was found since the last answer.

    Attributes:
        generation: of the ask.
        rows: numbers of frames, or indexes of calls plus 1, as 32-bit numbers in the machine's byte order.
        searched: how many were looked at so far.
    """

    generation: int
    rows: bytes
    searched: int


class SaveJob(msgspec.Struct, frozen=True):
    """What is to be saved: the packets of a capture with notes, in a new file.

    Attributes:
        source: the capture.
        target: the new file, which must not exist.
        notes: by number of the packet.
        max_packets: packets to take at most, since a capture may still grow; 0 for all.
    """

    source: str
    target: str
    notes: dict[int, str]
    max_packets: int = 0


def send_message(stream: BinaryIO, message: object) -> None:
    """Write a message to a pipe at once.

    Raises:
        OSError: nobody reads it any more.
    """
    data = msgspec.msgpack.encode(message)
    stream.write(_LENGTH_PREFIX.pack(len(data)) + data)
    stream.flush()


def receive_messages(stream: BinaryIO | io.RawIOBase, kind: type[T]) -> Iterator[T]:
    """Yield messages from a pipe until it is closed."""
    decoder = msgspec.msgpack.Decoder(kind)
    while len(head := _read_exactly(stream, _LENGTH_PREFIX.size)) == _LENGTH_PREFIX.size:
        data = _read_exactly(stream, *_LENGTH_PREFIX.unpack(head))
        yield decoder.decode(data)


def lower_priority() -> None:
    """Let the screen go before this process where both want the processor."""
    if sys.platform != "win32":
        os.nice(_NICE)


def _read_exactly(stream: BinaryIO | io.RawIOBase, size: int) -> bytes:
    """Read so many bytes, fewer only at the end; a pipe gives what it has."""
    data = b""
    while len(data) < size and (more := stream.read(size - len(data))):
        data += more
    return data
