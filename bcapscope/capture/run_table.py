"""Map long runs of successive numbers to the numbers of their sources, in little memory."""

from __future__ import annotations

from array import array
from bisect import bisect_right

MAX_RUNS = 2_000_000
"""Maximum number of runs in a table; a table of this size takes 40 MB. If the table is full, the sources of
later packets and frames are unknown.
"""


class RunTable:
    """A table of runs. Each run maps successive numbers to successive numbers in one source, such as a
    capture.
    """

    def __init__(self) -> None:
        self._starts = array("Q")
        self._sources = array("I")
        self._numbers = array("Q")

    def add(self, start: int, source: int, number: int) -> None:
        """Begin a run: `start` corresponds to `number` in `source`, `start` + 1 to `number` + 1, and so on.

        If the new run begins at the same number as the latest run, the new run replaces the latest run. If
        the new run only continues the latest run, nothing is added.
        """
        if len(self._starts) > MAX_RUNS:
            return
        if self._starts:
            same_distance = number - start == self._numbers[-1] - self._starts[-1]
            if same_distance and source == self._sources[-1]:
                return
            if start == self._starts[-1]:
                self._sources[-1], self._numbers[-1] = source, number
                return
        self._starts.append(start)
        self._sources.append(source)
        self._numbers.append(number)

    def find(self, number: int) -> tuple[int, int] | None:
        """Return the source of a number, and the corresponding number in this source; None if no run has the
        number.
        """
        at = bisect_right(self._starts, number) - 1
        if at < 0 or at == MAX_RUNS:
            return None
        return self._sources[at], self._numbers[at] + number - self._starts[at]
