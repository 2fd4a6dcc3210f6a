"""Keep the processors out of deep sleep while set points pass; only on request (`proxy --low-latency`).

Waking a processor takes a few microseconds from light sleep, a hundred or more from deep sleep, and tens on a
virtual machine from any sleep, since the host wakes it. A round trip through the proxy pays this four times
if client and controller run on the same machine, else twice. Linux accepts a limit for the wake-up time
(power/pm_qos_interface). The limit holds for the whole machine and costs electricity, or processor time of
the host. So the proxy sets it only while there is much traffic, and not where the host takes processors away.
"""

from __future__ import annotations

import math
import os
import struct
import sys
from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path
from typing import Protocol

from bcapscope.proxy.ring import Count

MUCH = 100
"""Datagrams within `LONG`, or at once: fifty calls. A set point each 8 ms makes 250 in a second."""

LONG = 1.0
"""Seconds."""

STAY = 2.0
"""Seconds without that much after which processors may sleep again."""

STOLEN = 0.05
"""Share of a processor's time that the host may take from all of them together."""

REST = 60.0
"""Seconds for which nothing is asked after the host took more, or Linux refused."""

_MEASURED_EACH = 1.0
"""Seconds."""

_SIZE = 64
"""Bytes of streams that count as a datagram: a set point takes some 100, its answer 58 or 90."""

_REQUEST = struct.Struct("@i")
_DEVICE = Path("/dev/cpu_dma_latency")
_SLEEP = Path("/sys/devices/system/cpu")
_STATISTICS = Path("/proc/stat")

_USUAL = 2
"""µs to wake from the lightest sleep, where nobody says how many."""

_FIRST_LINE = 256
"""Bytes, more than it has."""

_STEAL = 8
"""Place of the time that the host took, in the first line (proc_stat(5))."""


class Sleep(Protocol):
    """The sleep of the processors."""

    def forbid(self) -> bool:
        """Ask that they stay awake, or all but; tell whether that is granted."""

    def allow(self) -> None:
        """Ask no more."""

    def stolen(self) -> float | None:
        """Return how many seconds the host took so far from those that stay awake; None if unknown."""


class Wakefulness:
    """Lets the processors sleep unless much passes."""

    def __init__(self, sleep: Sleep) -> None:
        """Let them sleep."""
        self._sleep = sleep
        self._is_awake = False
        self._count, self._since = 0, -math.inf
        self._much_at = self._not_before = -math.inf
        self._measured: float | None = None
        self._measured_at = 0.0

    def look(self, count: int, now: float) -> None:
        """Look how much has passed, some twenty times a second.

        Args:
            count: datagrams so far; see `passed`.
            now: s, of any clock that runs evenly.
        """
        is_much = count - self._count >= MUCH
        if is_much:
            self._much_at = now
        if is_much or now - self._since >= LONG:
            self._count, self._since = count, now
        if self._is_awake and now - self._measured_at >= _MEASURED_EACH and self._measure(now):
            self._not_before = now + REST
        wanted = now - self._much_at < STAY and now >= self._not_before
        if wanted and not self._is_awake:
            self._wake(now)
        elif not wanted:
            self.end()

    def end(self) -> None:
        """Let them sleep."""
        if self._is_awake:
            self._is_awake = False
            self._sleep.allow()

    def _wake(self, now: float) -> None:
        self._is_awake = self._sleep.forbid()
        if self._is_awake:
            self._measured_at, self._measured = now, self._sleep.stolen()
        else:
            self._not_before = now + REST

    def _measure(self, now: float) -> bool:
        """Measure what the host took since the last time; tell whether that is much."""
        since, before = now - self._measured_at, self._measured
        self._measured_at, self._measured = now, self._sleep.stolen()
        return before is not None and self._measured is not None and self._measured - before > STOLEN * since


def passed(counts: Sequence[int]) -> int:
    """Return how many datagrams came, and how many the bytes of streams that were sent would make.

    Args:
        counts: by `Count`.
    """
    datagrams = counts[Count.CAME_UP] + counts[Count.CAME_DOWN]
    return datagrams + (counts[Count.BYTES_UP] + counts[Count.BYTES_DOWN]) // _SIZE


class LightSleep:
    """Has Linux let processors sleep only as lightly as possible, where we may ask: as root, unless told.

    On a KVM guest whose driver is haltpoll they then wait without sleeping, as there each sleep, however
    lightly it is called, is the host's. Linux forgets what was asked once the file is closed, however we end.
    """

    def __init__(self) -> None:
        self._waits_awake = _waits_awake()
        self._longest = 0 if self._waits_awake else _lightest()
        self._asked: int | None = None
        self._statistics: int | None = None

    def forbid(self) -> bool:
        """Ask for it; tell whether that is granted."""
        if sys.platform != "linux":
            return False
        try:
            self._asked = os.open(_DEVICE, os.O_WRONLY)  # makes no file where there is no such device
            os.write(self._asked, _REQUEST.pack(self._longest))
            if self._waits_awake:
                self._statistics = os.open(_STATISTICS, os.O_RDONLY)
        except (OSError, struct.error):
            self.allow()
            return False
        return True

    def allow(self) -> None:
        """Ask for it no more."""
        descriptors = self._asked, self._statistics
        self._asked = self._statistics = None
        for descriptor in descriptors:
            if descriptor is not None:
                with suppress(OSError):
                    os.close(descriptor)

    def stolen(self) -> float | None:
        """Return how many seconds of processors the host took so far, if these never sleep."""
        if sys.platform == "linux" and self._statistics is not None:
            with suppress(OSError, IndexError, ValueError):
                line = os.pread(self._statistics, _FIRST_LINE, 0)
                return int(line.split()[_STEAL]) / os.sysconf("SC_CLK_TCK")
        return None


def cannot_stay_awake() -> str:
    """Return why this process cannot keep processors out of deep sleep; "" if it can."""
    if sys.platform != "linux":
        return "only Linux can keep processors out of deep sleep"
    try:
        os.close(os.open(_DEVICE, os.O_WRONLY))
    except OSError as error:
        return (
            f"cannot write {_DEVICE}: {(error.strerror or str(error)).lower()}. Run the proxy as root, or "
            "give your user write access with a udev rule (see docs/proxy.md)"
        )
    return ""


def _waits_awake() -> bool:
    """Tell whether a processor that must wake at once waits without sleeping."""
    with suppress(OSError):
        return (_SLEEP / "cpuidle" / "current_driver").read_bytes().strip() == b"haltpoll"
    return False


def _lightest() -> int:
    """Return how many µs the first processor takes to wake from the lightest sleep that is in use."""
    states = (_SLEEP / "cpu0" / "cpuidle").glob("state*")
    with suppress(OSError, ValueError):
        used = [each for each in states if int((each / "disable").read_text()) == 0]
        latencies = (int((each / "latency").read_text()) for each in used)
        return min((latency for latency in latencies if latency > 0), default=_USUAL)
    return _USUAL
