"""How the watcher gives way to the programs whose bytes the relay forwards, and when it must not.

Measured on two processors, beside a client and a server: the 99.9th percentile of round trips was 2.6 ms with
a low priority of the watcher (nice 10), and 0.5 ms with idle priority. A process that wakes up soon replaces
one of idle priority. It replaces any other only at the end of its slice of about 3 ms.

Neither is certain. Linux accounts for past run time and decides again only at a tick, every 1 to 10 ms
(sched(7), EEVDF). So the watcher also yields between two pieces of work of 0.1 or 0.2 ms each, which makes
Linux decide.

Beside programs that are always busy, idle priority gets almost no processor time, and a yield gives a whole
slice away. So the relay, which always gets the processor, checks how far the watcher has read.
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
"""Seconds within which the watcher should record written records, or display them if nothing is recorded."""

OVERDUE_AFTER = 0.4
"""Seconds of delay that call for `WatcherUrgency.ALL`, so that everything is recorded within a second,
whatever else the machine does.
"""

MAX_RING_SHARE = 0.5
"""Highest share of the ring that may wait for the watcher."""

IDLE_AGAIN_AFTER = 30.0
"""Seconds without delay after which the watcher returns to idle priority."""


class WatcherUrgency(IntEnum):
    """How urgently the watcher needs the processor."""

    NONE = 0
    """It has idle priority, and yields."""
    SOME = 1
    """It has the relay's priority, and yields."""
    ALL = 2
    """It has the relay's priority."""


class WatcherPriority:
    """Gives the watcher idle priority while it keeps up."""

    def __init__(self, ring: RingWriter, set_idle: Callable[[bool], None]) -> None:
        """Start with idle priority. `set_idle` is called when idle priority is to change, with True for
        idle.
        """
        self._ring = ring
        self._set_idle = set_idle
        self._urgency = WatcherUrgency.ALL
        self._target_position, self._target_set_at, self._last_late_at = 0, 0.0, 0.0
        self._set_urgency(WatcherUrgency.NONE)

    def update(self, now: float) -> None:
        """Check how far the watcher has read, and adapt its priority. `now` is in seconds of a steady
        clock.
        """
        haste = self._needed_urgency(now)
        if haste:
            self._last_late_at = max(now, self._last_late_at)
            self._set_urgency(max(haste, self._urgency))
        elif now - self._last_late_at >= IDLE_AGAIN_AFTER:
            self._set_urgency(WatcherUrgency.NONE)

    def raise_for_good(self) -> None:
        """Keep the watcher at full urgency from now on, because the user waits for its end."""
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
    """Return a function that yields the processor; the watcher calls it between two pieces of work."""
    if not hasattr(os, "sched_yield"):
        return lambda: None

    def give() -> None:
        if ring.urgency < WatcherUrgency.ALL:
            os.sched_yield()

    return give


def lower_priority(niceness: int) -> None:
    """Lower the priority of this process by adding to its nice value."""
    if hasattr(os, "sched_setscheduler"):
        with suppress(OSError):
            os.sched_setscheduler(0, os.SCHED_OTHER, os.sched_param(0))
    if hasattr(os, "nice"):
        with suppress(OSError):
            os.nice(niceness)


def idle_priority_switch(process: int) -> Callable[[bool], None]:
    """Return a function that switches a process to idle priority (True) or back to this process's priority.

    It does nothing on systems where the process could not leave idle priority again.
    """
    possible = _can_leave_idle_priority()
    ours = os.getpriority(os.PRIO_PROCESS, 0) if possible else 0

    def give(idle: bool) -> None:
        if not possible:
            return
        policy = os.SCHED_IDLE if idle else os.SCHED_OTHER
        with suppress(OSError):  # the process, or one of its threads, may have ended
            for thread in Path(f"/proc/{process}/task").iterdir():
                os.sched_setscheduler(int(thread.name), policy, os.sched_param(0))
                with suppress(PermissionError):  # leaving idle priority needs fewer rights
                    os.setpriority(os.PRIO_PROCESS, int(thread.name), ours)

    return give


def _can_leave_idle_priority() -> bool:
    """Test in a separate thread whether a process may leave idle priority; not every user may (sched(7))."""
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
