"""Priority, memory and garbage: what is taken and given back, and what is said where it is not given."""

from __future__ import annotations

import ctypes
import gc
import os
import platform
import sys

import pytest

from bcapscope.player.realtime import FIFO_PRIORITY, realtime_priority


def refuse(*_: object) -> None:
    raise PermissionError(1, "Operation not permitted")


def test_garbage_rests_meanwhile() -> None:
    with realtime_priority(is_wanted=False) as grade:
        assert not gc.isenabled()
        assert (grade.realtime, grade.locked) == (False, False)
    assert gc.isenabled()
    assert gc.get_freeze_count() == 0


def test_who_serves_for_long_goes_on_collecting() -> None:
    with realtime_priority(is_wanted=False, collect_garbage=True):
        assert gc.isenabled()
        assert gc.get_freeze_count() > 0
    assert gc.get_freeze_count() == 0


def test_priority_is_given_back() -> None:
    before = os.sched_getscheduler(0)
    with realtime_priority() as grade:
        assert (os.sched_getscheduler(0) == os.SCHED_FIFO) is grade.realtime
    assert os.sched_getscheduler(0) == before


def test_without_the_right_it_says_how_to_give_it(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(os, "sched_setscheduler", refuse)
    monkeypatch.setenv("USER", "ann")
    with realtime_priority() as grade:
        assert not grade.realtime
    assert str(grade.text).startswith("no real-time priority (operation not permitted)")
    assert f"`ann - rtprio {FIFO_PRIORITY}`" in str(grade.text)
    assert "setcap cap_sys_nice+ep /" in str(grade.text)


def slice_length() -> int:
    """Return how many ns of the processor we ask for at a time (sched_getattr(2)); 0 on older kernels."""
    attr = ctypes.create_string_buffer(48)
    ctypes.CDLL(None).syscall(315, 0, attr, len(attr), 0)
    return int.from_bytes(attr.raw[24:32], "little")


@pytest.mark.skipif(
    sys.platform != "linux" or platform.machine() != "x86_64" or not slice_length(),
    reason="Linux before 6.12, or another system, cannot be asked for short slices",
)
def test_without_priority_it_asks_for_little_at_a_time(monkeypatch: pytest.MonkeyPatch) -> None:
    if os.sched_getscheduler(0) != os.SCHED_OTHER:
        pytest.skip("whoever runs the tests has chosen another policy")
    usual, nice = slice_length(), os.getpriority(os.PRIO_PROCESS, 0)
    monkeypatch.setattr(os, "sched_setscheduler", refuse)
    with realtime_priority():
        assert slice_length() == 100_000
        assert os.getpriority(os.PRIO_PROCESS, 0) == nice
    assert slice_length() == usual


@pytest.mark.parametrize("throttled", [True, False])
def test_a_kernel_that_throttles_is_told(
    throttled: bool, monkeypatch: pytest.MonkeyPatch, tmp_path_factory: pytest.TempPathFactory
) -> None:
    folder = tmp_path_factory.mktemp("proc")
    runtime, period = folder / "runtime", folder / "period"
    runtime.write_text("100000\n" if throttled else "950000\n")
    period.write_text("1000000\n")
    monkeypatch.setattr("bcapscope.player.realtime._THROTTLE_FILES", (runtime, period))
    monkeypatch.setattr(os, "sched_setscheduler", lambda *_: None)
    with realtime_priority() as grade:
        assert ("allows it only for 100000 of every 1000000 µs" in str(grade.text)) is throttled
