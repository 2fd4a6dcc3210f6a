"""Keeps processors out of deep sleep while set points arrive, for `proxy --low-latency`.

A processor needs a few microseconds to wake from light sleep, and a hundred or more to wake from deep sleep.
In a virtual machine, a wake-up takes tens of microseconds, because the host wakes the processor. A round trip
through the proxy contains two wake-ups, or four if client and controller run on the proxy's machine.

A program can set a wake-up limit for all processors: the maximum time that a processor may need to wake
(power/pm_qos_interface). While a wake-up limit is set, idle processors use more electricity or, in a virtual
machine, more of the host's processor time. The proxy sets the wake-up limit only while there is much traffic,
and removes the wake-up limit if the host takes too much processor time from the virtual machine.
"""

from __future__ import annotations

import math
import os
import struct
import sys
from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path

from bcapscope.messages import Message
from bcapscope.messages.os_errors import os_reason
from bcapscope.proxy.ring_buffer import RelayCounter

BUSY_DATAGRAMS = 100
"""There is much traffic if this many datagrams (50 calls) arrive within `BUSY_WITHIN` seconds. Set points
every 8 ms, with their replies, are 250 datagrams per second.
"""

BUSY_WITHIN = 1.0

AWAKE_FOR = 2.0
"""After this many seconds without much traffic, the processors may sleep deeply again."""

MAX_STOLEN_SHARE = 0.05
"""Maximum processor time that the host may take, summed over all processors: 0.05 means 50 ms per second."""

PAUSED_FOR = 60.0
"""Number of seconds after which the proxy tries again to set the wake-up limit. The proxy waits for this time
if Linux refused the wake-up limit, or if the host took too much processor time or an unknown amount.
"""

_MEASURED_EVERY = 1.0
"""Seconds between measurements of the processor time that the host took from the virtual machine."""

_STREAM_BYTES_EACH = 64
"""To measure how much traffic there is, the proxy counts this many bytes of TCP as one datagram. A set point
has about 100 bytes; its reply has 58 or 90.
"""

_REQUEST = struct.Struct("@i")
_DEVICE = Path("/dev/cpu_dma_latency")
_CPU_FOLDER = Path("/sys/devices/system/cpu")
_STATISTICS = Path("/proc/stat")

_USUAL_LATENCY_US = 2
"""Time in µs to wake from the lightest sleep, if Linux does not report it."""

_STEAL_COLUMN = 8
"""Index of "steal" in the first line of /proc/stat: processor time that the host took (proc_stat(5))."""


class CpuWakefulness:
    """Keeps the processors out of deep sleep while there is much traffic. For this, the class sets a wake-up
    limit (see the module docstring).

    A process can set the wake-up limit only with root rights, or if a udev rule grants access to the device
    file. In a KVM guest with the haltpoll driver, the wake-up limit is 0 µs, so that idle processors stay
    fully awake. Linux drops the wake-up limit when the process closes the device file or ends.
    """

    def __init__(self) -> None:
        self._has_haltpoll = _uses_haltpoll()
        self._limit_us = 0 if self._has_haltpoll else _lightest_latency_us()
        self._device: int | None = None  # file descriptor of `_DEVICE`; None while no wake-up limit is set
        self._count_before, self._counted_at = 0, -math.inf
        self._busy_at = self._not_before = -math.inf
        self._measured_at = self._stolen_before = 0.0

    @property
    def is_limit_set(self) -> bool:
        return self._device is not None

    def update(self, datagrams: int, now: float) -> None:
        """Set or remove the wake-up limit, depending on the traffic and on how much processor time the host
        takes. Call this method about twenty times per second. `datagrams` is the number of datagrams so far.
        `now` is the time of a monotonic clock in seconds.
        """
        is_much = datagrams - self._count_before >= BUSY_DATAGRAMS
        if is_much:
            self._busy_at = now
        if is_much or now - self._counted_at >= BUSY_WITHIN:
            self._count_before, self._counted_at = datagrams, now
        if self.is_limit_set and now - self._measured_at >= _MEASURED_EVERY and self._is_much_stolen(now):
            self._not_before = now + PAUSED_FOR
        if now - self._busy_at >= AWAKE_FOR or now < self._not_before:
            self.allow_deep_sleep()
        elif not self.is_limit_set:
            self._forbid_deep_sleep(now)

    def _forbid_deep_sleep(self, now: float) -> None:
        self._measured_at, self._stolen_before = now, self._stolen_seconds()
        if self._has_haltpoll and math.isnan(self._stolen_before):
            # Without a measurement, the proxy would not notice that the host takes too much processor time.
            self._not_before = now + PAUSED_FOR
            return
        try:
            # Without O_CREAT, `os.open` does not create a missing device file.
            self._device = os.open(_DEVICE, os.O_WRONLY)
            os.write(self._device, _REQUEST.pack(self._limit_us))
        except (OSError, struct.error):
            self.allow_deep_sleep()
            self._not_before = now + PAUSED_FOR

    def allow_deep_sleep(self) -> None:
        device, self._device = self._device, None
        if device is not None:
            with suppress(OSError):
                os.close(device)

    def _is_much_stolen(self, now: float) -> bool:
        """Return whether the host took more than `MAX_STOLEN_SHARE` of the time since the previous check."""
        since, before = now - self._measured_at, self._stolen_before
        self._measured_at, self._stolen_before = now, self._stolen_seconds()
        return self._stolen_before - before > MAX_STOLEN_SHARE * since

    def _stolen_seconds(self) -> float:
        """Return the processor time in seconds that the host has taken from this virtual machine so far.
        Return NaN if Linux does not use the haltpoll driver, or does not report this time.
        """
        if sys.platform == "linux" and self._has_haltpoll:
            with suppress(OSError, IndexError, ValueError), _STATISTICS.open("rb") as file:
                return int(file.readline().split()[_STEAL_COLUMN]) / os.sysconf("SC_CLK_TCK")
        return math.nan


def datagrams_passed(counts: Sequence[int]) -> int:
    """Return how many datagrams the relay has received so far, from clients and controllers.
    `_STREAM_BYTES_EACH` bytes that the relay sent over TCP count as one datagram.
    """
    datagrams = counts[RelayCounter.CAME_UP] + counts[RelayCounter.CAME_DOWN]
    return datagrams + (counts[RelayCounter.BYTES_UP] + counts[RelayCounter.BYTES_DOWN]) // _STREAM_BYTES_EACH


def low_latency_problem() -> Message | None:
    """Return why this process cannot set the wake-up limit; None if the process can set the wake-up limit."""
    if sys.platform != "linux":
        return Message("low-latency.not-linux")
    try:
        os.close(os.open(_DEVICE, os.O_WRONLY))
    except OSError as error:
        return Message("low-latency.not-allowed", device=str(_DEVICE), reason=os_reason(error))
    return None


def _uses_haltpoll() -> bool:
    with suppress(OSError):
        return (_CPU_FOLDER / "cpuidle" / "current_driver").read_bytes().strip() == b"haltpoll"
    return False


def _lightest_latency_us() -> int:
    """Return the time in µs that the first processor takes to wake from its lightest enabled sleep."""
    states = (_CPU_FOLDER / "cpu0" / "cpuidle").glob("state*")
    with suppress(OSError, ValueError):
        used = [each for each in states if int((each / "disable").read_text()) == 0]
        latencies = (int((each / "latency").read_text()) for each in used)
        return min((latency for latency in latencies if latency > 0), default=_USUAL_LATENCY_US)
    return _USUAL_LATENCY_US
