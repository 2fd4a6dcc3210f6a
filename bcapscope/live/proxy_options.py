"""Options and entry point of the watcher, the process that watches a proxy's traffic.

The relay also loads this module, so the module imports little.
"""

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

The relay sends `BEGIN`, and the watcher answers with `READY`. The relay sends `CLOSE_SESSIONS`, and the
watcher answers with a JSON list of `ClosingRequests`. A message from the relay that is neither `BEGIN` nor
`CLOSE_SESSIONS` is advice for the user. When the watcher warns the user of a slow proxy, the watcher adds the
relay's latest advice.
"""

INCOMPLETE = 6
"""Exit code of the watcher if the recording is incomplete.

The code differs from 1, because Python exits with 1 after a traceback.
"""


class ClosingRequests(msgspec.Struct, frozen=True, array_like=True):
    """Frames that the proxy sends to close a session, if a UDP client left this session open. The proxy sends
    each frame after the reply to the previous frame.

    `open_state` is an encoded message (see `encode_message`). The message says whether the client left slave
    mode on, kept the arm, or both. If the client left only open handles, `open_state` is b"".
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
    """Which traffic the proxy displays, and how. `shown` selects frames or calls. If `shown` is None, the
    proxy displays no traffic.
    """

    shown: RecordKind | None
    form: TrafficFormat = TrafficFormat.LINE
    expression: str = ""
    time_format: TimeFormat = TimeFormat.RELATIVE
    language: Language = Language.ENGLISH

    def compiled_filter(self) -> Filter | None:
        """Return the filter; None if there is none.

        Raises:
            FilterError: The filter expression is invalid.
        """
        if not self.expression:
            return None
        return compile_filter(self.expression, self.shown or RecordKind.FRAME)


class WatcherSubscriber(Protocol):
    """Receives the traffic that the watcher decodes. All methods return at once. `subscribers` contains the
    diagnosis and other subscribers of the pipeline.
    """

    diagnosis: Diagnosis
    subscribers: tuple[PipelineSubscriber, ...]

    def on_frame(self, observation: Observation, note: str) -> None:
        """Receive a frame. `note` says in the user's language how the proxy's rules affected the frame; "" if
        no rule did.
        """

    def report_if_due(self, client_count: int) -> None:
        """Send the reports that are due, even without traffic. `client_count` is the number of clients so
        far.
        """

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
    """Watch a relay until the relay ends; exit with `INCOMPLETE` if the recording is incomplete. This
    function is the entry point of the watcher process.
    """
    from bcapscope.live.proxy_watcher import watch_relay

    try:
        relay.recv_bytes()  # `BEGIN`
    except (EOFError, OSError):  # the relay has ended
        return
    if not watch_relay(memory, relay, options):
        sys.exit(INCOMPLETE)
