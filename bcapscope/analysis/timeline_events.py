"""Events on a timeline. In a long capture, neighbouring events are joined, because room is limited."""

from __future__ import annotations

from enum import StrEnum
from typing import NamedTuple

from bcapscope.messages import Message
from bcapscope.traffic.call_kind import CallKind

ACTIVITY_PAUSE_NS = 500_000_000
"""Shortest pause in ns that ends a period of activity."""

MAX_ACTIVITY_PERIODS = 512

MAX_EVENTS = 256


class TimelineEventKind(StrEnum):
    RETRIED = "retried"
    LATE = "late"
    EXECUTED_TWICE = "executed-twice"
    REFUSED = "refused"
    UNANSWERED = "unanswered"
    DAMAGED = "damaged"
    MISSING = "missing"

    @property
    def message(self) -> Message:
        return Message(f"timeline.{self.value}")


class TimelineEvent(NamedTuple):
    """An event on a timeline, or several neighbouring events joined into one.

    Attributes:
        begin: Start of the first event, ns since 1970.
        end: End of the last event, ns since 1970.
        call_kind: Kind of the first call that the event concerns; None for activity, damaged frames and gaps.
    """

    begin: int
    end: int
    occurrences: int
    frame: int
    call_kind: CallKind | None = None
    hresult: int | None = None


class TimelineEventList:
    """Collects events in roughly chronological order.

    The list joins events less than `pause` ns apart. While the joined events still number more than `most`,
    the list lengthens `pause` and joins again.
    """

    def __init__(self, most: int, pause: int = 0) -> None:
        self._most = most
        self._pause = pause
        self._events: list[TimelineEvent] = []

    def add(self, event: TimelineEvent) -> None:
        self._append(event)
        while len(self._events) > self._most:
            lasted = max(self._events[-1].end - self._events[0].begin, 0)
            self._pause = max(self._pause * 2, lasted // self._most, 1)
            marks, self._events = self._events, []
            for each in marks:
                self._append(each)

    @property
    def all(self) -> tuple[TimelineEvent, ...]:
        return tuple(self._events)

    def _append(self, event: TimelineEvent) -> None:
        last = self._events[-1] if self._events else None
        if last is None or event.begin - last.end >= self._pause:
            self._events.append(event)
        else:
            self._events[-1] = last._replace(
                end=max(last.end, event.end), occurrences=last.occurrences + event.occurrences
            )
