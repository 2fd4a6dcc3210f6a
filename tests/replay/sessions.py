"""Sessions in memory, recorded: what a client says to a controller becomes a script."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable

from bcapscope.client import Session, open_session, over_link
from bcapscope.client.reach import Reach
from bcapscope.replay.performance import Performance, Played
from bcapscope.replay.script import Script, scripts_of
from bcapscope.simulator.profile import PROFILES
from bcapscope.simulator.server import Answerer
from bcapscope.simulator.simulator import Simulator
from bcapscope.traffic.exchange import Exchange
from bcapscope.traffic.observation import Observation
from bcapscope.traffic.tracker import Tracker
from bcapscope.transport.clock import Clock, run_virtually
from bcapscope.transport.memory import memory_pair
from tests.client.simulated import Controller

CONNECT = ("", "CaoProv.DENSO.VRC", "localhost", "")
MINUTE = 60_000_000_000

Play = Callable[[Session], Awaitable[None]]


def talk(play: Play, controller: Answerer, datagrams: bool = True) -> list[Observation]:
    """Let a client talk to a controller; return all frames."""
    seen: list[Observation] = []

    async def run() -> None:
        near, far = memory_pair(datagrams=datagrams)
        Controller(controller).plug("client", far)
        async with open_session(over_link(near), observer=seen.append) as session:
            await play(session)

    run_virtually(run())
    return seen


def script_of(seen: list[Observation]) -> Script:
    """Make a script of what was seen."""
    tracker = Tracker()
    settled = [each for one in seen for each in tracker.observe(one)]
    settled += tracker.close()
    (script,) = scripts_of(each for each in settled if isinstance(each, Exchange))
    return script


def recorded(play: Play, profile: str = "rc8", datagrams: bool = True) -> Script:
    """Record a session with the simulator."""
    return script_of(talk(play, Simulator(PROFILES[profile]), datagrams))


def perform(
    script: Script,
    controller: Answerer,
    told: Callable[[Played], bool] = lambda played: True,
    *,
    longest_pause: int = MINUTE,
    before: Play | None = None,
    datagrams: bool = True,
) -> tuple[list[Played], list[Observation]]:
    """Play a script to a controller; return what came of each call, and all frames."""
    heard: list[Played] = []

    def hear(played: Played) -> bool:
        heard.append(played)
        return told(played)

    async def play(session: Session) -> None:
        clock = Clock(asyncio.get_running_loop())

        async def wait_until(when: int) -> None:
            await asyncio.sleep((when - clock.now()) / 1e9)

        if before is not None:
            await before(session)
        reach = Reach(session, "", CONNECT, {})
        await Performance(script, reach, clock.now, wait_until, longest_pause).play(hear)

    return heard, talk(play, controller, datagrams)
