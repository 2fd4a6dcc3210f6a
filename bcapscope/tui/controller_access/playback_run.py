"""The running player: its process, and the state that the screen shows."""

from __future__ import annotations

import asyncio
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
from bcapscope.player.player_process import PlayerProcess
from bcapscope.player.preflight import PreflightResult, run_preflight_for
from bcapscope.player.realtime import RealtimeReport
from bcapscope.player.trajectory import Trajectory
from bcapscope.protocol.slave_mode.modes import PERIOD_MS, SlaveMode

POLL_SECONDS = 0.1
"""Maximum time in seconds of one poll for the player's messages."""


class PlayerSlot:
    """Holds at most one player."""

    def __init__(self) -> None:
        self._player: PlayerProcess | None = None
        self._ended: PlayEnded | None = None
        self._read_lock = asyncio.Lock()

    @property
    def is_playing(self) -> bool:
        return self._player is not None

    async def start_player(self, plan: PlayPlan) -> None:
        """Start a player; raises `OSError` if its process cannot be started."""
        assert self._player is None
        self._ended = None
        self._player = await asyncio.to_thread(PlayerProcess, plan)

    async def next_messages(self) -> list[PlayerMessage]:
        """Wait at most `POLL_SECONDS` seconds for messages of the player, and return those that arrived.

        The last message of a player says how the run ended, even if another caller ended the run.
        """
        async with self._read_lock:
            if self._player is not None:
                return await asyncio.to_thread(self._player.wait_for_messages, POLL_SECONDS)
        await asyncio.sleep(POLL_SECONDS)
        return [] if self._ended is None else [self._ended]

    def answer_question(self, choice: str) -> None:
        if self._player is not None:
            self._player.answer(choice)

    def stop(self) -> None:
        """Tell the player to bring the robot to rest on its path, and then to end in order."""
        if self._player is not None:
            self._player.stop()

    def halt(self) -> bool:
        """Stop the robot without waiting; return whether a player is running. Any thread may call this."""
        player = self._player
        if player is not None:
            player.halt()
        return player is not None

    async def end_player(self) -> None:
        """If a player is running, stop it in order and wait until it has ended."""
        player, self._player = self._player, None
        if player is not None:
            player.stop()
            async with self._read_lock:
                self._ended = await asyncio.to_thread(player.close)


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
