"""What is wished of the process that watches a proxy, and how it is started: light, as the relay loads it."""

from __future__ import annotations

import sys
from dataclasses import dataclass
from enum import StrEnum
from multiprocessing.connection import Connection
from pathlib import Path

from bcapscope.capture.rotating_recording import RotationLimits
from bcapscope.render.timestamp import TimeFormat
from bcapscope.traffic.filter.compiler import Filter, compile_filter
from bcapscope.traffic.filter.field_table import RecordKind

BEGIN, CLOSE_SESSIONS, READY = b"begin", b"farewell", b"ready"
"""What the relay says when the process may begin to watch, what it asks before it ends, and what it waits for
before it begins. Anything else that it says is advice for the user, for the case that it is too slow."""

INCOMPLETE = 6
"""Exit code of the process if the recording lacks something; not 1, which a traceback also gives."""


class TrafficFormat(StrEnum):
    """How each is written."""

    LINE = "line"
    TREE = "tree"
    JSON = "json"


@dataclass(frozen=True, slots=True)
class ViewOptions:
    """What is shown.

    Attributes:
        shown: frames, calls, or nothing.
        form: how.
        expression: the expression that chooses them; "" for all.
        time_format: how the time is told.
    """

    shown: RecordKind | None
    form: TrafficFormat = TrafficFormat.LINE
    expression: str = ""
    time_format: TimeFormat = TimeFormat.RELATIVE

    def compiled_filter(self) -> Filter | None:
        """Compile the expression.

        Raises:
            FilterError: it makes no sense.
        """
        if not self.expression:
            return None
        return compile_filter(self.expression, self.shown or RecordKind.FRAME)


@dataclass(frozen=True, slots=True)
class ProxyOptions:
    """What is to be done with what passes.

    Attributes:
        record: a capture to write; None for none.
        ring: makes a ring of files of it.
        view: what is shown.
        color: as the option has it.
    """

    record: Path | None
    ring: RotationLimits | None
    view: ViewOptions
    color: str


def run_watcher(memory: str, relay: Connection, options: ProxyOptions) -> None:
    """Watch a relay until it ends; the entry of a process, which exits with `INCOMPLETE` if so.

    Args:
        memory: name of the ring's.
        relay: over which it asks and is answered; its end is the relay's.
        options: what is to be done.
    """
    from bcapscope.live.proxy_watcher import watch_relay

    try:
        relay.recv_bytes()
    except (EOFError, OSError):  # the relay has given up
        return
    if not watch_relay(memory, relay, options):
        sys.exit(INCOMPLETE)
