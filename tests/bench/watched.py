"""How late set points go out while the screen is busy, and while there is none, turn by turn.

The player is started as the screen starts it. The screen is a program in a terminal of its own: it draws the
plots of the run as fast as the player tells of it, and on another of its screens it follows traffic of 2,000
frames a second. Run from the project's root as ``python -m tests.bench.watched``.
"""

from __future__ import annotations

import argparse
import asyncio
import sys
import tempfile
from pathlib import Path
from statistics import median

import msgspec
import numpy as np
from textual.app import ComposeResult

from bcapscope.client.controller_target import ControllerTarget
from bcapscope.messages import Message
from bcapscope.player.lateness import Spread
from bcapscope.player.player_messages import PlayPlan
from bcapscope.player.trajectory import Trajectory, TrajectorySource
from bcapscope.protocol.slave_mode.modes import PoseType
from bcapscope.tui.app import BcapApp, ScreenEntry, app_of
from bcapscope.tui.controller_access.playback import PlaybackRun, PlayerSlot
from bcapscope.tui.screens.base_screen import BaseScreen
from bcapscope.tui.screens.traffic_screen import TrafficScreen
from bcapscope.tui.tester.playback_view import PlaybackView
from bcapscope.tui.traffic_processes.process_messages import ReadJob
from bcapscope.tui.traffic_processes.traffic_feed import TrafficFeed
from tests.bench.play import HEAD, Round, has_priority, line, measured, options, play, simulator, wave
from tests.bench.screen import LIVE_RATE, growing
from tests.bench.terminal import Terminal

PERIOD = 8_000_000
SIZE = 200, 50
_POINTS = ("p50", "p99", "p999", "most")


class Watching(BaseScreen):
    """Plays and draws, as the screen of slave mode does."""

    NAME = "tester.slave"
    ABOUT = "tester.slave.about"

    def __init__(self, plan: PlayPlan, result: Path) -> None:
        super().__init__()
        self._plan, self._result = plan, result

    def content(self) -> ComposeResult:
        """Show nothing but the run."""
        yield PlaybackView()

    def on_mount(self) -> None:
        """Begin, once the other screen is at work too."""
        self.run_worker(self._play())

    async def _play(self) -> None:
        app = app_of(self)
        await app.switch_mode("traffic")
        await asyncio.sleep(2.0)
        await app.switch_mode("watching")
        stage, live = PlayerSlot(), self.query_one(PlaybackView)
        trajectory = Trajectory(
            PoseType.J,
            np.array(self._plan.points),
            TrajectorySource("wave", Message.from_table("text", "made up")),
        )
        run = PlaybackRun(self._plan, trajectory)
        await stage.start_player(self._plan)
        while run.ended is None:
            for message in await stage.next_messages():
                answer = run.on_message(message)
                if answer is not None or run.question is not None:
                    stage.answer_question(answer or "yes")
            live.show_run(run)
        await stage.end_player()
        self._result.write_bytes(msgspec.json.encode(run.ended.lateness))
        await app.action_quit()


def watch(plan: Path, capture: Path, result: Path) -> None:
    """Be the screen."""
    wanted = msgspec.json.decode(plan.read_bytes(), type=PlayPlan)
    feed = TrafficFeed(ReadJob(path=str(capture), follow=True))
    spots = [
        ScreenEntry("watching", "f2", "tester.slave", lambda: Watching(wanted, result)),
        ScreenEntry("traffic", "f3", "traffic", lambda: TrafficScreen(feed, capture.name)),
    ]
    BcapApp(spots, result.with_name("screen.yaml")).run()


def watched(plan: PlayPlan, folder: Path, limit: float) -> Spread:
    """Play with a screen that is busy."""
    paths = folder / "plan.json", folder / "growing.pcap", folder / "lateness.json"
    paths[0].write_bytes(msgspec.json.encode(plan))
    argv = [sys.executable, "-m", "tests.bench.watched", "--watch", *map(str, paths)]
    with growing(paths[1]), Terminal(argv, *SIZE) as terminal:
        terminal.wait(limit)
    return msgspec.json.decode(paths[2].read_bytes(), type=Spread)


def measure(target: ControllerTarget, seconds: float, rounds: int, folder: Path) -> None:
    """Play with and without, in alternation, and print both."""
    priority = has_priority()
    plan = wave(target, PERIOD, round(seconds * 1e9 / PERIOD), priority)
    print(
        f"a set point each {PERIOD / 1e6:g} ms, {rounds} rounds of {seconds:g} s in turns; lateness in µs; "
        f"the busy screen draws {SIZE[0]} x {SIZE[1]} and follows {LIVE_RATE} frames/s"
    )
    print(HEAD)
    alone: list[Round] = []
    busy: list[Round] = []
    for _ in range(rounds):
        alone.append(measured(lambda: play(plan)))
        busy.append(measured(lambda: watched(plan, folder, seconds + 60)))
    print(line(f"no screen{'' if priority else ' (no real-time priority)'}", alone))
    print(line("the screen is busy", busy))
    print(f"{'times as late':38}" + "".join(f"{_ratio(point, busy, alone):10.2f}" for point in _POINTS))


def _ratio(point: str, busy: list[Round], alone: list[Round]) -> float:
    ours, bare = (float(median(getattr(each.spread, point) for each in rounds)) for rounds in (busy, alone))
    return ours / max(1.0, bare)


def main() -> None:
    """Measure as the command line asks."""
    parser = options(__doc__, seconds=20.0, rounds=3)
    parser.add_argument("--watch", nargs=3, type=Path, help=argparse.SUPPRESS)
    chosen = parser.parse_args()
    if chosen.watch:
        watch(*chosen.watch)
        return
    with tempfile.TemporaryDirectory(prefix="bcap-bench-") as name, simulator() as target:
        measure(target, chosen.seconds, chosen.rounds, Path(name))


if __name__ == "__main__":
    main()
