"""The player that is at work, watched by one and ended by another."""

from __future__ import annotations

import asyncio

from bcapscope.client.target import Target
from bcapscope.player.messages import Ended, Outcome, Pacing, Plan, Progress
from bcapscope.tui.desk.builtin import JOINTS, BuiltIn
from bcapscope.tui.desk.playing import Stage

LIMIT = 60.0


def test_whoever_watches_hears_how_it_ended_though_another_ends_it(simulator: BuiltIn) -> None:
    async def run() -> Ended:
        stage = Stage()
        target = Target(simulator.host, simulator.port)
        await stage.begin(Plan(target=target, mode=Pacing.ASYNC, points=[JOINTS[:6]] * 100, rounds=0))
        ending: asyncio.Task[None] | None = None
        while True:
            for message in await stage.messages():
                if isinstance(message, Ended):
                    assert ending is not None
                    await ending
                    assert not stage.is_taken
                    assert not stage.halt()
                    assert await stage.messages() == [message]
                    return message
                if isinstance(message, Progress) and message.index and ending is None:
                    ending = asyncio.ensure_future(stage.end())
                if not isinstance(message, Progress):
                    stage.answer("yes")

    ended = asyncio.run(asyncio.wait_for(run(), LIMIT))
    assert ended.outcome is Outcome.STOPPED
    assert ended.left
