"""Prevent delays of the player: real-time priority, locked memory, no garbage collection.

A process with SCHED_FIFO runs before all programs without real-time priority (sched(7)). Locked memory is
never swapped to disk (mlockall(2)). A process with a short time slice gets the processor sooner than other
processes, but its share of processor time stays the same (Linux 6.12, sched-eevdf).
"""

from __future__ import annotations

import ctypes
import gc
import os
import platform
import struct
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import msgspec

from bcapscope.messages import Message
from bcapscope.messages.os_errors import os_reason
from bcapscope.messages.places import Enumeration

FIFO_PRIORITY = 40
"""Priority above all ordinary programs. The interrupts that deliver replies have priority 50."""

_THROTTLE_FILES = Path("/proc/sys/kernel/sched_rt_runtime_us"), Path("/proc/sys/kernel/sched_rt_period_us")
_NEEDED_SHARE = 0.5
_MCL_CURRENT = 1

_TIME_SLICE = 100_000
"""Requested time slice in ns; the shortest that Linux offers."""

_SCHED_SETATTR = {"x86_64": 314, "aarch64": 274}
"""Number of the system call sched_setattr for each processor type. Older C libraries lack sched_setattr."""

_SCHED_ATTR = struct.Struct("=IIQiIQQQ")
"""Fields of the C struct sched_attr: size, policy, flags, niceness, priority, runtime, deadline, period."""


class RealtimeReport(msgspec.Struct, frozen=True, tag=True):
    """What the system granted. `text` describes the result to the user, with advice after a refusal."""

    realtime: bool
    locked: bool
    text: Message


@contextmanager
def realtime_priority(is_wanted: bool = True, *, collect_garbage: bool = False) -> Iterator[RealtimeReport]:
    """Run a `with` block with the highest priority that the system grants.

    Real-time priority and locked memory can disturb other programs. `realtime_priority` therefore requests
    both from the operating system only if `is_wanted`. In the block, the garbage collector ignores older
    objects, because examining these objects costs milliseconds. Without `collect_garbage`, the garbage
    collector is off.
    """
    gc.collect()
    gc.freeze()
    if not collect_garbage:
        gc.disable()
    granted = _acquire() if is_wanted else RealtimeReport(False, False, Message("play.realtime.off"))
    if not granted.realtime:
        _set_time_slice(_TIME_SLICE)
    try:
        yield granted
    finally:
        if granted.realtime:
            os.sched_setscheduler(0, os.SCHED_OTHER, os.sched_param(0))
        else:
            _set_time_slice(0)
        if granted.locked:
            _libc().munlockall()
        gc.enable()
        gc.unfreeze()


def _acquire() -> RealtimeReport:
    refused = _set_fifo_priority()
    locked = sys.platform == "linux" and _libc().mlockall(_MCL_CURRENT) == 0
    if refused is not None:
        return RealtimeReport(False, locked, refused)
    parts = [Message("play.realtime.on", priority=FIFO_PRIORITY)]
    if (note := _throttling_note()) is not None:
        parts.append(note)
    if not locked:
        parts.append(Message("play.realtime.unlocked"))
    return RealtimeReport(True, locked, Message("list.of", items=Enumeration(tuple(parts))))


def _set_fifo_priority() -> Message | None:
    if sys.platform != "linux":
        return Message("play.realtime.linux-only")
    try:
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(FIFO_PRIORITY))
    except OSError as error:
        return Message(
            "play.realtime.refused",
            reason=os_reason(error),
            user=os.environ.get("USER") or "USER",
            priority=FIFO_PRIORITY,
            python=os.path.realpath(sys.executable),
        )
    return None


def _set_time_slice(length: int) -> None:
    """`length` is in ns; 0 means the default. The function does nothing on systems other than Linux."""
    number = _SCHED_SETATTR.get(platform.machine()) if sys.maxsize > 1 << 32 else None
    if sys.platform == "linux" and number and os.sched_getscheduler(0) == os.SCHED_OTHER:
        nice = os.getpriority(os.PRIO_PROCESS, 0)
        attr = _SCHED_ATTR.pack(_SCHED_ATTR.size, os.SCHED_OTHER, 0, nice, 0, length, 0, 0)
        _libc().syscall(number, 0, attr, 0)


def _throttling_note() -> Message | None:
    """Return a warning if the kernel gives real-time programs less than half of the processor time."""
    try:
        runtime, period = (int(path.read_text()) for path in _THROTTLE_FILES)
    except (OSError, ValueError):
        return None
    if runtime < 0 or runtime >= _NEEDED_SHARE * period:
        return None
    return Message("play.realtime.throttled", file=str(_THROTTLE_FILES[0]), runtime=runtime, period=period)


def _libc() -> ctypes.CDLL:
    return ctypes.CDLL(None, use_errno=True)
