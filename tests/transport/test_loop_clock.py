"""Time that passes only when all wait."""

from __future__ import annotations

import asyncio
import time

import pytest

from bcapscope.transport.loop_clock import LoopClock
from tests.virtual_time import run_in_virtual_time


def test_virtual_time_jumps() -> None:
    async def sleep() -> tuple[int, list[int]]:
        clock = LoopClock(asyncio.get_running_loop())
        woken: list[int] = []
        clock.call_at(5_000_000_000, lambda: woken.append(clock.now()))
        await asyncio.sleep(3600)
        return clock.now(), woken

    began = time.monotonic()
    assert run_in_virtual_time(sleep()) == (3_600_000_000_000, [5_000_000_000])
    assert time.monotonic() - began < 60


def test_waiting_for_what_cannot_come_is_told() -> None:
    async def wait() -> None:
        await asyncio.Event().wait()

    with pytest.raises(RuntimeError, match="everything waits"):
        run_in_virtual_time(wait())


def test_times_are_of_today() -> None:
    async def look() -> tuple[int, int]:
        clock = LoopClock(asyncio.get_running_loop())
        return clock.since_1970(clock.now()), time.time_ns()

    measured, real = asyncio.run(look())
    assert abs(measured - real) < 60e9
