"""A player at work as the screen sees it: what it has told so far, and what to answer.

The player is a process of its own; here its messages are only taken note of.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass, field

from msgspec import structs

from bcapscope.player.limits import limited, limits_of
from bcapscope.player.messages import (
    Ended,
    Message,
    Peer,
    Plan,
    Point,
    Progress,
    Question,
    Readiness,
    Topic,
    Trouble,
)
from bcapscope.player.preflight import Preflight, check
from bcapscope.player.trajectory import Trajectory
from bcapscope.protocol.slavemode import PERIOD_MS, Generation, SlaveMode, slave_mode

REMEMBERED = 600
"""Readings that the plots show at most: half a minute at twenty a second."""


@dataclass(slots=True)
class SlaveRun:
    """What is known of one run.

    Attributes:
        plan: what is played.
        trajectory: its set points with where they are from.
        progress: told last.
        course: elapsed seconds with set point and pose that came back, of the last readings.
        peer: who is there; None until that is known.
        preflight: against who is there; None until then.
        readiness: what the system allows, in words.
        troubles: what went wrong.
        question: that waits for an answer; None while there is none.
        ended: how it ended; None while it is at work.
    """

    plan: Plan
    trajectory: Trajectory
    progress: Progress | None = None
    course: deque[tuple[float, Point, Point]] = field(default_factory=lambda: deque(maxlen=REMEMBERED))
    peer: Peer | None = None
    preflight: Preflight | None = None
    readiness: str = ""
    troubles: list[Trouble] = field(default_factory=list)
    question: Question | None = None
    ended: Ended | None = None

    def take(self, message: Message) -> str | None:
        """Take note of a message; return the answer to a question that the user need not be asked."""
        if isinstance(message, Progress):
            before = self.progress
            told = message if message.of or before is None else structs.replace(before, state=message.state)
            self.progress = told
            if message.commanded:
                self.course.append((message.elapsed, message.commanded, message.returned))
        elif isinstance(message, Peer):
            self._look(message)
        elif isinstance(message, Readiness):
            self.readiness = message.text
        elif isinstance(message, Trouble):
            self.troubles.append(message)
        elif isinstance(message, Ended):
            self.ended, self.question = message, None
        elif isinstance(message, Question):
            if message.topic is Topic.BEGIN:
                return "yes" if self.preflight is None or self.preflight.is_fit else "no"
            self.question = message
        return None

    @property
    def mode(self) -> SlaveMode | None:
        """The slave mode that is played in; None until the controller's generation is known."""
        if self.peer is None:
            return None
        return slave_mode(self.peer.mode, Generation(self.peer.generation))

    @property
    def slack(self) -> tuple[int, float, float] | None:
        """Say how near the controller's buffer came to running empty, by a model: it takes a point each 8 ms.

        Returns:
            Slots, ms that a full buffer lasts, and ms of that which were left at the longest pause so far;
            None where a pause is no error, or nothing was sent yet.
        """
        mode, progress = self.mode, self.progress
        if mode is None or progress is None or not progress.cycle or mode.underflow_is_error is False:
            return None
        whole = float(mode.slots * PERIOD_MS)
        longest = progress.cycle[-1][1] / 1e6
        return mode.slots, whole, whole - max(0.0, longest - PERIOD_MS)

    def _look(self, peer: Peer) -> None:
        """Check the trajectory against what is there."""
        self.peer = peer
        self.preflight = check(
            self.trajectory,
            self.plan.period / 1e9,
            limited(limits_of(peer.type_name), self.plan.limits),
            present=peer.pose,
            mode=self.mode,
            loop=self.plan.rounds != 1,
        )
