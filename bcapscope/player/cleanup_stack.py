"""What a visit has begun and has to end, however it ends."""

from __future__ import annotations

from collections.abc import Awaitable, Callable

from bcapscope.errors import BcapError, CallTimeout, ControllerError
from bcapscope.player.channel import Channel
from bcapscope.player.player_messages import CleanupTask, PendingCleanup, PlayerProblem
from bcapscope.player.player_pipe import PlayerPipe
from bcapscope.player.robot_adapter import RobotAdapter
from bcapscope.protocol.tables.hresult import E_BUSY

_BUSY_TIMEOUT = 5_000_000_000
"""ns that a controller may be at work on a call that was given up; it takes no other meanwhile."""

_BUSY_PAUSE = 20_000_000


class CleanupStack:
    """Ends what was begun, the newest first, and tells of it, so that somebody else can.

    Attributes:
        is_controller_gone: the controller does not answer any more, so that the rest is left to it.
    """

    def __init__(self, robot: RobotAdapter, pipe: PlayerPipe, channel: Channel) -> None:
        """Begin with none."""
        self.is_controller_gone = False
        self._robot = robot
        self._pipe = pipe
        self._channel = channel
        self._tasks: list[CleanupTask] = []

    async def run_and_push(self, task: CleanupTask, step: Callable[[], Awaitable[None]]) -> None:
        """Begin what has to be ended.

        It has to be from before the call on, whose reply may be lost, unless the controller refuses it.
        """
        self.push(task)
        try:
            await step()
        except ControllerError:
            self.remove(task)
            raise

    def push(self, *tasks: CleanupTask) -> None:
        """Note what has to be ended, the oldest first."""
        self._tasks += tasks
        self._report_tasks()

    async def clean_up_all(self) -> None:
        """End all of it; what the controller refuses is told, and the rest goes on."""
        while self._tasks and not self.is_controller_gone:
            debt = self._tasks[-1]
            await self._clean_up(debt)
            if not self.is_controller_gone:
                self.remove(debt)

    async def _clean_up(self, task: CleanupTask) -> None:
        give_up = self._channel.now() + _BUSY_TIMEOUT
        while True:
            try:
                return await self._robot.clean_up(task)
            except (CallTimeout, OSError):
                self.is_controller_gone = True
                return
            except BcapError as error:
                busy = isinstance(error, ControllerError) and error.hresult == E_BUSY
                if not busy or self._channel.now() >= give_up:
                    self._pipe.send(PlayerProblem(f"while leaving: {error}"))
                    return
            self._channel.wait_until(self._channel.now() + _BUSY_PAUSE)

    def remove(self, task: CleanupTask) -> None:
        """Note that something has ended."""
        self._tasks.remove(task)
        self._report_tasks()

    def _report_tasks(self) -> None:
        self._pipe.send(PendingCleanup(tuple(self._tasks), self._robot.generation, self._channel.local[1]))
