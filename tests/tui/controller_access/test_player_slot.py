"""The player that is at work, watched by one and ended by another."""

from __future__ import annotations

import asyncio

from bcapscope.client.controller_target import ControllerTarget
from bcapscope.player.player_messages import PlayEnded, PlayOutcome, PlayPlan, PlayProgress, SlaveModePacing
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
