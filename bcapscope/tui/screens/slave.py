"""Slave Mode, as the button of b-CAP Tester has it: choose a log, look at it, Start; watch; Stop."""

from __future__ import annotations

import asyncio
import time
from collections.abc import Awaitable, Callable
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from typing import ClassVar

from textual import on, work
from textual.app import ComposeResult
from textual.binding import Binding, BindingType
from textual.containers import Horizontal, Vertical, VerticalScroll
from textual.css.query import NoMatches
from textual.widgets import Button, ContentSwitcher, Input, Select

from bcapscope.client.action_log import LoggedConnection
from bcapscope.client.armed_calls import ArmedCalls
from bcapscope.errors import BcapError
from bcapscope.player.armed_messages import ArmedMessages
from bcapscope.player.messages import Pacing, Progress, Topic
from bcapscope.protocol.numerals import read_integer, read_number
from bcapscope.protocol.slavemode import mode_pose_type
from bcapscope.protocol.variant import EMPTY, VT, Variant
from bcapscope.render.escape import printable
from bcapscope.render.playing import ended_lines, peer_line, trouble_lines
from bcapscope.render.preflight import PreflightRenderer
from bcapscope.tui.app import scope_of
from bcapscope.tui.desk.desk import Desk, handle_variant
from bcapscope.tui.desk.news import Status
from bcapscope.tui.desk.performance import Performance, Wish, prepare
from bcapscope.tui.desk.playing import Stage
from bcapscope.tui.desk.record import Who, cause
from bcapscope.tui.desk.recovery import Step, step
from bcapscope.tui.desk.slaverun import SlaveRun
from bcapscope.tui.ink import INK
from bcapscope.tui.screens.place import Place
from bcapscope.tui.settings import remembered
from bcapscope.tui.tester.ask import ChoiceDialog
from bcapscope.tui.tester.field import Caption
from bcapscope.tui.tester.files import FilePicker
from bcapscope.tui.tester.slavelive import SlaveLive
from bcapscope.tui.tester.tick import Tick
from bcapscope.tui.widgets.inked import InkedText
from bcapscope.tui.words import say, told

_NUMBERS = (0x001, 0x002, 0x003, 0x101, 0x102, 0x103, 0x201, 0x202, 0x203)
_MODES: tuple[tuple[str, Pacing | int], ...] = (
    *((pacing.value, pacing) for pacing in Pacing),
    *((f"0x{number:03X} {mode_pose_type(number)}", number) for number in _NUMBERS),
)
_PATIENCE = 0.4
"""Seconds after the last change before a file is read."""


_MOST_ROUNDS = 1_000_000_000


