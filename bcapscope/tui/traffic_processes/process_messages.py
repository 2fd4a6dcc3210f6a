"""Messages between the screen and the processes that read, search and save traffic."""

from __future__ import annotations

import io
import json
import os
import signal
import sys
from collections.abc import Iterator
from typing import BinaryIO, TypeVar

import msgspec

from bcapscope.analysis.finding import TrafficTotals
from bcapscope.capture.append_log import write_all
from bcapscope.messages import Language, Message, MessageFormatter
from bcapscope.render.escape import printable
from bcapscope.traffic.capture_point import CapturePoint

_NICE = 5
T = TypeVar("T")

STOP_READING = b"."
"""Message to the reader process: no more traffic will arrive. The reader reads the remaining data, and ends.
"""


class ReadJob(msgspec.Struct, frozen=True, kw_only=True):
    """Job for the reader process or for a proxy's watcher: which traffic to read for the screen."""

    path: str = ""  # path of the capture file or watcher's recording; "" for a live capture
    interface: str = ""  # network interface for a live capture; "" to read a file
    follow: bool = False  # whether another program is still writing the capture
    ports: tuple[int, ...] = ()  # ports of controllers; an empty tuple selects port 5007
    leg: str = ""  # read only interfaces whose names begin with this prefix
    language: str = "en"  # language of rendered lines: "en" or "ja"
    own_clients: bool = False  # whether bcapscope is the client; a silent client then counts as connected
    taken_at: CapturePoint | None = None  # None to infer the place from the traffic
    folder: str = ""  # empty folder for the journal


class ReadProgress(msgspec.Struct, tag=True, frozen=True):
    """The progress of reading a file or a live capture."""

    position: int = 0  # bytes that have been read
    size: int = 0  # bytes in the file; 0 for a live capture
    ended: bool = False
    problem: str = ""  # why reading ended early, if it did
    clients: int = 0  # conversations so far
    packets: str = ""  # path of the capture file with the packets; "" if there is none
    lost: int = 0  # packets that a live capture dropped because its buffer was full


class ShownFinding(msgspec.Struct, frozen=True):
    """A finding as the screen shows it. All strings are escaped."""

    rule: str
    severity: str
    sentence: dict[str, str]  # by language
    frames: tuple[int, ...]
    consequence_of: int  # number of the finding that is the cause, from 1; 0 for no cause
    advice: dict[str, str]  # by language
    source: str


class TrafficAnalysis(msgspec.Struct, tag=True, frozen=True):
    """The analysis of the traffic read so far: findings with root causes first, and rendered lines."""

    findings: tuple[ShownFinding, ...]
    examined: TrafficTotals
    slave_sessions: list[str]
    statistics: list[str]


NO_ANALYSIS = TrafficAnalysis((), TrafficTotals(0, 0, 0, 0), [], [])
"""The analysis before any traffic."""


class SearchRequest(msgspec.Struct, frozen=True):
    """A request to search the frames or the calls."""

    generation: int  # number of the search; all matches of this search carry the same number
    kind: str  # "frame" or "call"
    expression: str  # "" stops the search


class SearchMatches(msgspec.Struct, frozen=True):
    """The matches that a search has found since its last report."""

    generation: int
    rows: bytes  # numbers of the frames or calls, from 1, as 32-bit numbers in native byte order
    searched: int  # rows that the search has examined so far


class SaveJob(msgspec.Struct, frozen=True):
    """A job of the save process: which packets to write to which new file."""

    source: str
    target: str  # must not exist
    notes: dict[int, str]  # by packet number
    max_packets: int = 0  # maximum number of packets to save from a growing capture; 0 for no limit
    language: str = "en"


def problem_text(problem: Message | None, job: ReadJob | SaveJob) -> str:
    """Return the escaped text of a problem in the language of `job`; "" for no problem."""
    return "" if problem is None else printable(MessageFormatter(Language(job.language)).text(problem))


def send_message(stream: BinaryIO | io.RawIOBase, message: object) -> None:
    """Write a message to a pipe; raises `OSError` if the process that reads the pipe has gone."""
    try:
        data = msgspec.json.encode(message)
    except UnicodeEncodeError:
        # `json` encodes file names that are not UTF-8, but is up to 50 times slower than `msgspec`
        data = json.dumps(msgspec.to_builtins(message, str_keys=True)).encode()
    write_all(stream, data + b"\n")
    stream.flush()


def receive_messages(stream: BinaryIO | io.RawIOBase, kind: type[T]) -> Iterator[T]:
    """Yield messages from a pipe until it is closed."""
    decoder = msgspec.json.Decoder(kind)
    while (line := stream.readline()).endswith(b"\n"):
        try:
            message = decoder.decode(line)
        except msgspec.DecodeError:
            message = msgspec.convert(json.loads(line), kind, str_keys=True)
        yield message


def begin_process() -> None:
    """Lower the priority of this process, and ignore Ctrl-C, because the screen uses Ctrl-C as a key."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    if sys.platform != "win32":
        os.nice(_NICE)
