"""The Slave Mode screen, as in b-CAP Tester: choose a trajectory, check it, play, watch, stop."""

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

from bcapscope.client.action_log import ArmedCallLogger, LoggedConnection
from bcapscope.client.controller_target import DEFAULT_ROBOT
from bcapscope.errors import BcapError
from bcapscope.live.controller.controller_session import ControllerSession
from bcapscope.live.controller.error_recovery import RecoveryStep, run_recovery_step
from bcapscope.live.controller.history_record import Initiator
from bcapscope.live.controller.session_updates import SessionStatus
from bcapscope.player.player_messages import PlayProgress, QuestionTopic, SlaveModePacing
from bcapscope.player.player_process import ArmedMessageLogger
from bcapscope.protocol.number_parsing import parse_integer, parse_number
from bcapscope.protocol.slave_mode.modes import pose_type_of_mode
from bcapscope.render.escape import printable
from bcapscope.render.play_text import controller_line, play_summary_lines, trouble_lines
from bcapscope.render.preflight_text import PreflightRenderer
from bcapscope.tui.app import app_of
from bcapscope.tui.controller_access.call_history import error_text
from bcapscope.tui.controller_access.playback import (
    PlaybackRun,
    PlaybackSettings,
    PlayerSlot,
    PreparedTrajectory,
    prepare_trajectory,
)
from bcapscope.tui.ink import INK
from bcapscope.tui.reader_language import full_error_text, label, reader_words
from bcapscope.tui.screens.base_screen import BaseScreen
from bcapscope.tui.tester.dialogs import ChoiceDialog
from bcapscope.tui.tester.form_widgets import Caption, FormButton, TickBox
from bcapscope.tui.tester.pickers import FilePicker
from bcapscope.tui.tester.playback_view import PlaybackView
from bcapscope.tui.widgets.text_widgets import InkedText

_MODE_NUMBERS = (0x001, 0x002, 0x003, 0x101, 0x102, 0x103, 0x201, 0x202, 0x203)
_MODES: tuple[tuple[str, SlaveModePacing | int], ...] = (
    *((pacing.value, pacing) for pacing in SlaveModePacing),
    *((f"0x{number:03X} {pose_type_of_mode(number)}", number) for number in _MODE_NUMBERS),
)
_CHECK_DELAY = 0.4  # seconds from the last change of a field until the screen reads the trajectory file
_MAX_ROUNDS = 1_000_000_000


