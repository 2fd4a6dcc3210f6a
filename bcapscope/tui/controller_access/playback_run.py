"""A player at work as the screen sees it: what it has told so far, and what to answer.

The player is a process of its own; here its messages are only taken note of.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass, field

from msgspec import structs

from bcapscope.player.arm_limits import limits_for_arm, with_limits
from bcapscope.player.player_messages import (
    ControllerInfo,
    PlayEnded,
    PlayerMessage,
    PlayerProblem,
    PlayerQuestion,
    PlayPlan,
    PlayProgress,
    QuestionTopic,
    RealtimeReport,
    SetPointValues,
)
from bcapscope.player.preflight import PreflightResult, run_preflight
from bcapscope.player.trajectory import Trajectory
from bcapscope.protocol.slave_mode.modes import PERIOD_MS, Generation, SlaveMode, slave_mode_by_number

MAX_SAMPLES = 600
"""Readings that the plots show at most: half a minute at twenty a second."""


@dataclass(slots=True)
class PlaybackRun:
    """What is known of one run.

    Attributes:
        plan: what is played.
        trajectory: its set points with where they are from.
        progress: told last.
        samples: elapsed seconds with set point and pose that came back, of the last readings.
        peer: who is there; None until that is known.
        preflight: against who is there; None until then.
        readiness: what the system allows, in words.
        troubles: what went wrong.
        question: that waits for an answer; None while there is none.
        ended: how it ended; None while it is at work.
    """

    plan: PlayPlan
    trajectory: Trajectory
    progress: PlayProgress | None = None
    samples: deque[tuple[float, SetPointValues, SetPointValues]] = field(
        default_factory=lambda: deque(maxlen=MAX_SAMPLES)
    )
    peer: ControllerInfo | None = None
    preflight: PreflightResult | None = None
    readiness: str = ""
    troubles: list[PlayerProblem] = field(default_factory=list)
    question: PlayerQuestion | None = None
    ended: PlayEnded | None = None

    def on_message(self, message: PlayerMessage) -> str | None:
        """Take note of a message; return the answer to a question that the user need not be asked."""
        if isinstance(message, PlayProgress):
            before = self.progress
            told = message if message.of or before is None else structs.replace(before, state=message.state)
            self.progress = told
            if message.commanded:
                self.samples.append((message.elapsed, message.commanded, message.returned))
        elif isinstance(message, ControllerInfo):
            self._check_peer(message)
        elif isinstance(message, RealtimeReport):
            self.readiness = message.text
        elif isinstance(message, PlayerProblem):
            self.troubles.append(message)
        elif isinstance(message, PlayEnded):
            self.ended, self.question = message, None
        elif isinstance(message, PlayerQuestion):
            if message.topic is QuestionTopic.BEGIN:
                return "yes" if self.preflight is None or self.preflight.is_playable else "no"
            self.question = message
        return None

    @property
    def mode(self) -> SlaveMode | None:
        """The slave mode that is played in; None until the controller's generation is known."""
        if self.peer is None:
            return None
        return slave_mode_by_number(self.peer.mode, Generation(self.peer.generation))

    @property
    def buffer_margin(self) -> tuple[int, float, float] | None:
        """Say how near the controller's buffer came to running empty, by a model: it takes a point each 8 ms.

        Returns:
            Slots, ms that a full buffer lasts, and ms of that which were left at the longest pause so far;
            None where a pause is no error, or nothing was sent yet.
        """
        mode, progress = self.mode, self.progress
        if mode is None or progress is None or not progress.cycle or mode.underflow_is_error is False:
            return None
        whole = float(mode.buffer_slots * PERIOD_MS)
        longest = progress.cycle[-1][1] / 1e6
        return mode.buffer_slots, whole, whole - max(0.0, longest - PERIOD_MS)

    def _check_peer(self, peer: ControllerInfo) -> None:
        """Check the trajectory against what is there."""
        self.peer = peer
        self.preflight = run_preflight(
            self.trajectory,
            self.plan.period / 1e9,
            with_limits(limits_for_arm(peer.type_name), self.plan.limits),
            current_pose=peer.pose,
            mode=self.mode,
            loop=self.plan.rounds != 1,
        )
