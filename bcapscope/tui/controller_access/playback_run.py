"""The state of a running player, as the screen shows it, and the answers to the player's questions.

The player is a separate process. This module only stores the messages of the player process.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass, field

from msgspec import structs

from bcapscope.messages import Message
from bcapscope.player.player_messages import (
    ControllerInfo,
    PlayEnded,
    PlayerMessage,
    PlayerProblem,
    PlayerQuestion,
    PlayPlan,
    PlayProgress,
    QuestionTopic,
    SetPointValues,
)
from bcapscope.player.preflight import PreflightResult, run_preflight_for
from bcapscope.player.realtime import RealtimeReport
from bcapscope.player.trajectory import Trajectory
from bcapscope.protocol.slave_mode.modes import PERIOD_MS, SlaveMode

MAX_SAMPLES = 600
"""Number of readings in the plots: half a minute at twenty readings per second."""


@dataclass(slots=True)
class PlaybackRun:
    """Everything known about one run.

    Attributes:
        samples: Latest readings, each as elapsed seconds, set point and returned pose.
        preflight: Pre-flight check against the connected controller; None before the connection.
        readiness: Text on the real-time settings that the system allows; None until the player reports them.
    """

    plan: PlayPlan
    trajectory: Trajectory
    progress: PlayProgress | None = None
    samples: deque[tuple[float, SetPointValues, SetPointValues]] = field(
        default_factory=lambda: deque(maxlen=MAX_SAMPLES)
    )
    peer: ControllerInfo | None = None
    preflight: PreflightResult | None = None
    readiness: Message | None = None
    troubles: list[PlayerProblem] = field(default_factory=list)
    question: PlayerQuestion | None = None
    ended: PlayEnded | None = None

    def on_message(self, message: PlayerMessage) -> str | None:
        """Store a message of the player; return the answer to a question that needs no user."""
        if isinstance(message, PlayProgress):
            if message.of or self.progress is None:
                self.progress = message
            else:
                self.progress = structs.replace(self.progress, state=message.state)
            if message.commanded:
                self.samples.append((message.elapsed, message.commanded, message.returned))
        elif isinstance(message, ControllerInfo):
            self.peer = message
            self.preflight = run_preflight_for(self.trajectory, self.plan, message)
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
        """Slave mode in which the player plays; None until the controller is known."""
        return None if self.peer is None else self.peer.slave_mode

    @property
    def buffer_margin(self) -> tuple[int, float, float] | None:
        """Margin of the controller's buffer by a model: the controller takes one set point each 8 ms.

        Returns:
            Number of buffer slots, ms that a full buffer lasts, and ms that remained at the longest pause.
            None
            if underflow is no error in this mode, or before the first set point.
        """
        mode, progress = self.mode, self.progress
        if mode is None or progress is None or not progress.cycle or mode.underflow_is_error is False:
            return None
        whole = float(mode.buffer_slots * PERIOD_MS)
        longest = progress.cycle[-1][1] / 1e6
        return mode.buffer_slots, whole, whole - max(0.0, longest - PERIOD_MS)
