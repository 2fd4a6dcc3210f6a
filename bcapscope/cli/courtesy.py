"""How the watching process gives way to those whose bytes pass, and when it must not.

On two processors, beside a client and a server, the 99.9th percentile of round trips was 2.6 ms while the
watcher had a low priority (nice 10) and 0.5 ms while it had the idle one: whoever wakes goes before a program
of idle priority at once, before any other only at the end of its slice of some 3 ms. But beside programs that
are always busy idle priority gives next to nothing (sched(7)); so the relay, which has the processor when it
needs it, looks how far the watcher has come.
"""

from __future__ import annotations

import os
import threading
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path

from bcapscope.proxy.ring import RingWriter

TAKEN_WITHIN = 0.15
"""Seconds after which what had passed at one look is to be recorded, or shown where nothing is recorded."""

FULL = 0.5
"""Share of the ring that may wait."""

AGAIN_AFTER = 30.0
"""Seconds without delay after which the watcher gives way again."""


class Courtesy:
    """Has the watcher give way as long as it keeps up."""

    def __init__(self, ring: RingWriter, give_way: Callable[[bool], None]) -> None:
        """Have it give way.

        Args:
            ring: that it reads.
            give_way: called with whether it is to give way, when that changes.
        """
        self._ring = ring
        self._give_way = give_way
        self._gives_way = True
        self._mark, self._marked_at, self._late_at = 0, 0.0, 0.0
        give_way(True)

    def look(self, now: float) -> None:
        """Look how far it has come.

        Args:
            now: s, of any clock that runs evenly.
        """
        if self._is_late(now):
            self._late_at = now
            self.end()
        elif not self._gives_way and now - self._late_at >= AGAIN_AFTER:
            self._gives_way = True
            self._give_way(True)

    def end(self) -> None:
        """Have it give way no more, as when nothing passes any longer and somebody waits for its end."""
        if self._gives_way:
            self._gives_way = False
            self._give_way(False)

    def _is_late(self, now: float) -> bool:
        ring = self._ring
        if ring.taken >= self._mark:
            self._mark, self._marked_at = ring.written, now
        return now - self._marked_at > TAKEN_WITHIN or ring.share > FULL


def step_back(niceness: int) -> None:
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


def idle_priority(process: int) -> Callable[[bool], None]:
    """Return what gives a process idle priority, or ours again; it does nothing if it could not come back.

    Args:
        process: its number.
    """
    possible = _may_come_back()
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


def _may_come_back() -> bool:
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
