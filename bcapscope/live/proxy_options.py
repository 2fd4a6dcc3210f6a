"""Options and entry point of the process that watches a proxy. The relay loads this, so it imports little."""

from __future__ import annotations

import sys
from collections.abc import Callable
from dataclasses import dataclass
from enum import StrEnum
from multiprocessing.connection import Connection
from pathlib import Path
from typing import TYPE_CHECKING, Protocol

import msgspec

from bcapscope.capture.rotating_recording import RotationLimits
from bcapscope.messages import Language
from bcapscope.render.timestamp import TimeFormat
from bcapscope.traffic.filter.compiler import Filter, compile_filter
from bcapscope.traffic.filter.field_table import RecordKind

if TYPE_CHECKING:
    from bcapscope.analysis.diagnosis import Diagnosis
    from bcapscope.traffic.observation import Observation
    from bcapscope.traffic.pipeline import PipelineSubscriber

BEGIN, CLOSE_SESSIONS, READY = b"begin", b"close sessions", b"ready"
"""Messages between relay and watcher.

`BEGIN` starts the watcher, and `READY` is its answer. The answer to `CLOSE_SESSIONS` is a JSON list of
`ClosingRequests`. Any other message from the relay is advice, printed if the proxy is too slow.
"""

INCOMPLETE = 6
"""Exit code of the watcher for an incomplete recording. It is not 1, which a traceback also gives."""


class ClosingRequests(msgspec.Struct, frozen=True, array_like=True):
    """How to close the session of a UDP client in its place: frames, each sent after the reply to the last
    one.

    `open_state` says what is open besides handles, as of `encode_message`; b"" for nothing.
    """

    client: int
    open_state: bytes
    requests: tuple[bytes, ...]


class TrafficFormat(StrEnum):
    """How a frame or call is written."""

    LINE = "line"
    TREE = "tree"
    JSON = "json"


@dataclass(frozen=True, slots=True)
class ViewOptions:
    """What is displayed: frames or calls (None for nothing), those that match `expression`."""

    shown: RecordKind | None
    form: TrafficFormat = TrafficFormat.LINE
    expression: str = ""
    time_format: TimeFormat = TimeFormat.RELATIVE
    language: Language = Language.ENGLISH

    def compiled_filter(self) -> Filter | None:
        """Compile the expression; None for all.

        Raises:
            FilterError: The expression is invalid.
        """
        if not self.expression:
            return None
        return compile_filter(self.expression, self.shown or RecordKind.FRAME)


class WatcherSubscriber(Protocol):
    """Receives what the watcher decodes. All methods return at once. `subscribers` includes the diagnosis."""

    diagnosis: Diagnosis
    subscribers: tuple[PipelineSubscriber, ...]

    def on_frame(self, observation: Observation, note: str) -> None:
        """Receive a frame, with a note of what a rule did to it ("" for nothing), in the user's language."""

    def report_if_due(self, client_count: int) -> None:
        """Do what is due even without traffic; `client_count` is the number of clients so far."""

    def close(self, end_time: int) -> None:
        """Receive the end of the traffic, ns since 1970."""


@dataclass(frozen=True, slots=True)
class ProxyOptions:
    """What the watcher does with the traffic. Its process calls `open_subscriber`, which can raise an
    OSError.
    """

    record: Path | None
    ring: RotationLimits | None
    view: ViewOptions
    color: str
    open_subscriber: Callable[[], WatcherSubscriber] | None = None


def run_watcher(memory: str, relay: Connection, options: ProxyOptions) -> None:
    """Watch a relay until it ends; the entry point of the process. Exit with `INCOMPLETE` if that applies."""
    from bcapscope.live.proxy_watcher import watch_relay

    try:
        relay.recv_bytes()
    except (EOFError, OSError):  # the relay has ended
        return
    if not watch_relay(memory, relay, options):
        sys.exit(INCOMPLETE)
