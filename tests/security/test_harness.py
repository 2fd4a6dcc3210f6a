"""The harness itself: it sees a late halt, a traceback and memory that grows."""

from __future__ import annotations

from contextlib import nullcontext
from pathlib import Path

import pytest

from tests.cli.proxying import simulator
from tests.security import harness
from tests.security.harness import Outcome, RoundTrips, run_measured, under_attack


def test_no_attack_changes_nothing() -> None:
    outcome = under_attack("nothing", simulator(), nullcontext, seconds=0.5)
    assert outcome.attacked.calls > 10
    assert 0 < outcome.halt["udp"] < 1
    assert outcome.peak > 10


@pytest.mark.parametrize(("peak", "halt"), [(301.0, 0.1), (100.0, 1.1)])
def test_a_limit_that_is_exceeded_fails(peak: float, halt: float) -> None:
    trips = RoundTrips(1, 0.001, 0.001, 0.001)
    with pytest.raises(AssertionError):
        Outcome("x", trips, trips, {"tcp": halt}, peak).check()


def test_memory_of_a_command_is_measured() -> None:
    ended = run_measured(["--version"])
    assert ended.code == 0
    assert ended.out.startswith(b"bcapscope")
    assert 5 < ended.peak < 100


def test_a_hang_is_not_waited_for(tmp_path: Path) -> None:
    with pytest.raises(AssertionError, match="still running"):
        run_measured(["sim", "-q", "--port", "0"], patience=0.5)


def test_a_peak_is_kept_after_the_process_has_ended() -> None:
    with simulator() as process:
        watch = harness.MemoryWatch(process.popen.pid)
        watch.sample()
        watch.close()
    assert watch.peak > 10
