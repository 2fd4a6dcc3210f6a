"""What is done beside sending set points: orders are looked for, and progress is told."""

from __future__ import annotations

from math import isfinite

from bcapscope.player.course import Course
from bcapscope.player.desk import Desk
from bcapscope.player.journal import Journal
from bcapscope.player.messages import Order, Point, Progress, State
from bcapscope.player.pace import HaltedError, Pacer
from bcapscope.protocol.frame import Frame
from bcapscope.protocol.poses import numbers

TELL_EACH = 50_000_000
"""ns from one telling to the next."""


class Monitor:
    """Does it, quickly, each time it is called.

    Attributes:
        pacer: that is watched.
    """

    pacer: Pacer

    def __init__(self, desk: Desk, journal: Journal, course: Course, period: int) -> None:
        self._desk = desk
        self._journal = journal
        self._course = course
        self._period = period
        self._next = 0

    def idle(self, now: int) -> None:
        """Look for orders, and tell of progress when it is time to.

        Raises:
            HaltedError: that is the order.
        """
        order = self._desk.poll()
        if order is Order.HALT:
            raise HaltedError
        if order is Order.STOP:
            self._course.stop()
        if now >= self._next:
            self._next = now + TELL_EACH
            self._desk.tell(self.progress(now))

    def progress(self, now: int) -> Progress:
        """Return how far it is."""
        pacer, course = self.pacer, self._course
        left = max(0, course.of - course.index) * self._period / 1e9 if course.of else None
        return Progress(
            State.STOPPING if course.stopping else State.PLAYING,
            course.index,
            course.of,
            0.0 if pacer.began is None else (now - pacer.began) / 1e9,
            None if course.stopping else left,
            pacer.lateness.so_far(),
            pacer.counts,
            pacer.commanded,
            _pose(pacer.reply),
            self._journal.sent,
            self._journal.received,
            pacer.cycle.bins(),
        )


def _pose(reply: Frame | None) -> Point:
    """Read the pose out of a reply; nothing where it holds none, or NaN, which no message carries."""
    if reply is None or not reply.arguments:
        return ()
    row = numbers(reply.arguments[0].variant) or ()
    return row if all(map(isfinite, row)) else ()
