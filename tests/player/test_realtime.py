"""Priority, memory and garbage: what is taken and given back, and what is said where it is not given."""

from __future__ import annotations

import gc
import os

import pytest

from bcapscope.player.realtime import PRIORITY, undisturbed


def refuse(*_: object) -> None:
    raise PermissionError(1, "Operation not permitted")


def test_garbage_rests_meanwhile() -> None:
    with undisturbed(wanted=False) as grade:
        assert not gc.isenabled()
        assert (grade.realtime, grade.locked) == (False, False)
    assert gc.isenabled()
    assert gc.get_freeze_count() == 0


def test_who_serves_for_long_goes_on_collecting() -> None:
    with undisturbed(wanted=False, collecting=True):
        assert gc.isenabled()
        assert gc.get_freeze_count() > 0
    assert gc.get_freeze_count() == 0


def test_priority_is_given_back() -> None:
    before = os.sched_getscheduler(0)
    with undisturbed() as grade:
        assert (os.sched_getscheduler(0) == os.SCHED_FIFO) is grade.realtime
    assert os.sched_getscheduler(0) == before


def test_without_the_right_it_says_how_to_give_it(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(os, "sched_setscheduler", refuse)
    monkeypatch.setenv("USER", "ann")
    with undisturbed() as grade:
        assert not grade.realtime
    assert grade.text.startswith("no real-time priority (operation not permitted)")
    assert f"`ann - rtprio {PRIORITY}`" in grade.text
    assert "setcap cap_sys_nice+ep /" in grade.text


@pytest.mark.parametrize("throttled", [True, False])
def test_a_kernel_that_throttles_is_told(
    throttled: bool, monkeypatch: pytest.MonkeyPatch, tmp_path_factory: pytest.TempPathFactory
) -> None:
    folder = tmp_path_factory.mktemp("proc")
    runtime, period = folder / "runtime", folder / "period"
    runtime.write_text("100000\n" if throttled else "950000\n")
    period.write_text("1000000\n")
    monkeypatch.setattr("bcapscope.player.realtime._THROTTLE", (runtime, period))
    monkeypatch.setattr(os, "sched_setscheduler", lambda *_: None)
    with undisturbed() as grade:
        assert ("allows it only 100000 of 1000000 µs" in grade.text) is throttled
