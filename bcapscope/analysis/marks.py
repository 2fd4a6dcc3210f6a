"""What happened when, with as many entries as a picture can show, however long the traffic is."""

from __future__ import annotations

from enum import StrEnum
from typing import NamedTuple

from bcapscope.traffic.question import Question

PAUSE_NS = 500_000_000
"""Calls that are less apart belong to one spell of activity, as long as there is room for all spells."""

MOST_SPELLS = 512
"""Spells of one client."""

MOST_MARKS = 256
"""Marks of one kind and one client."""


class MarkKind(StrEnum):
    """What a mark stands for."""

    RETRIED = "sent again"
    LATE = "reply came too late"
    EXECUTED_TWICE = "executed twice"
    REFUSED = "refused"
    UNANSWERED = "never answered"
    DAMAGED = "damaged frame"
    MISSING = "bytes missing in the capture"


class Mark(NamedTuple):
    """Something that happened, once or several times in a row.

    Attributes:
        begin: of the first, nanoseconds since 1970.
        end: of the last.
        times: how many.
        frame: of the first.
        question: of the first; None for what is no call, and for spells of activity.
        hresult: of the first; None where it has none.
    """

    begin: int
    end: int
    times: int
    frame: int
    question: Question | None = None
    hresult: int | None = None


class Marks:
    """Takes marks in, roughly in order of time, and joins neighbours when there are too many."""

    def __init__(self, most: int, pause: int = 0) -> None:
        """Begin.

        Args:
            most: marks that are kept.
            pause: nanoseconds by which two have to be apart to stay two; grows when there are too many.
        """
        self._most = most
        self._pause = pause
        self._marks: list[Mark] = []

    def add(self, mark: Mark) -> None:
        """Take one more."""
        self._append(mark)
        while len(self._marks) > self._most:
            lasted = max(self._marks[-1].end - self._marks[0].begin, 0)
            self._pause = max(self._pause * 2, lasted // self._most, 1)
            marks, self._marks = self._marks, []
            for each in marks:
                self._append(each)

    @property
    def all(self) -> tuple[Mark, ...]:
        """The marks so far."""
        return tuple(self._marks)

    def _append(self, mark: Mark) -> None:
        last = self._marks[-1] if self._marks else None
        if last is None or mark.begin - last.end >= self._pause:
            self._marks.append(mark)
        else:
            self._marks[-1] = last._replace(end=max(last.end, mark.end), times=last.times + mark.times)
