"""How the watching process gives way to those whose bytes pass, and when it must not.

On two processors, beside a client and a server, the 99.9th percentile of round trips was 2.6 ms while the
watcher had a low priority (nice 10) and 0.5 ms while it had the idle one: whoever wakes goes before a program
of idle priority soon, before any other only at the end of its slice of some 3 ms. Neither is sure, as Linux
counts what each has had and looks again only at a tick, every 1 to 10 ms (sched(7), EEVDF): so between two
pieces of work, a tenth of a millisecond or two each, it also yields, which is such a look.

But beside programs that are always busy idle priority gives next to nothing, and who yields gives a whole
slice away. So the relay, which has the processor when it needs it, looks how far the watcher has come.
"""

from __future__ import annotations

import math
import os
import threading
from collections.abc import Callable
from contextlib import suppress
from enum import IntEnum
from pathlib import Path

from bcapscope.proxy.ring_buffer import RingReader, RingWriter

LATE_AFTER = 0.2
"""Seconds after which what had passed at one look is to be recorded, or shown where nothing is recorded."""

OVERDUE_AFTER = 0.4
"""The same, if it is to be recorded within a second whatever else the machine does."""

MAX_RING_SHARE = 0.5
"""Share of the ring that may wait."""

IDLE_AGAIN_AFTER = 30.0
"""Seconds without delay after which the watcher gives way again."""


class WatcherUrgency(IntEnum):
    """In what haste the watcher is."""

    NONE = 0
    """It has idle priority, and yields."""
    SOME = 1
    """It has the relay's priority, and yields."""
    ALL = 2
    """It has the relay's priority."""


class WatcherPriority:
    """Has the watcher give way as long as it keeps up."""

    def __init__(self, ring: RingWriter, set_idle: Callable[[bool], None]) -> None:
        """Have it give way.

        Args:
            ring: that it reads.
            set_idle: called with whether it is to have idle priority, when that changes.
        """
        self._ring = ring
        self._set_idle = set_idle
        self._urgency = WatcherUrgency.ALL
        self._target_position, self._target_set_at, self._last_late_at = 0, 0.0, 0.0
        self._set_urgency(WatcherUrgency.NONE)

    def update(self, now: float) -> None:
        """Look how far it has come.

        Args:
            now: s, of any clock that runs evenly.
        """
        haste = self._needed_urgency(now)
        if haste:
            self._last_late_at = max(now, self._last_late_at)
            self._set_urgency(max(haste, self._urgency))
        elif now - self._last_late_at >= IDLE_AGAIN_AFTER:
            self._set_urgency(WatcherUrgency.NONE)

    def raise_for_good(self) -> None:
        """Have it give way no more, as somebody waits for its end."""
        self._last_late_at = math.inf
        self._set_urgency(WatcherUrgency.ALL)

    def _set_urgency(self, haste: WatcherUrgency) -> None:
        before, self._urgency = self._urgency, haste
        if haste is not before:
            self._ring.urgency = haste
        if bool(haste) is not bool(before):
            self._set_idle(not haste)

    def _needed_urgency(self, now: float) -> WatcherUrgency:
        ring = self._ring
        if ring.bytes_read >= self._target_position:
            self._target_position, self._target_set_at = ring.bytes_written, now
        late = now - self._target_set_at
        if late > OVERDUE_AFTER or ring.fill_ratio > MAX_RING_SHARE:
            return WatcherUrgency.ALL
        return WatcherUrgency.SOME if late > LATE_AFTER else WatcherUrgency.NONE


def yield_function(ring: RingReader) -> Callable[[], None]:
    """Return what the watcher calls between two pieces of work, so that whoever waits has its turn.

    Args:
        ring: that it reads.
    """
    if not hasattr(os, "sched_yield"):
        return lambda: None

    def give() -> None:
        if ring.urgency < WatcherUrgency.ALL:
            os.sched_yield()

    return give


def lower_priority(niceness: int) -> None:
    """Let others go before this process.

    Args:
        niceness: added to what it has.
    """
    if hasattr(os, "sched_setscheduler"):
        with suppress(OSError):
            os.sched_setscheduler(0, os.SCHED_OTHER, os.sched_param(0))
    if hasattr(os, "nice"):
        with suppress(OSError):
            os.nice(niceness)


def idle_priority_switch(process: int) -> Callable[[bool], None]:
    """Return what gives a process idle priority, or ours again; it does nothing if it could not come back.

    Args:
        process: its number.
    """
    possible = _can_leave_idle_priority()
    ours = os.getpriority(os.PRIO_PROCESS, 0) if possible else 0

    def give(idle: bool) -> None:
        if not possible:
            return
        policy = os.SCHED_IDLE if idle else os.SCHED_OTHER
        with suppress(OSError):  # it may have ended, or one of its threads
            for thread in Path(f"/proc/{process}/task").iterdir():
                os.sched_setscheduler(int(thread.name), policy, os.sched_param(0))
                with suppress(PermissionError):  # to come back takes less
                    os.setpriority(os.PRIO_PROCESS, int(thread.name), ours)

    return give


def _can_leave_idle_priority() -> bool:
    """Try, in a thread of its own, whether idle priority can be left again: not everybody may (sched(7))."""
    if not hasattr(os, "SCHED_IDLE"):
        return False
    tried: list[bool] = []

    def attempt() -> None:
        with suppress(OSError):
            os.sched_setscheduler(0, os.SCHED_IDLE, os.sched_param(0))
            os.sched_setscheduler(0, os.SCHED_OTHER, os.sched_param(0))
            tried.append(True)

    trial = threading.Thread(target=attempt, name="trial")
    trial.start()
    trial.join()
    return bool(tried)
