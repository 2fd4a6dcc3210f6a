"""The player that is at work, watched by one and ended by another."""

from __future__ import annotations

import asyncio
import threading

import pytest

from bcapscope.client.controller_target import ControllerTarget
from bcapscope.player.player_messages import PlayEnded, PlayOutcome, PlayPlan, PlayProgress, SlaveModePacing
from bcapscope.player.player_process import PlayerProcess
from bcapscope.tui.controller_access import playback
from bcapscope.tui.controller_access.builtin_simulator import START_JOINTS, BuiltInSimulator
from bcapscope.tui.controller_access.playback import PlayerSlot

LIMIT = 60.0


def test_whoever_watches_hears_how_it_ended_though_another_ends_it(simulator: BuiltInSimulator) -> None:
    async def run() -> PlayEnded:
        stage = PlayerSlot()
        target = ControllerTarget(simulator.host, simulator.port)
        await stage.start_player(
            PlayPlan(target=target, mode=SlaveModePacing.ASYNC, points=[START_JOINTS[:6]] * 100, rounds=0)
        )
        ending: asyncio.Task[None] | None = None
        while True:
            for message in await stage.next_messages():
                if isinstance(message, PlayEnded):
                    assert ending is not None
                    await ending
                    assert not stage.is_playing
                    assert not stage.halt()
                    assert await stage.next_messages() == [message]
                    return message
                if isinstance(message, PlayProgress) and message.index and ending is None:
                    ending = asyncio.ensure_future(stage.end_player())
                if not isinstance(message, PlayProgress):
                    stage.answer_question("yes")

    ended = asyncio.run(asyncio.wait_for(run(), LIMIT))
    assert ended.outcome is PlayOutcome.STOPPED
    assert ended.left


def test_a_player_that_starts_while_the_screen_closes_is_ended(
    simulator: BuiltInSimulator, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The task that starts a player is cancelled while the player's process is being created."""
    created: list[PlayerProcess] = []

    async def run() -> None:
        loop, creating, may_create = asyncio.get_running_loop(), asyncio.Event(), threading.Event()

        def create(plan: PlayPlan) -> PlayerProcess:
            loop.call_soon_threadsafe(creating.set)
            may_create.wait(LIMIT)
            created.append(PlayerProcess(plan))
            return created[0]

        monkeypatch.setattr(playback, "PlayerProcess", create)
        slot = PlayerSlot()
        target = ControllerTarget(simulator.host, simulator.port)
        plan = PlayPlan(target=target, mode=SlaveModePacing.ASYNC, points=[START_JOINTS[:6]] * 100)
        starting = asyncio.ensure_future(slot.start_player(plan))
        await creating.wait()
        starting.cancel()
        await asyncio.sleep(0)  # the task receives the cancellation
        may_create.set()
        with pytest.raises(asyncio.CancelledError):
            await starting
        assert not slot.is_playing

    asyncio.run(asyncio.wait_for(run(), LIMIT))
    (player,) = created
    assert player.ended is not None
