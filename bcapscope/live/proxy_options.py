"""Options and entry point of the watcher. This module has few imports, because the relay also loads it."""

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
"""The relay sends `BEGIN`, and the watcher answers `READY` or the reason why it cannot start. The relay sends
`CLOSE_SESSIONS`, and the watcher answers with a JSON list of `ClosingRequests`. Apart from `BEGIN` and
`CLOSE_SESSIONS`, the relay sends only advice, which the watcher adds to its warning of a slow proxy.
"""

INCOMPLETE = 6
"""Exit code of the watcher if the recording is incomplete. Code 1 is Python's exit code after a traceback."""


class ClosingRequests(msgspec.Struct, frozen=True, array_like=True):
    """Frames that close a session that a UDP client left open. The relay sends each frame after the reply to
    the previous frame.

    If the client left slave mode on or kept the arm, `open_state` is an encoded message that says so (see
    `encode_message`). If the client only failed to release handles, `open_state` is b"".
    """

    client: int
    open_state: bytes
    requests: tuple[bytes, ...]


class TrafficFormat(StrEnum):
    LINE = "line"
    TREE = "tree"
    JSON = "json"


@dataclass(frozen=True, slots=True)
class ViewOptions:
    """Which traffic the proxy displays, and how: frames or calls, or nothing if `shown` is None."""

    shown: RecordKind | None
    form: TrafficFormat = TrafficFormat.LINE
    expression: str = ""
    time_format: TimeFormat = TimeFormat.RELATIVE
    language: Language = Language.ENGLISH

    def compiled_filter(self) -> Filter | None:
        """Raises FilterError if the filter expression is invalid."""
        if not self.expression:
            return None
        return compile_filter(self.expression, self.shown or RecordKind.FRAME)


class WatcherSubscriber(Protocol):
    """Receives the traffic that the watcher decodes. All methods return at once."""

    diagnosis: Diagnosis
    subscribers: tuple[PipelineSubscriber, ...]

    def on_frame(self, observation: Observation, note: str) -> None:
        """`note` says in the user's language how the proxy's rules affected the frame; "" if no rule did."""

    def report_if_due(self, client_count: int) -> None:
        """Send the reports that are due, even without traffic."""

    def close(self, end_time: int) -> None:
        """Process the end of the traffic. `end_time` is in ns since 1970."""


@dataclass(frozen=True, slots=True)
class ProxyOptions:
    """Options of a proxy's watcher. The watcher calls `open_subscriber`, which can raise an OSError."""

    record: Path | None
    ring: RotationLimits | None
    view: ViewOptions
    color: str
    open_subscriber: Callable[[], WatcherSubscriber] | None = None


def run_watcher(memory: str, relay: Connection, options: ProxyOptions) -> None:
    """Watch a relay until it ends: the entry point of the watcher process."""
    from bcapscope.live.proxy_watcher import watch_relay

    try:
        relay.recv_bytes()  # `BEGIN`
    except (EOFError, OSError):  # the relay has ended
        return
    if not watch_relay(memory, relay, options):
        sys.exit(INCOMPLETE)