class SlaveScreen(BaseScreen):
    """Plays a trajectory. The player is a separate process, so drawing the screen delays no set point."""

    NAME = "tester.slave"
    ABOUT = "tester.slave.about"
    HORIZONTAL_BREAKPOINTS = [(0, "-narrow"), (120, "-wide")]  # noqa: RUF012 - Textual declares a list
    BINDINGS: ClassVar[list[BindingType]] = [
        Binding("f9", "start", "tester.start", tooltip="tester.slave.start.tip"),
        Binding("escape", "leave", "tester.slave.leave", key_display="esc"),
        Binding("ctrl+o", "browse", "tester.browse"),
    ]

    def __init__(
        self,
        session: ControllerSession,
        player_slot: PlayerSlot,
        ask_to_arm: Callable[[], Awaitable[bool]],
        recordings: Path,
        path: str = "",
    ) -> None:
        super().__init__()
        self._session = session
        self._player_slot = player_slot
        self._ask_to_arm = ask_to_arm
        self._recordings = recordings
        self._initial_path = path
        self._prepared: PreparedTrajectory | None = None
        self.playback: PlaybackRun | None = None
        self._question_dialog: ChoiceDialog | None = None

    def content(self) -> ComposeResult:
        with Vertical(id="slave"):
            with Vertical(id="slave-settings"):
                with Horizontal(classes="row"):
                    yield Caption("tester.file")
                    yield Input(self._initial_path, id="file")
                    yield FormButton("tester.browse", id="browse")
                with Horizontal(classes="row"):
                    yield Caption("tester.mode")
                    yield Select(
                        _MODES, value=SlaveModePacing.SYNC, allow_blank=False, compact=True, id="mode"
                    )
                    for name, value in (("interval", "8"), ("speed", "1"), ("rounds", "1"), ("index", "1")):
                        yield Caption(f"tester.{name}")
                        yield Input(value, id=name, classes="number")
                with Horizontal(classes="row"):
                    yield Caption("tester.limits")
                    yield Input(placeholder="J1=-170..170 J1..J3.speed=300 J1.acceleration=6000", id="limits")
                    yield TickBox(label("tester.resample"), id="again")
            with Horizontal(classes="row"):
                yield FormButton("tester.start", "success", id="start", disabled=True)
                yield FormButton("tester.stop", "warning", id="stop", disabled=True)
                yield FormButton("shell.halt", "error", id="halt")
                yield InkedText(id="slave-state")
            with ContentSwitcher(initial="before", id="slave-views"):
                with VerticalScroll(id="before"):
                    yield InkedText(id="report")
                yield PlaybackView(id="live")

    def on_mount(self) -> None:
        self._schedule_check()

    # Before: read and check.

    @on(Input.Changed)
    @on(Select.Changed)
    @on(TickBox.Changed)
    def _schedule_check(self) -> None:
        self._prepared = None
        self.query_one("#start", Button).disabled = True
        self._show_state("")
        self._check_later()

    @work(group="prepare", exclusive=True)
    async def _check_later(self) -> None:
        await asyncio.sleep(_CHECK_DELAY)
        with suppress(NoMatches):  # the screen is being closed
            await self._check_trajectory()

    async def _check_trajectory(self) -> None:
        settings = self._read_fields()
        if isinstance(settings, str):
            self._show_report([f"{INK.dim}{settings}{INK.reset}"])
            return
        self._show_report([f"{INK.dim}{label('tester.reading')}{INK.reset}"])
        try:
            robot_type = self._session.status.identity.type_name
            ready = await asyncio.to_thread(prepare_trajectory, settings, robot_type)
        except ValueError as error:  # the file or the arm limits are invalid
            self._show_report([f"{INK.bad}{printable(full_error_text(error))}{INK.reset}"])
            return
        self._prepared = ready
        lines = list(ready.summary_lines(INK, self.query_one("#before").size.width - 2))
        self._show_report(lines)
        # the last line of a long report, with the result of the pre-flight check, may be out of sight
        self._show_state(lines[-1])
        is_playable = ready.preflight.is_playable and not self._player_slot.is_playing
        self.query_one("#start", Button).disabled = not is_playable
        app = app_of(self)
        app.add_recent(str(Path(settings.path).absolute()), app.settings.trajectories)

    def _read_fields(self) -> PlaybackSettings | str:
        """Return the settings in the fields, or a text that says what is wrong with them."""
        path = self._field_text("file").strip()
        if not path:
            return label("tester.file.missing")
        interval = parse_number(self._field_text("interval"), 0.5, 1000)
        speed = parse_number(self._field_text("speed"), 0.01, 10)
        rounds = parse_integer(self._field_text("rounds"), 0, _MAX_ROUNDS)
        index = parse_integer(self._field_text("index"), 0, _MAX_ROUNDS)
        if interval is None or speed is None or rounds is None or index is None:
            return label("tester.play.numbers")
        chosen = self.query_one("#mode", Select).value
        return PlaybackSettings(
            path=str(Path(path).expanduser()),
            mode=chosen if isinstance(chosen, SlaveModePacing | int) else SlaveModePacing.SYNC,
            interval=interval,
            speed=speed,
            rounds=rounds,
            index=index,
            always_resample=self.query_one("#again", TickBox).value,
            limits=tuple(self._field_text("limits").replace(",", " ").split()),
        )

    def _field_text(self, name: str) -> str:
        return self.query_one(f"#{name}", Input).value

    def _show_report(self, lines: list[str]) -> None:
        self.query_one("#slave-views", ContentSwitcher).current = "before"
        self.query_one("#report", InkedText).show_text("\n".join(lines))

    @on(Button.Pressed, "#browse")
    def action_browse(self) -> None:
        def take(path: str | None) -> None:
            if path:
                self.query_one("#file", Input).value = path

        folder = Path(self._field_text("file")).expanduser().parent
        folder = folder if folder.is_dir() else Path.cwd()
        picker = FilePicker(label("tester.browse"), app_of(self).settings.trajectories, folder)
        self.app.push_screen(picker, take)

    # While it plays.

    @on(Button.Pressed, "#start")
    def action_start(self) -> None:
        if self._player_slot.is_playing:
            return
        if self._prepared is None:
            self._show_state(f"{INK.bad}{label('tester.start.none')}")
        elif self._prepared.preflight.is_playable:
            self.run_worker(self._play(self._prepared), group="play")

    async def _play(self, ready: PreparedTrajectory) -> None:
        session, status = self._session, self._session.status
        if status.target is None:
            self._show_state(f"{INK.bad}{label('tester.not_connected')}")
            return
        if not session.arming.allows_armed_calls(session.now()) and not await self._ask_to_arm():
            self._show_state(f"{INK.bad}{label('tester.not_armed')}")
            return
        if not await self._release_controller(status):
            return
        robot = status.robot.label if status.robot else DEFAULT_ROBOT
        name = f"slave-{time.strftime('%Y%m%d-%H%M%S')}-{time.monotonic_ns() % 1000:03}.pcapng"
        target = replace(status.target, name=f"{status.target.name}-player" if status.target.name else "")
        plan = ready.make_plan(target, robot, session.arming.is_required, self._recordings / name)
        self.playback = run = PlaybackRun(plan, ready.trajectory)
        self._set_playing(True)
        session.pause_polling(True)
        try:
            self._recordings.mkdir(parents=True, exist_ok=True)
            await self._player_slot.start_player(plan)
            await self._follow_playback(run)
        except OSError as error:
            self._show_state(f"{INK.bad}{printable(error_text(error))}")
        finally:
            await self._player_slot.end_player()
            session.pause_polling(session.status.slave_mode != 0)
            if self.query("#start"):  # if there is no button, the screen is being closed
                self._set_playing(False)

    async def _release_controller(self, status: SessionStatus) -> bool:
        """Leave slave mode and release the arm, so that the player process can take the arm: for the
        controller, this process is another client.
        """
        session = self._session
        try:
            if status.slave_mode:
                await session.run_in_loop(run_recovery_step(session, RecoveryStep.MODE, "", 0))
            if status.holds_arm and status.robot is not None:
                step = session.selected_robot().execute("GiveArm")
                await session.run_in_loop(session.record_calls(step, Initiator.SCREEN))
        except (BcapError, OSError) as error:
            self._show_state(f"{INK.bad}{printable(error_text(error))}")
            return False
        return True

    async def _follow_playback(self, run: PlaybackRun) -> None:
        live = self.query_one(PlaybackView)
        self.query_one("#slave-views", ContentSwitcher).current = "live"
        live.focus()
        received = b""
        connection = LoggedConnection.of_target(run.plan.target)
        log = ArmedMessageLogger(ArmedCallLogger(self._session.action_log, connection))
        while run.ended is None:
            for message in await self._player_slot.next_messages():
                if isinstance(message, PlayProgress) and message.received != received:
                    received = message.received
                    self._session.reply_monitor.on_received(self._session.now())
                log.on_message(message)
                answer = run.on_message(message)
                if answer is not None:
                    self._player_slot.answer_question(answer)
            if run.question is not None:
                self._ask_user(run)
            words = reader_words()
            state = words.text(run.progress.state.message) if run.progress else words("tester.waiting")
            self._show_state(f"{INK.number}{printable(state)}")
            live.show_run(run)
        self._show_end(run)

    def _ask_user(self, run: PlaybackRun) -> None:
        """Show a question, without waiting for the answer, because the screen must still read messages."""
        question, run.question = run.question, None
        assert question is not None
        if question.topic is QuestionTopic.ARM and self._session.arming.is_armed(self._session.now()):
            self._player_slot.answer_question("yes")
            return
        facts = [line for each in run.troubles[-1:] for line in trouble_lines(each, reader_words())]
        if question.topic is not QuestionTopic.CLEAR:
            facts = [] if run.peer is None else [controller_line(run.peer, reader_words())]
        facts += ["", printable(reader_words().text(question.text))]
        choices = question.choices
        self._question_dialog = ChoiceDialog(facts, choices)
        self.app.push_screen(
            self._question_dialog, lambda choice: self._player_slot.answer_question(choice or choices[0])
        )

    def _show_end(self, run: PlaybackRun) -> None:
        assert run.ended is not None
        if self._question_dialog is not None and self._question_dialog.is_current:
            self._question_dialog.dismiss(None)  # the run has ended, so the open question needs no answer
        if run.preflight is not None and not run.preflight.is_playable:
            width = self.query_one("#before").size.width - 2
            self._show_report(list(PreflightRenderer(INK, width, reader_words()).lines(run.preflight)))
        self._show_state(f"{INK.name}{next(play_summary_lines(run.ended, reader_words()))}")

    def _set_playing(self, playing: bool) -> None:
        self.query_one("#start", Button).disabled = playing or self._prepared is None
        self.query_one("#stop", Button).disabled = not playing
        self.query_one("#slave-settings").disabled = playing

    def _show_state(self, line: str) -> None:
        self.query_one("#slave-state", InkedText).show_text(line)

    @on(Button.Pressed, "#stop")
    def _stop_playback(self) -> None:
        self._player_slot.stop()

    @on(Button.Pressed, "#halt")
    def _press_halt(self) -> None:
        app_of(self).action_halt()

    def action_leave(self) -> None:
        if self._player_slot.is_playing:
            self._player_slot.stop()
        else:
            self.dismiss()
