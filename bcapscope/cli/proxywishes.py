"""What is wished of the process that watches a proxy, and how it is started: light, as the relay loads it."""

from __future__ import annotations

import sys
from dataclasses import dataclass
from enum import StrEnum
from multiprocessing.connection import Connection
from pathlib import Path

from bcapscope.capture.series import Bounds
from bcapscope.cli.exits import Exit
from bcapscope.render.moment import Clock
from bcapscope.traffic.fields import RecordKind
from bcapscope.traffic.filters import Filter, compile_filter

BEGIN, FAREWELL, READY = b"begin", b"farewell", b"ready"
"""What the relay says when the process may begin to watch, what it asks before it ends, and what it waits for
before it begins. Anything else that it says is advice for the user, for the case that it is too slow."""

INCOMPLETE = int(Exit.UNWRITABLE)
"""Exit code of the process if the recording lacks something."""


class Form(StrEnum):
    """How each is written."""

    LINE = "line"
    TREE = "tree"
    JSON = "json"


@dataclass(frozen=True, slots=True)
class Look:
    """What is shown.

    Attributes:
        shown: frames, calls, or nothing.
        form: how.
        wanted: the expression that chooses them; "" for all.
        clock: how the time is told.
    """

    shown: RecordKind | None
    form: Form = Form.LINE
    wanted: str = ""
    clock: Clock = Clock.RELATIVE

    def filter(self) -> Filter | None:
        """Compile the expression.

        Raises:
            FilterError: it makes no sense.
        """
        if not self.wanted:
            return None
        return compile_filter(self.wanted, self.shown or RecordKind.FRAME)


@dataclass(frozen=True, slots=True)
class Wishes:
    """What is to be done with what passes.

    Attributes:
        record: a capture to write; None for none.
        bounds: makes a ring of files of it.
        look: what is shown.
        color: as the option has it.
    """

    record: Path | None
    bounds: Bounds | None
    look: Look
    color: str


def watch(memory: str, relay: Connection, wishes: Wishes) -> None:
    """Watch a relay until it ends; the entry of a process, which exits with `INCOMPLETE` if so.

    Args:
        memory: name of the ring's.
        relay: over which it asks and is answered; its end is the relay's.
        wishes: what is to be done.
    """
    from bcapscope.cli.proxywatch import watch_relay

    try:
        relay.recv_bytes()
    except (EOFError, OSError):  # the relay has given up
        return
    if not watch_relay(memory, relay, wishes):
        sys.exit(INCOMPLETE)
