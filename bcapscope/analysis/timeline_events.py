"""What happened when, with as many entries as a picture can show, however long the traffic is."""

from __future__ import annotations

from enum import StrEnum
from typing import NamedTuple

from bcapscope.traffic.call_kind import CallKind

ACTIVITY_PAUSE_NS = 500_000_000
"""Calls that are less apart belong to one spell of activity, as long as there is room for all spells."""

MAX_ACTIVITY_PERIODS = 512
"""Spells of one client."""

MAX_EVENTS = 256
"""Marks of one kind and one client."""


class TimelineEventKind(StrEnum):
    """What a mark stands for."""

    RETRIED = "sent again"
    LATE = "reply came too late"
    EXECUTED_TWICE = "executed twice"
    REFUSED = "refused"
    UNANSWERED = "never answered"
    DAMAGED = "damaged frame"
    MISSING = "bytes missing in the capture"


class TimelineEvent(NamedTuple):
    """Something that happened, once or several times in a row.

    Attributes:
        begin: of the first, nanoseconds since 1970.
        end: of the last.
        occurrences: how many.
        frame: of the first.
        call_kind: of the first; None for what is no call, and for spells of activity.
        hresult: of the first; None where it has none.
    """

    begin: int
    end: int
    occurrences: int
    frame: int
    call_kind: CallKind | None = None
    hresult: int | None = None


class TimelineEventList:
    """Takes marks in, roughly in order of time, and joins neighbours when there are too many."""

    def __init__(self, most: int, pause: int = 0) -> None:
        """Begin.

        Args:
            most: marks that are kept.
            pause: nanoseconds by which two have to be apart to stay two; grows when there are too many.
        """
        self._most = most
        self._pause = pause
        self._events: list[TimelineEvent] = []

    def add(self, event: TimelineEvent) -> None:
        """Take one more."""
        self._append(event)
        while len(self._events) > self._most:
            lasted = max(self._events[-1].end - self._events[0].begin, 0)
            self._pause = max(self._pause * 2, lasted // self._most, 1)
            marks, self._events = self._events, []
            for each in marks:
                self._append(each)

    @property
    def all(self) -> tuple[TimelineEvent, ...]:
        """The marks so far."""
        return tuple(self._events)

    def _append(self, event: TimelineEvent) -> None:
        last = self._events[-1] if self._events else None
        if last is None or event.begin - last.end >= self._pause:
            self._events.append(event)
        else:
            self._events[-1] = last._replace(
                end=max(last.end, event.end), occurrences=last.occurrences + event.occurrences
            )
