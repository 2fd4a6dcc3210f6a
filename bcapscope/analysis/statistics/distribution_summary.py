"""Summary of a distribution of values: extremes, percentiles and bins.

This module imports no numpy, because that would add 0.1 s to the start of every command that prints JSON.
"""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class Bin:
    """A bin of a histogram: the number of values from `low` (included) to `high` (excluded)."""

    low: float
    high: float
    count: int


@dataclass(frozen=True, slots=True)
class DistributionSummary:
    """Summary of a distribution.

    The p-th percentile is the smallest value that is at least as large as p % of all values.

    Attributes:
        mean: Mean value, exact.
        least: Smallest value, exact.
        most: Largest value, exact.
        p50: Median. All percentiles are exact for up to 8192 values; for more values, the error is at most
            0.4%.
        bins: The bins that are not empty, in ascending order; () unless requested.
    """

    count: int
    mean: float
    least: float
    most: float
    p50: float
    p90: float
    p99: float
    p999: float
    bins: tuple[Bin, ...] = ()

    def scaled(self, factor: float) -> DistributionSummary:
        """Return the summary with all values multiplied by `factor`, and without bins."""
        points = (self.mean, self.least, self.most, self.p50, self.p90, self.p99, self.p999)
        mean, least, most, p50, p90, p99, p999 = (point * factor for point in points)
        return DistributionSummary(self.count, mean, least, most, p50, p90, p99, p999)
