"""Play a trajectory: read and check the file, run the player process, and collect the player's messages."""

from __future__ import annotations

import asyncio
from collections import deque
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path

from msgspec import structs

from bcapscope.client.controller_target import ControllerTarget
from bcapscope.messages import Message
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
    SetPointValues,
    SlaveModePacing,
)
from bcapscope.player.player_process import PlayerProcess
from bcapscope.player.preflight import PreflightResult, run_preflight, run_preflight_for
from bcapscope.player.realtime import RealtimeReport
from bcapscope.player.resampling import resample
from bcapscope.player.trajectory import Trajectory, TrajectoryError
from bcapscope.player.trajectory_reader import read_trajectories
from bcapscope.protocol.slave_mode.modes import PERIOD_MS
from bcapscope.render.color_palette import Palette
from bcapscope.render.preflight_text import PreflightRenderer, source_lines, trajectory_line
from bcapscope.tui.reader_language import reader_words


@dataclass(frozen=True, slots=True)
class PlaybackSettings:
    """The user's settings for playing a trajectory."""

    path: str
    index: int  # number of the trajectory in the file, from 1
    mode: SlaveModePacing | int
    interval: float  # cycle time in ms
    speed: float  # factor for the speed in the file; 1 for the same speed
    rounds: int  # 0 repeats until stopped
    always_resample: bool  # resample even if `speed` is 1
    limits: tuple[str, ...]  # in the notation of `player.arm_limits.with_limits`


@dataclass(frozen=True, slots=True)
class PreparedTrajectory:
    """A trajectory that is ready to play. The check in `preflight` does not know the robot's position yet."""

    settings: PlaybackSettings
    all_trajectories: tuple[Trajectory, ...]
    trajectory: Trajectory
    preflight: PreflightResult

    def summary_lines(self, palette: Palette, width: int) -> Iterator[str]:
        """Yield how bcapscope read the file, the file's trajectories, and the pre-flight result."""
        yield from source_lines(self.trajectory, reader_words(), width)
        if len(self.all_trajectories) > 1:
            yield from (
                f"  {trajectory_line(number, each, reader_words())}"
                for number, each in enumerate(self.all_trajectories, 1)
            )
        yield ""
        yield from PreflightRenderer(palette, width, reader_words()).lines(self.preflight)

    def make_plan(self, target: ControllerTarget, robot: str, armed: bool, record: Path) -> PlayPlan:
        """Set `armed` if the user confirmed that the robot may move. `record` is a new recording."""
        settings, trajectory = self.settings, self.trajectory
        return PlayPlan(
            target=target,
            robot=robot,
            kind=trajectory.kind,
            mode=settings.mode,
            period=round(settings.interval * 1e6),
            points=list(map(tuple, trajectory.points.tolist())),
            rounds=settings.rounds,
            armed=armed,
            limits=settings.limits,
            record=str(record),
        )


def prepare_trajectory(settings: PlaybackSettings, type_name: str) -> PreparedTrajectory:
    """Read, resample and check a trajectory. These steps can take long. `type_name` is the robot's type;
    empty if unknown. Raises `TrajectoryError` if the file lacks the trajectory, or `ValueError` for invalid
    limits.
    """
    found = read_trajectories(settings.path)
    if not 1 <= settings.index <= len(found):
        raise TrajectoryError(Message("trajectory.no-such-number", count=len(found), number=settings.index))
    trajectory = found[settings.index - 1]
    if settings.always_resample or settings.speed != 1:
        trajectory = resample(trajectory, settings.interval / 1000, speed=settings.speed)
    limits = with_limits(limits_for_arm(type_name), settings.limits)
    preflight = run_preflight(trajectory, settings.interval / 1000, limits, loop=settings.rounds != 1)
    return PreparedTrajectory(settings, found, trajectory, preflight)


POLL_SECONDS = 0.1


class PlayerSlot:
    """Holds at most one player."""

    _player: PlayerProcess | None = None
    _ended: PlayEnded | None = None

    def __init__(self) -> None:
        self._read_lock = asyncio.Lock()

    @property
    def is_playing(self) -> bool:
        return self._player is not None

    async def start_player(self, plan: PlayPlan) -> None:
        """Start a player; raises `OSError` if its process cannot be started."""
        assert self._player is None
        self._ended = None
        starting = asyncio.ensure_future(asyncio.to_thread(PlayerProcess, plan))
        try:
            self._player = await asyncio.shield(starting)
        except asyncio.CancelledError:  # the screen is closed while the process starts
            player = await starting
            await asyncio.to_thread(player.close)
            raise

    async def next_messages(self) -> list[PlayerMessage]:
        """Wait at most `POLL_SECONDS` for messages. A player's last message is always a `PlayEnded`."""
        async with self._read_lock:
            if self._player is not None:
                return await asyncio.to_thread(self._player.wait_for_messages, POLL_SECONDS)
        await asyncio.sleep(POLL_SECONDS)
        return [] if self._ended is None else [self._ended]

    def answer_question(self, choice: str) -> None:
        if self._player is not None:
            self._player.answer(choice)

    def stop(self) -> None:
        """Bring the robot to rest on its path, then end the player, without waiting."""
        if self._player is not None:
            self._player.stop()

    def halt(self) -> bool:
        """Stop the robot without waiting; return whether a player is running. Any thread may call this."""
        player = self._player
        if player is not None:
            player.halt()
        return player is not None

    async def end_player(self) -> None:
        """If a player is running, stop it cleanly and wait until it has ended."""
        player, self._player = self._player, None
        if player is not None:
            player.stop()
            async with self._read_lock:
                self._ended = await asyncio.to_thread(player.close)


MAX_SAMPLES = 600  # the player reports 20 samples per second, so the screen keeps those of half a minute


@dataclass(slots=True)
class PlaybackRun:
    """The reports of the player about one playback of a trajectory."""

    plan: PlayPlan
    trajectory: Trajectory
    progress: PlayProgress | None = None
    samples: deque[tuple[float, SetPointValues, SetPointValues]] = field(
        default_factory=lambda: deque(maxlen=MAX_SAMPLES)
    )  # the latest readings: elapsed seconds, set point and returned pose
    peer: ControllerInfo | None = None
    preflight: PreflightResult | None = None  # against the connected controller
    readiness: Message | None = None  # which real-time settings the system allows
    troubles: list[PlayerProblem] = field(default_factory=list)
    question: PlayerQuestion | None = None
    ended: PlayEnded | None = None

    def on_message(self, message: PlayerMessage) -> str | None:
        """Store a player's message. If the player asks whether to begin, return the answer, else None."""
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
    def buffer_margin(self) -> tuple[int, float, float] | None:
        """Return the number of slots of the controller's buffer, how long a full buffer lasts (ms), and how
        much of this time was left at the end of the longest cycle (ms). bcapscope assumes that the controller
        takes one set point from the buffer every 8 ms. The result is None before the second set point, and if
        the slave mode is unknown or allows an empty buffer.
        """
        mode = None if self.peer is None else self.peer.slave_mode
        progress = self.progress
        if mode is None or progress is None or not progress.cycle or mode.underflow_is_error is False:
            return None
        whole = float(mode.buffer_slots * PERIOD_MS)
        longest = progress.cycle[-1][1] / 1e6
        return mode.buffer_slots, whole, whole - max(0.0, longest - PERIOD_MS)
