"""Verdicts on round trips."""

from __future__ import annotations

import numpy as np
import pytest

from bcapscope.analysis.slave.fitness import fitness
from bcapscope.analysis.statistics.distribution import Histogram
from bcapscope.analysis.statistics.distribution_summary import DistributionSummary


def _spread(*values: float) -> DistributionSummary | None:
    histogram = Histogram()
    histogram.add(np.array(values))
    return histogram.distribution()


@pytest.mark.parametrize(
    ("values", "lost", "fit"),
    [
        ((0.2,) * 100, 0, [True, True]),
        ((0.2,) * 99 + (1.0,), 0, [True, True]),
        ((0.2,) * 99 + (1.1,), 0, [True, False]),
        ((0.2,) * 99 + (8.1,), 0, [False, False]),
        ((0.2,) * 99, 1, [True, True]),
        ((0.2,) * 98, 2, [False, False]),
        ((), 5, [False, False]),
    ],
)
def test_verdicts(values: tuple[float, ...], lost: int, fit: list[bool]) -> None:
    assert [verdict.fit for verdict in fitness(_spread(*values), lost)] == fit


def test_reasons() -> None:
    assert str(fitness(None, 3)[0].reason) == "no call was answered"
    assert str(fitness(_spread(0.5), 1)[0].reason) == "50.0% of the calls were lost"
    fast = fitness(_spread(0.5), 0)[1]
    assert (fast.period_ms, fast.fit) == (1.0, True)
    assert str(fast.reason) == "99.9% of the replies arrived within 0.500 ms"
    broken = fitness(_spread(0.5), 0, broken=True)[0]
    assert (broken.period_ms, broken.fit, str(broken.reason)) == (8.0, False, "the connection broke")
