"""Sessions in memory, recorded: what a client says to a controller becomes a script."""

from __future__ import annotations

from collections.abc import Awaitable, Callable

from bcapscope.client import Session, open_session, over_link
from bcapscope.client.paces import PACES
from bcapscope.client.reach import Reach
from bcapscope.player.exchanger import BlockingExchanger, run
from bcapscope.protocol.convention import Convention
from bcapscope.replay.performance import Performance, Played
from bcapscope.replay.script import Script, scripts_of
from bcapscope.simulator.profile import PROFILES
from bcapscope.simulator.server import Answerer
from bcapscope.simulator.simulator import Simulator
from bcapscope.traffic.exchange import Exchange
from bcapscope.traffic.observation import Observation
from bcapscope.traffic.tracker import Tracker
from bcapscope.transport.clock import run_virtually
from bcapscope.transport.memory import memory_pair
from tests.client.simulated import Controller
from tests.player.simulated import SimulatedChannel

CONNECT = ("", "CaoProv.DENSO.VRC", "localhost", "")
MINUTE = 60_000_000_000

Play = Callable[[Session], Awaitable[None]]


def talk(play: Play, controller: Answerer, datagrams: bool = True) -> list[Observation]:
    """Let a client talk to a controller; return all frames."""
    seen: list[Observation] = []

    async def speak() -> None:
        near, far = memory_pair(datagrams=datagrams)
        Controller(controller).plug("client", far)
        async with open_session(over_link(near), observer=seen.append) as session:
            await play(session)

    run_virtually(speak())
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


class _Stream:
    """A controller that is reached over TCP, for a channel that knows packets."""

    def __init__(self, controller: Answerer) -> None:
        controller.connect("player", 0)
        self.datagram = controller.segment
        self.advance = controller.advance
        self.due = controller.due


class Wire(SimulatedChannel):
    """A channel to a controller, without delay, that notes what passes."""

    def __init__(self, controller: Answerer, datagrams: bool) -> None:
        end = controller if datagrams else _Stream(controller)
        super().__init__(end, delay=0)  # type: ignore[arg-type]  # as much of a simulator as it needs
        self.datagrams = datagrams


def perform(
    script: Script,
    controller: Answerer,
    told: Callable[[Played], bool] = lambda played: True,
    *,
    longest_pause: int = MINUTE,
    anywhere: bool = False,
    before: Play | None = None,
    datagrams: bool = True,
) -> tuple[list[Played], Wire]:
    """Play a script to a controller; return what came of each call, and the channel."""
    heard: list[Played] = []
    wire = Wire(controller, datagrams)

    def hear(played: Played) -> bool:
        heard.append(played)
        return told(played)

    async def play() -> None:
        convention = Convention.SEED if datagrams else Convention.TCP0
        session = Session(BlockingExchanger(wire, convention), PACES)
        try:
            if before is not None:
                await before(session)
            reach = Reach(session, "", CONNECT, {})
            await Performance(script, reach, wire, longest_pause, anywhere).play(hear)
        finally:
            await session.close()

    run(play())
    return heard, wire
