"""The cleanup at the end of a player's session, even if the session ends with an error."""

from __future__ import annotations

from collections.abc import Awaitable, Callable

from bcapscope.errors import BcapError, CallTimeout, ControllerError
from bcapscope.messages import Message
from bcapscope.player.blocking_caller import Channel
from bcapscope.player.player_messages import CleanupTask, PendingCleanup, PlayerProblem
from bcapscope.player.player_pipe import PlayerPipe
from bcapscope.player.robot_adapter import RobotAdapter
from bcapscope.protocol.tables.hresult import E_BUSY

_BUSY_TIMEOUT = 5_000_000_000
"""Maximum time in ns to wait for a controller that is busy with an earlier call."""

_BUSY_PAUSE = 20_000_000


class CleanupStack:
    """Runs the cleanup tasks, newest first.

    The player reports the remaining tasks to its parent process after each change. If the player crashes, the
    parent starts another player, which runs the remaining tasks.
    """

    def __init__(self, robot: RobotAdapter, pipe: PlayerPipe, channel: Channel) -> None:
        self.is_controller_gone = False
        self._robot = robot
        self._pipe = pipe
        self._channel = channel
        self._tasks: list[CleanupTask] = []

    async def run_and_push(self, task: CleanupTask, step: Callable[[], Awaitable[None]]) -> None:
        """Add `task` to the stack, then run `step`. `task` later undoes what `step` did. If the controller
        refuses `step`, remove `task` from the stack.

        `task` is on the stack before `step` runs, because `step` can take effect even if it fails: the
        controller may execute a call whose reply is lost.
        """
        self.push(task)
        try:
            await step()
        except ControllerError:
            self.remove(task)
            raise

    def push(self, *tasks: CleanupTask) -> None:
        self._tasks += tasks
        self._report_tasks()

    async def clean_up_all(self) -> None:
        """Run all cleanup tasks. If the controller refuses a task, report the refusal and continue."""
        while self._tasks and not self.is_controller_gone:
            task = self._tasks[-1]
            await self._clean_up(task)
            if not self.is_controller_gone:
                self.remove(task)

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
                    self._pipe.send(PlayerProblem(Message("play.while-leaving", reason=error.message)))
                    return
            self._channel.wait_until(self._channel.now() + _BUSY_PAUSE)

    def remove(self, task: CleanupTask) -> None:
        self._tasks.remove(task)
        self._report_tasks()

    def _report_tasks(self) -> None:
        self._pipe.send(PendingCleanup(tuple(self._tasks), self._robot.generation, self._channel.local[1]))
