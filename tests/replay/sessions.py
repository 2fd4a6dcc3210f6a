"""Sessions in memory, recorded: what a client says to a controller becomes a script."""

from __future__ import annotations

from collections.abc import Awaitable, Callable

from bcapscope.client import Session, open_session
from bcapscope.client.controller_target import DEFAULT_RETRY_POLICIES, ControllerTarget
from bcapscope.client.object_opener import ObjectOpener
from bcapscope.player.blocking_caller import BlockingCaller, run_blocking
from bcapscope.protocol.retry.reserved_convention import ReservedConvention
from bcapscope.replay.replay_script import ReplayScript, scripts_of
from bcapscope.replay.script_player import PlayedCall, ScriptPlayer
from bcapscope.simulator.profile import PROFILES
from bcapscope.simulator.simulator import Simulator
from bcapscope.simulator.simulator_server import ControllerModel
from bcapscope.traffic.call import Call
from bcapscope.traffic.observation import Observation
from bcapscope.traffic.tracker import Tracker
from tests.client.simulated import Controller
from tests.memory_link import memory_link_pair, over_link
from tests.player.simulated import SimulatedChannel
from tests.virtual_time import run_in_virtual_time

TARGET = ControllerTarget("memory")
CONNECT = TARGET.connect
MINUTE = 60_000_000_000

Play = Callable[[Session], Awaitable[None]]


def talk(play: Play, controller: ControllerModel, datagrams: bool = True) -> list[Observation]:
    """Let a client talk to a controller; return all frames."""
    seen: list[Observation] = []

    async def speak() -> None:
        near, far = memory_link_pair(datagrams=datagrams)
        Controller(controller).plug("client", far)
        async with open_session(over_link(near), observer=seen.append) as session:
            await play(session)

    run_in_virtual_time(speak())
    return seen


def script_of(seen: list[Observation]) -> ReplayScript:
    """Make a script of what was seen."""
    tracker = Tracker()
    settled = [each for one in seen for each in tracker.observe(one)]
    settled += tracker.close()
    (script,) = scripts_of(each for each in settled if isinstance(each, Call))
    return script


def recorded(play: Play, profile: str = "rc8", datagrams: bool = True) -> ReplayScript:
    """Record a session with the simulator."""
    return script_of(talk(play, Simulator(PROFILES[profile]), datagrams))


class _Stream:
    """A controller that is reached over TCP, for a channel that knows packets."""

    def __init__(self, controller: ControllerModel) -> None:
        controller.on_connect("player", 0)
        self.on_datagram = controller.on_segment
        self.advance = controller.advance
        self.due = controller.due


class Wire(SimulatedChannel):
    """A channel to a controller, without delay, that notes what passes."""

    def __init__(self, controller: ControllerModel, datagrams: bool) -> None:
        end = controller if datagrams else _Stream(controller)
        super().__init__(end, delay=0)  # type: ignore[arg-type]  # as much of a simulator as it needs
        self.datagrams = datagrams


def perform(
    script: ReplayScript,
    controller: ControllerModel,
    told: Callable[[PlayedCall], bool] = lambda played: True,
    *,
    longest_pause: int = MINUTE,
    anywhere: bool = False,
    before: Play | None = None,
    datagrams: bool = True,
) -> tuple[list[PlayedCall], Wire]:
    """Play a script to a controller; return what came of each call, and the channel."""
    heard: list[PlayedCall] = []
    wire = Wire(controller, datagrams)

    def hear(played: PlayedCall) -> bool:
        heard.append(played)
        return told(played)

    async def play() -> None:
        convention = ReservedConvention.SEED if datagrams else ReservedConvention.TCP0
        session = Session(BlockingCaller(wire, convention), DEFAULT_RETRY_POLICIES)
        try:
            if before is not None:
                await before(session)
            reach = ObjectOpener(session, TARGET)
            await ScriptPlayer(script, reach, wire, longest_pause, anywhere).play(hear)
        finally:
            await session.close()

    run_blocking(play())
    return heard, wire
