"""Controls the priority of the watcher, so that the watcher does not delay the relay and other programs.

Measured 99.9th percentile of round trips, with a client and a server on the same two processors: 2.6 ms with
the watcher at nice 10, 0.5 ms at idle priority. When another process wakes up, Linux interrupts a process of
idle priority at once. Linux may let a process of normal priority complete its time slice of about 3 ms.
Sometimes, the other process must wait, because Linux interrupts the watcher only at the next timer tick.
Timer ticks are 1 to 10 ms apart (sched(7), EEVDF). The watcher therefore also yields the processor after each
0.1 or 0.2 ms of work.

If other programs are always busy, a process of idle priority gets almost no processor time, and `sched_yield`
costs a whole time slice. If the watcher reads too slowly, the relay raises the watcher's priority.
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
"""If the watcher does not read new records within this many seconds, the relay raises the priority of the
watcher.
"""

OVERDUE_AFTER = 0.4
"""If the watcher does not read new records within this many seconds, the relay sets the highest
`WatcherUrgency`. This limit keeps the recording at most a second behind the traffic.
"""

MAX_RING_SHARE = 0.5
"""If unread records fill more than this share of the ring, the relay sets the highest `WatcherUrgency`."""

IDLE_AGAIN_AFTER = 30.0
"""The watcher returns to idle priority after it has kept up with the traffic for this many seconds."""


class WatcherUrgency(IntEnum):
    NONE = 0
    """The watcher has idle priority, and yields the processor between pieces of work."""
    SOME = 1
    """The watcher has normal priority, and yields the processor between pieces of work."""
    ALL = 2
    """The watcher has normal priority, and does not yield the processor."""


class WatcherPriority:
    """Gives the watcher idle priority while the watcher keeps up with the traffic."""

    def __init__(self, ring: RingWriter, set_idle: Callable[[bool], None]) -> None:
        """Start at idle priority. `set_idle` switches to idle priority (True) or normal priority (False)."""
        self._ring = ring
        self._set_idle = set_idle
        self._urgency = WatcherUrgency.ALL
        self._target_position, self._target_set_at, self._last_late_at = 0, 0.0, 0.0
        self._set_urgency(WatcherUrgency.NONE)

    def update(self, now: float) -> None:
        """Check how far the watcher has read, and adapt its priority. `now` is monotonic, in seconds."""
        needed = self._needed_urgency(now)
        if needed:
            self._last_late_at = max(now, self._last_late_at)
            self._set_urgency(max(needed, self._urgency))
        elif now - self._last_late_at >= IDLE_AGAIN_AFTER:
            self._set_urgency(WatcherUrgency.NONE)

    def raise_for_good(self) -> None:
        """Set the highest urgency and keep it, because the user now waits for the watcher to end."""
        self._last_late_at = math.inf
        self._set_urgency(WatcherUrgency.ALL)

    def _set_urgency(self, urgency: WatcherUrgency) -> None:
        before, self._urgency = self._urgency, urgency
        if urgency is not before:
            self._ring.urgency = urgency
        if bool(urgency) is not bool(before):
            self._set_idle(not urgency)

    def _needed_urgency(self, now: float) -> WatcherUrgency:
        ring = self._ring
        if ring.bytes_read >= self._target_position:
            self._target_position, self._target_set_at = ring.bytes_written, now
        late = now - self._target_set_at
        if late > OVERDUE_AFTER or ring.fill_ratio > MAX_RING_SHARE:
            return WatcherUrgency.ALL
        return WatcherUrgency.SOME if late > LATE_AFTER else WatcherUrgency.NONE


def yield_function(ring: RingReader) -> Callable[[], None]:
    """Return a function that yields the processor, except at the highest `WatcherUrgency`."""
    if not hasattr(os, "sched_yield"):
        return lambda: None

    def yield_cpu() -> None:
        if ring.urgency < WatcherUrgency.ALL:
            os.sched_yield()

    return yield_cpu


def lower_priority(niceness: int) -> None:
    if hasattr(os, "sched_setscheduler"):
        with suppress(OSError):
            os.sched_setscheduler(0, os.SCHED_OTHER, os.sched_param(0))
    if hasattr(os, "nice"):
        with suppress(OSError):
            os.nice(niceness)


def idle_priority_switch(process: int) -> Callable[[bool], None]:
    """Return a function that switches a process to idle priority (True) or to normal priority (False).

    If the user may not move a process out of idle priority, the returned function does nothing.
    """
    possible = _can_leave_idle_priority()
    ours = os.getpriority(os.PRIO_PROCESS, 0) if possible else 0

    def set_idle(idle: bool) -> None:
        if not possible:
            return
        policy = os.SCHED_IDLE if idle else os.SCHED_OTHER
        with suppress(OSError):  # the process, or one of its threads, may have ended
            for thread in Path(f"/proc/{process}/task").iterdir():
                os.sched_setscheduler(int(thread.name), policy, os.sched_param(0))
                # `setpriority` may need more rights than `sched_setscheduler`.
                with suppress(PermissionError):
                    os.setpriority(os.PRIO_PROCESS, int(thread.name), ours)

    return set_idle


def _can_leave_idle_priority() -> bool:
    """Test in a thread whether this user may move a process out of idle priority (sched(7))."""
    if not hasattr(os, "SCHED_IDLE"):
        return False
    succeeded: list[bool] = []

    def enter_and_leave() -> None:
        with suppress(OSError):
            os.sched_setscheduler(0, os.SCHED_IDLE, os.sched_param(0))
            os.sched_setscheduler(0, os.SCHED_OTHER, os.sched_param(0))
            succeeded.append(True)

    test = threading.Thread(target=enter_and_leave, name="priority test")
    test.start()
    test.join()
    return bool(succeeded)
