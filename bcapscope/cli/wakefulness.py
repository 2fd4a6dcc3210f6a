"""Keeping the processors from sleeping while set points pass.

Who comes to a processor that sleeps waits until it is awake: some microseconds where its sleep is light, a
hundred and more where it is deep, and tens on a virtual machine whatever it says, as there the host wakes it.
A round trip over a relay pays that four times. So those who need short times ask Linux for no more than so
much of it (power/pm_qos_interface), as the relay does. But that costs electricity, and on a virtual machine
the host's processors; so it asks only while much passes, and not where the host then takes processors away.
"""

from __future__ import annotations

import math
import os
import struct
from collections.abc import Callable, Sequence
from contextlib import suppress
from pathlib import Path

from bcapscope.proxy.ring import Count

MUCH = 5
"""Datagrams between two looks, of which there are some twenty a second: fifty calls a second. A set point
each 8 ms makes 125."""

LONG = 1.0
"""Seconds without that much after which processors may sleep again."""

STOLEN = 0.05
"""Share of the processors' time that the host may take."""

AGAIN_AFTER = 60.0
"""Seconds that processors may sleep since the host took more."""

_MEASURED_EACH = 1.0
"""Seconds."""

_SIZE = 64
"""Bytes of a stream that count as a datagram: less than what a set point takes, or its answer."""

_SHORT = 2
"""µs in which a processor wakes from its lightest sleep (C1; WFI on ARM)."""

_REQUEST = struct.Struct("@i")
_DEVICE = Path("/dev/cpu_dma_latency")
_DRIVER = Path("/sys/devices/system/cpu/cpuidle/current_driver")
_STATISTICS = Path("/proc/stat")
_STEAL = 8
"""Place of the time that the host took (proc_stat(5))."""


class Wakefulness:
    """Lets the processors sleep unless much passes."""

    def __init__(self, keep_awake: Callable[[bool], None], stolen: Callable[[], float]) -> None:
        """Let them sleep.

        Args:
            keep_awake: called with whether they are to stay awake, when that changes.
            stolen: tells how many seconds of how many processors' time each the host has taken so far.
        """
        self._keep_awake = keep_awake
        self._stolen = stolen
        self._is_awake = False
        self._passed = 0
        self._much_at, self._not_before = -math.inf, -math.inf
        self._measured_at = self._measured = 0.0

    def look(self, passed: int, now: float) -> None:
        """Look how much has passed.

        Args:
            passed: so many datagrams so far; see `passed`.
            now: s, of any clock that runs evenly.
        """
        if passed - self._passed >= MUCH:
            self._much_at = now
        self._passed = passed
        if self._is_awake and now - self._measured_at >= _MEASURED_EACH:
            before, since = self._measured, now - self._measured_at
            self._measure(now)
            if self._measured - before > STOLEN * since:
                self._not_before = now + AGAIN_AFTER
        self._be(now - self._much_at < LONG and now >= self._not_before, now)

    def end(self) -> None:
        """Let them sleep."""
        self._be(False, math.inf)

    def _be(self, awake: bool, now: float) -> None:
        if awake is not self._is_awake:
            self._is_awake = awake
            self._keep_awake(awake)
            if awake:
                self._measure(now)

    def _measure(self, now: float) -> None:
        self._measured_at, self._measured = now, self._stolen()


def passed(counts: Sequence[int]) -> int:
    """Return how many datagrams have come, with as many as the bytes of streams would make.

    Args:
        counts: by `Count`.
    """
    datagrams = counts[Count.CAME_UP] + counts[Count.CAME_DOWN]
    return datagrams + (counts[Count.BYTES_UP] + counts[Count.BYTES_DOWN]) // _SIZE


class LightSleep:
    """Asks Linux to let processors sleep only as lightly as possible, or no more for that.

    On a KVM guest whose driver is haltpoll they then wait without sleeping. Linux forgets what was asked as
    soon as the file is closed, however we end; who may not ask, as only root may unless told, does without.
    """

    def __init__(self) -> None:
        self._asked: int | None = None
        self._may_ask = True

    def __call__(self, wanted: bool) -> None:
        """Ask for it, or no more."""
        if not wanted:
            if self._asked is not None:
                os.close(self._asked)
                self._asked = None
        elif self._may_ask:
            try:
                self._asked = os.open(_DEVICE, os.O_WRONLY)  # makes no file where there is no such device
                os.write(self._asked, _REQUEST.pack(_longest()))
            except OSError:
                self._may_ask = False


def _longest() -> int:
    """Return how many µs waking may take: none where each sleep, however light, is the host's."""
    with suppress(OSError):
        if _DRIVER.read_text(encoding="ascii").strip() == "haltpoll":
            return 0
    return _SHORT


def stolen() -> float:
    """Return how many seconds the host has taken so far, on an average of our processors; 0 if unknown."""
    with suppress(OSError, IndexError, ValueError):
        with _STATISTICS.open(encoding="ascii") as statistics:
            ticks = int(statistics.readline().split()[_STEAL])
        return ticks / os.sysconf("SC_CLK_TCK") / (os.cpu_count() or 1)
    return 0.0