class SlaveScreen(Place):
    """Plays a trajectory. The player is a process of its own: what is drawn here holds up no set point."""

    NAME = "tester.slave"
    ABOUT = "tester.slave.about"
    HORIZONTAL_BREAKPOINTS = [(0, "-narrow"), (120, "-wide")]  # noqa: RUF012 - as Textual has it
    BINDINGS: ClassVar[list[BindingType]] = [
        Binding("f9", "start", "tester.start", id="slave.start", tooltip="tester.slave.start.tip"),
        Binding("escape", "leave", "tester.slave.leave", id="slave.leave", key_display="esc"),
        Binding("ctrl+o", "browse", "tester.browse", id="slave.browse"),
    ]

    def __init__(
        self, desk: Desk, stage: Stage, arm: Callable[[], Awaitable[bool]], records: Path, path: str = ""
    ) -> None:
        """Take what to play with.

        Args:
            desk: that is connected.
            stage: where the player works.
            arm: asks the user to arm.
            records: folder for captures of all that is said.
            path: of a file to begin with.
        """
        super().__init__()
        self._desk, self._stage, self._arm, self._records = desk, stage, arm, records
        self._first = path
        self._ready: Performance | None = None
        self._run: SlaveRun | None = None
        self._dialog: ChoiceDialog | None = None

    @property
    def run(self) -> SlaveRun | None:
        """The run that is watched, or was last; None before the first."""
        return self._run

    def content(self) -> ComposeResult:
        """Put the choice above what is known of it."""
        with Vertical(id="slave"):
            with Horizontal(classes="row"):
                yield Caption("tester.file")
                yield Input(self._first, id="file")
                yield Button(say("tester.browse"), compact=True, id="browse")
            with Horizontal(classes="row"):
                yield Caption("tester.mode")
                yield Select(_MODES, value=Pacing.SYNC, allow_blank=False, compact=True, id="mode")
                yield Caption("tester.interval")
                yield Input("8", id="interval", classes="number")
                yield Caption("tester.speed")
                yield Input("1", id="speed", classes="number")
                yield Caption("tester.rounds")
                yield Input("1", id="rounds", classes="number")
                yield Caption("tester.index")
                yield Input("1", id="index", classes="number")
            with Horizontal(classes="row"):
                yield Caption("tester.limits")
                yield Input(placeholder="J1=-170..170 J1..J3.speed=300 J1.acceleration=6000", id="limits")
                yield Tick(say("tester.resample"), id="again")
            with Horizontal(classes="row"):
                yield Button(say("tester.start"), compact=True, variant="success", id="start", disabled=True)
                yield Button(say("tester.stop"), compact=True, variant="warning", id="stop", disabled=True)
                yield Button(say("shell.halt"), compact=True, variant="error", id="halt")
                yield InkedText(id="slave-state")
            with ContentSwitcher(initial="before", id="slave-views"):
                with VerticalScroll(id="before"):
                    yield InkedText(id="report")
                yield SlaveLive(id="live")

    def on_mount(self) -> None:
        """Begin with the file that was given."""
        self._look()
        self.query_one("#file", Input).focus()

    # Before: read and check.

    @on(Input.Changed)
    @on(Select.Changed)
    @on(Tick.Changed)
    def _changed(self) -> None:
        self._look()

    def _look(self) -> None:
        """Read and check anew, a little later, unless something else is typed by then."""
        self._ready = None
        self.query_one("#start", Button).disabled = True
        self._state("")
        self._prepare()

    @work(group="prepare", exclusive=True)
    async def _prepare(self) -> None:
        await asyncio.sleep(_PATIENCE)
        with suppress(NoMatches):  # the screen is being closed
            await self._read()

    async def _read(self) -> None:
        """Read and check what is wished, and show what was found."""
        wish = self._wish()
        if isinstance(wish, str):
            self._report([f"{INK.dim}{wish}{INK.reset}"])
            return
        self._report([f"{INK.dim}{say('tester.reading')}{INK.reset}"])
        try:
            ready = await asyncio.to_thread(prepare, wish, self._desk.status.identity.type_name)
        except ValueError as error:  # what is wrong with the file, or with the limits
            self._report([f"{INK.bad}{printable(told(str(error)))}{INK.reset}"])
            return
        self._ready = ready
        lines = list(ready.lines(INK, self.query_one("#before").size.width - 2))
        self._report(lines)
        self._state(lines[-1])  # the verdict, which a low terminal has no room for below all the rest
        self.query_one("#start", Button).disabled = not ready.preflight.is_fit or self._stage.is_taken
        scope = scope_of(self)
        scope.settings.trajectories = remembered(str(Path(wish.path).absolute()), scope.settings.trajectories)
        scope.keep()

    def _wish(self) -> Wish | str:
        """Return what the fields ask for, or what is wrong with them."""
        path = self.query_one("#file", Input).value.strip()
        if not path:
            return say("tester.file.missing")
        interval = read_number(self._typed("interval"), 0.5, 1000)
        speed = read_number(self._typed("speed"), 0.01, 10)
        rounds = read_integer(self._typed("rounds"), 0, _MOST_ROUNDS)
        index = read_integer(self._typed("index"), 0, _MOST_ROUNDS)
        if interval is None or speed is None or rounds is None or index is None:
            return say("tester.play.numbers")
        return Wish(
            path=str(Path(path).expanduser()),
            mode=self._chosen_mode,
            interval=interval,
            speed=speed,
            rounds=rounds,
            index=index,
            again=self.query_one("#again", Tick).value,
            limits=tuple(self._typed("limits").replace(",", " ").split()),
        )

    @property
    def _chosen_mode(self) -> Pacing | int:
        chosen = self.query_one("#mode", Select).value
        return chosen if isinstance(chosen, Pacing | int) else Pacing.SYNC

    def _typed(self, name: str) -> str:
        return self.query_one(f"#{name}", Input).value

    def _report(self, lines: list[str]) -> None:
        self.query_one("#slave-views", ContentSwitcher).current = "before"
        self.query_one("#report", InkedText).write("\n".join(lines))

    @on(Button.Pressed, "#browse")
    def action_browse(self) -> None:
        """Choose a file."""

        def take(path: str | None) -> None:
            if path:
                self.query_one("#file", Input).value = path

        here = Path(self.query_one("#file", Input).value).expanduser().parent
        recent = scope_of(self).settings.trajectories
        self.app.push_screen(
            FilePicker(say("tester.browse"), recent, here if here.is_dir() else Path.cwd()), take
        )

    # While it plays.

    @on(Button.Pressed, "#start")
    def action_start(self) -> None:
        """Play; where nothing was read yet, say so."""
        if self._ready is None and not self._stage.is_taken:
            self._state(f"{INK.bad}{say('tester.start.none')}")
        elif self._ready is not None and self._ready.preflight.is_fit and not self._stage.is_taken:
            self.run_worker(self._play(self._ready), group="play")

    async def _play(self, ready: Performance) -> None:
        desk, status = self._desk, self._desk.status
        if status.target is None:
            self._state(f"{INK.bad}{say('tester.not_connected')}")
            return
        if not desk.arming.lets_pass(desk.now()) and not await self._arm():
            self._state(f"{INK.bad}{say('tester.not_armed')}")
            return
        if not await self._released(status):
            return
        robot = status.robot.label if status.robot else "Arm"
        record = (
            self._records / f"slave-{time.strftime('%Y%m%d-%H%M%S')}-{time.monotonic_ns() % 1000:03}.pcapng"
        )
        target = replace(status.target, name=f"{status.target.name}-player" if status.target.name else "")
        plan = ready.plan(target, robot, desk.arming.needed, record)
        self._run = run = SlaveRun(plan, ready.trajectory)
        self._busy(True)
        desk.rest(True)
        try:
            self._records.mkdir(parents=True, exist_ok=True)
            await self._stage.begin(plan)
            await self._follow(run)
        except OSError as error:
            self._state(f"{INK.bad}{printable(cause(error))}")
        finally:
            await self._stage.end()
            desk.rest(desk.status.slave_mode != 0)
            if self.query("#start"):  # else the screen is being closed
                self._busy(False)

    async def _released(self, status: Status) -> bool:
        """Leave slave mode, and give the arm back: the player is a client of its own, and needs both."""
        desk = self._desk
        try:
            if status.slave_mode:
                await desk.do(step(desk, Step.MODE, "", 0))
            if status.holds_arm and status.robot is not None:
                values = handle_variant(status.robot), Variant(VT.BSTR, "GiveArm"), EMPTY
                await desk.do(desk.invoke("Robot_Execute", *values, who=Who.SCREEN))
        except (BcapError, OSError) as error:
            self._state(f"{INK.bad}{printable(cause(error))}")
            return False
        return True

    async def _follow(self, run: SlaveRun) -> None:
        live = self.query_one(SlaveLive)
        self.query_one("#slave-views", ContentSwitcher).current = "live"
        live.focus()
        received = b""
        log = ArmedMessages(ArmedCalls(self._desk.log, LoggedConnection.of_target(run.plan.target)))
        while run.ended is None:
            for message in await self._stage.messages():
                if isinstance(message, Progress) and message.received != received:
                    received = message.received
                    self._desk.pulse.heard(self._desk.now())
                log.add(message)
                answer = run.take(message)
                if answer is not None:
                    self._stage.answer(answer)
            if run.question is not None:
                self._ask(run)
            doing = told(run.progress.state) if run.progress else say("tester.waiting")
            self._state(f"{INK.number}{printable(doing)}")
            live.show(run)
        self._end(run)

    def _ask(self, run: SlaveRun) -> None:
        """Let the user answer a question of the player's, while what it tells is read on."""
        question, run.question = run.question, None
        assert question is not None
        if question.topic is Topic.ARM and self._desk.arming.is_armed(self._desk.now()):
            self._stage.answer("yes")
            return
        facts = [told(line) for trouble in run.troubles[-1:] for line in trouble_lines(trouble)]
        if question.topic is not Topic.CLEAR:
            facts = [] if run.peer is None else [peer_line(run.peer, told)]
        facts += ["", printable(told(question.text))]
        choices = question.choices
        self._dialog = ChoiceDialog(facts, choices)
        self.app.push_screen(self._dialog, lambda choice: self._stage.answer(choice or choices[0]))

    def _end(self, run: SlaveRun) -> None:
        assert run.ended is not None
        if self._dialog is not None and self._dialog.is_current:
            self._dialog.dismiss(None)  # nobody waits for the answer any more
        if run.preflight is not None and not run.preflight.is_fit:
            width = self.query_one("#before").size.width - 2
            self._report(list(PreflightRenderer(INK, width, told).lines(run.preflight)))
        self._state(f"{INK.name}{told(next(ended_lines(run.ended)))}")

    def _busy(self, playing: bool) -> None:
        self.query_one("#start", Button).disabled = playing or self._ready is None
        self.query_one("#stop", Button).disabled = not playing
        for name in (
            "#file",
            "#mode",
            "#interval",
            "#speed",
            "#rounds",
            "#index",
            "#limits",
            "#again",
            "#browse",
        ):
            self.query_one(name).disabled = playing

    def _state(self, line: str) -> None:
        self.query_one("#slave-state", InkedText).write(line)

    @on(Button.Pressed, "#stop")
    def _stop(self) -> None:
        self._stage.stop()

    @on(Button.Pressed, "#halt")
    def _halt(self) -> None:
        scope_of(self).action_halt()

    def action_leave(self) -> None:
        """Let the robot come to rest if it moves, else go back."""
        if self._stage.is_taken:
            self._stage.stop()
        else:
            self.dismiss()
