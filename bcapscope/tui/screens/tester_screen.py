"""The Tester: the functions of the b-CAP Tester window, in a terminal."""

from __future__ import annotations

import asyncio
import threading
from collections.abc import Callable, Iterator
from contextlib import AsyncExitStack, ExitStack
from functools import partial
from pathlib import Path
from typing import ClassVar, NamedTuple

from textual import on, work
from textual.app import ComposeResult
from textual.binding import Binding, BindingType
from textual.containers import Horizontal, VerticalScroll
from textual.widget import Widget
from textual.widgets import Button

from bcapscope.errors import BcapError
from bcapscope.live.controller.controller_session import ControllerSession, NotArmedError
from bcapscope.live.controller.error_recovery import LastSlaveSession
from bcapscope.live.controller.guided_connect import connect, start_robslave
from bcapscope.live.controller.halt_connection import HaltState, HaltUpdate
from bcapscope.live.controller.history_record import HistoryRecord
from bcapscope.live.controller.session_updates import (
    ConnectionLost,
    ConnectStepUpdate,
    SessionProblem,
    SessionStatus,
    SessionUpdate,
    WatchUpdate,
)
from bcapscope.protocol.tables.function_table import FUNCTIONS
from bcapscope.render.escape import printable
from bcapscope.simulator.profile import DEFAULT_PROFILE
from bcapscope.traffic.observation import Observation
from bcapscope.tui.app import app_of
from bcapscope.tui.controller_access.builtin_simulator import BuiltInSimulator, run_builtin_simulator
from bcapscope.tui.controller_access.call_history import copy_text, error_text, reason_text
from bcapscope.tui.controller_access.option_field import read_option_field
from bcapscope.tui.controller_access.playback import PlayerSlot
from bcapscope.tui.controller_access.watched_variables import VariableWatcher
from bcapscope.tui.reader_language import label
from bcapscope.tui.screens.base_screen import BaseScreen
from bcapscope.tui.screens.slave_screen import SlaveScreen
from bcapscope.tui.tester.call_forms import CommandForm
from bcapscope.tui.tester.call_lists import HistoryLines, SavedList, WatchList
from bcapscope.tui.tester.call_steps import CallNotice, CallWanted, function_step, repeating_step, run_armed
from bcapscope.tui.tester.connection_panel import ConnectionPanel, ConnectWanted, arming_facts, status_pieces
from bcapscope.tui.tester.dialogs import ArmDialog, RecoveryDialog
from bcapscope.tui.tester.form_tabs import TABS, FormTabs, OpenObjectRow
from bcapscope.tui.tester.form_widgets import Box, ChoiceRow
from bcapscope.tui.tester.packet_pane import VIEWS, PacketPane
from bcapscope.tui.tester.result_view import ResultView

_EXECUTE_CONTROLLER = 17

_PART_SELECTOR = "#left .box, #function, #raw, #right"
_FOCUS_SELECTOR = "Input, HexView, Lines, Button"
_SKIP_SELECTOR = "#slave-mode, #clear, #history-filter"  # `_focus_first_in` skips these widgets


class TesterOptions(NamedTuple):
    """If `host` is empty, the built-in simulator starts. The session's threads call `tap`."""

    requests_folder: Path
    log_folder: Path
    host: str = ""
    port: int = 5007
    tcp: bool = False
    option: str = ""
    profile: str = DEFAULT_PROFILE
    tap: Callable[[Observation], None] = lambda seen: None


class TesterScreen(BaseScreen):
    NAME = "tester.name.screen"
    ABOUT = "tester.about"
    HORIZONTAL_BREAKPOINTS = [(0, "-narrow"), (150, "-wide")]  # noqa: RUF012 - Textual declares a list
    BINDINGS: ClassVar[list[BindingType]] = [
        Binding("f5", "connect", "tester.connect"),
        Binding("f5", "disconnect", "tester.disconnect"),
        Binding("f6", "part(1)", "tester.part"),
        Binding("shift+f6", "part(-1)", "", show=False),
        Binding("f7", "recover", "tester.recovery"),
        Binding("f8", "arm", "tester.arm"),
        Binding("f9", "slave", "tester.slave"),
        Binding("f10", "digits", "tester.digits", show=False),
        Binding("ctrl+n", "next_tab", "tester.tab.next", show=False),
        Binding("ctrl+y", "next_view", "tester.view.next", show=False, tooltip="tester.view.tip"),
        Binding("escape", "cancel", "tester.cancel", show=False),
        Binding("ctrl+b", "robslave", "tester.robslave"),
    ]

    def __init__(self, tester_options: TesterOptions) -> None:
        super().__init__()
        self._options = tester_options
        self.session = ControllerSession(
            partial(self.call_in_screen, self._show_update), tester_options.log_folder, tester_options.tap
        )
        self.variable_watcher = VariableWatcher(self.session)
        self.player_slot = PlayerSlot()
        self.halt_update = HaltUpdate(HaltState.CLOSED)
        self._simulator_stack = ExitStack()
        self._simulator_lock = threading.Lock()  # only one thread at a time may use `_simulator_stack`
        self._simulator: BuiltInSimulator | None = None
        self._is_connected = False
        self._is_connecting = False
        self._last_slave_session = LastSlaveSession()

    def content(self) -> ComposeResult:
        start = self._options
        with Horizontal(id="desk"):
            with VerticalScroll(id="left", can_focus=False):
                with Box("tester.box.controller", id="controller-box"):
                    yield ConnectionPanel(start.host, start.port, start.tcp, start.option)
                with Box("tester.box.execute", id="execute-box"):
                    yield CommandForm(_EXECUTE_CONTROLLER, id="controller-execute")
                yield FormTabs(FUNCTIONS[_EXECUTE_CONTROLLER])
            yield PacketPane(start.requests_folder, id="right")

    def on_mount(self) -> None:
        app = app_of(self)
        app.add_halt_callback(self.player_slot.halt)
        app.add_halt_callback(self.session.halt)
        app.closers.push_async_callback(self._close)
        self.set_interval(1.0, self._show_status)
        self._show_status()
        self.query_one("#connect", Button).focus()
        if not self._options.host:
            self.query_one(ConnectionPanel).wait_for_address()
            self._start_simulator()

    @work(group="simulator")
    async def _start_simulator(self) -> None:
        """Start or restart the built-in simulator, and fill in the simulator's address."""
        panel = self.query_one(ConnectionPanel)
        try:
            self._simulator = await asyncio.to_thread(self._renew_simulator)
        except OSError as error:
            panel.show_problem(label("tester.simulator.failed", reason=printable(error_text(error))))
            return
        panel.fill_address(self._simulator.host, self._simulator.port)

    def _renew_simulator(self) -> BuiltInSimulator:
        with self._simulator_lock:
            self._simulator_stack.close()
            return self._simulator_stack.enter_context(run_builtin_simulator(self._options.profile))

    def _end_simulator(self) -> None:
        """End the built-in simulator. If the simulator is still starting, wait for it first."""
        with self._simulator_lock:
            self._simulator_stack.close()

    async def _close(self) -> None:
        """Close player, session and simulator; an error in one step does not skip the others."""
        async with AsyncExitStack() as stack:
            stack.push_async_callback(asyncio.to_thread, self._end_simulator)
            stack.push_async_callback(asyncio.to_thread, self.session.close)
            stack.push_async_callback(self.player_slot.end_player)
            if self.is_running:  # if the screen is not running, a bug has ended the screen and its workers
                self.workers.cancel_group(self, "call")

    # Updates from the session.

    def _show_update(self, news: SessionUpdate) -> None:
        if isinstance(news, HistoryRecord):
            self.query_one(PacketPane).add_record(news)
            self._last_slave_session.on_record(news)
        elif isinstance(news, SessionStatus):
            self._apply_status(news)
        elif isinstance(news, ConnectStepUpdate):
            self.query_one(ConnectionPanel).show_step(news)
        elif isinstance(news, HaltUpdate):
            self._apply_halt_update(news)
        elif isinstance(news, WatchUpdate):
            self.query_one(WatchList).show_variables(tuple(self.variable_watcher.variables))
        elif isinstance(news, ConnectionLost):
            lost = label("tester.lost", reason=printable(reason_text(news.reason)))
            self.query_one(ConnectionPanel).show_problem(lost)
            app_of(self).show_message(lost, "error")
        elif isinstance(news, SessionProblem):
            problem = printable(f"{news.path}: {reason_text(news.reason)}")
            app_of(self).show_message(label("tester.log.broken", reason=problem), "warning")

    def _apply_status(self, status: SessionStatus) -> None:
        if status.is_connected != self._is_connected:
            self._is_connected = status.is_connected
            self.query_one(ConnectionPanel).show_status(status)
            self.refresh_bindings()
        for row in self.query(OpenObjectRow):
            row.set_open_objects(status.open_objects)
        self._show_status()

    def _apply_halt_update(self, news: HaltUpdate) -> None:
        before, self.halt_update = self.halt_update, news
        reason = printable(reason_text(news.reason))
        if news.state is HaltState.HALTED:
            text = label("tester.halted", ms=f"{news.round_trip / 1e6:.1f}")
            app_of(self).show_message(text, "warning")
        elif news.state is HaltState.FAILED:
            app_of(self).show_message(label("tester.unhalted", reason=reason), "error")
        elif news.state is HaltState.LOST and before.state is HaltState.READY:
            app_of(self).show_message(label("tester.halt.gone", reason=reason), "error")
        self._show_status()

    def _show_status(self) -> None:
        session = self.session
        now, monitor = session.now(), session.reply_monitor
        line = status_pieces(session.status, session.arming, now, self.halt_update, monitor)
        app_of(self).status = tuple(line)

    # Requests of the widgets.

    @on(ConnectWanted)
    @work(group="connect")
    async def _connect_controller(self, wanted: ConnectWanted) -> None:
        """Connect to a controller. Restart the built-in simulator first if it was chosen but has exited."""
        panel, own = self.query_one(ConnectionPanel), self._simulator
        if own and (wanted.host, wanted.port) == (own.host, own.port) and own.process.poll() is not None:
            panel.wait_for_address()
            # `_start_simulator` is a separate worker, because `action_cancel` must not stop this worker.
            self._start_simulator()
            panel.request_connect()
            return
        target, providers = read_option_field(wanted.option, wanted.host, wanted.port, wanted.tcp)
        opener = self.query_one("#add-robot OpenObjectRow", OpenObjectRow)
        panel.clear_steps()
        self._set_connecting(panel, True)
        try:
            step = connect(self.session, target, providers, opener.object_name, "")
            if await self.session.run_in_loop(step):
                self._focus_next_form(panel)
            if self.session.status.is_connected and self._simulator is None:
                app_of(self).add_recent(wanted.host, app_of(self).settings.hosts)
        finally:
            if panel.children:  # if the screen has no child widgets, it is being closed
                self._set_connecting(panel, False)
                panel.show_status(self.session.status)

    def _focus_next_form(self, panel: ConnectionPanel) -> None:
        """Focus the next form, unless the user has moved the focus out of the connection panel."""
        if self.focused is None or panel in self.focused.ancestors:
            for name in ("#robot-forms", "#panels"):
                if self._focus_first_in(self.query_one(name)):
                    return

    def _set_connecting(self, panel: ConnectionPanel, connecting: bool) -> None:
        self._is_connecting = connecting
        panel.set_connecting(connecting)
        self.refresh_bindings()

    @on(Button.Pressed, "#disconnect")
    @work(group="disconnect")
    async def action_disconnect(self) -> None:
        self.action_cancel()
        await self.session.run_in_loop(self.session.disconnect())
        self.query_one(ConnectionPanel).show_status(self.session.status)

    @on(CallWanted)
    @work(group="call")
    async def _make_calls(self, wanted: CallWanted) -> None:
        display = wanted.result_display
        display.show_pending()
        try:
            display.show_record(await run_armed(self.session, self._ask_to_arm, wanted.step))
        except asyncio.CancelledError:
            display.show_error(label("tester.cancelled"))
            raise
        except NotArmedError:
            display.show_error(label("tester.not_armed"))
        except (BcapError, OSError) as error:
            display.show_error(error_text(error))
        else:
            wanted.done()

    @on(WatchList.ChangeWanted)
    @work(group="watch")
    async def _change_watched(self, message: WatchList.ChangeWanted) -> None:
        self.query_one(PacketPane).show_view("watch")
        await self.session.run_in_loop(message.change(self.variable_watcher))

    @on(SavedList.RequestWanted)
    async def _use_saved_request(self, message: SavedList.RequestWanted) -> None:
        saved = message.saved
        form = await self.query_one(FormTabs).fill_function(saved.function, saved.values)
        if not message.edit:
            step = function_step(saved.function, saved.values)
            self._make_calls(CallWanted(form.query_one(ResultView), step))

    @on(HistoryLines.ActionWanted)
    async def _use_record(self, message: HistoryLines.ActionWanted) -> None:
        record = message.record
        if message.what == "again":
            self._make_calls(CallWanted(CallNotice(app_of(self)), repeating_step(record)))
        elif message.what == "edit":
            await self.query_one(FormTabs).edit_call(record)
        else:
            self._copy_record(record, message.what)

    def _copy_record(self, record: HistoryRecord, what: str) -> None:
        default = read_option_field("", self._options.host or "127.0.0.1", 5007, False)[0]
        text = copy_text(record, what, self.session.status.target or default)
        if text is None:
            app_of(self).show_message(label("tester.copy.none"), "warning")
            return
        self.app.copy_to_clipboard(text)
        app_of(self).show_message(label("tester.copied", text=printable(text.partition("\n")[0])[:200]))

    # Keys.

    def check_action(self, action: str, parameters: tuple[object, ...]) -> bool | None:
        if action in ("connect", "disconnect"):
            return (action == "disconnect") == (self._is_connected or self._is_connecting)
        return super().check_action(action, parameters)

    def action_connect(self) -> None:
        self.query_one(ConnectionPanel).request_connect()

    def action_robslave(self) -> None:
        self._make_calls(CallWanted(CallNotice(app_of(self)), start_robslave))

    @on(Button.Pressed, "#slave-mode")
    def action_slave(self) -> None:
        path, folder = next(iter(app_of(self).settings.trajectories), ""), self._options.log_folder
        self.app.push_screen(SlaveScreen(self.session, self.player_slot, self._ask_to_arm, folder, path))

    def action_recover(self) -> None:
        last = self._last_slave_session
        self.app.push_screen(RecoveryDialog(self.session, self._ask_to_arm, last.move_position, last.mode))

    def action_digits(self) -> None:
        views = self.query(ResultView)
        full = not any(view.shows_all_digits for view in views)
        for view in views:
            view.show_digits(full)

    def action_cancel(self) -> None:
        for group in ("call", "connect"):
            self.workers.cancel_group(self, group)
        self.query_one(ConnectionPanel).cancel_connect()

    def action_arm(self) -> None:
        if self.session.arming.is_armed(self.session.now()):
            self.session.arming.disarm()
            self._show_status()
        else:
            self.run_worker(self._ask_to_arm())

    async def _ask_to_arm(self) -> bool:
        status = self.session.status
        if status.target is None:
            app_of(self).show_message(label("tester.not_connected"), "warning")
            return False
        if await self.app.push_screen_wait(ArmDialog(arming_facts(status))) != "yes":
            return False
        self.session.arming.arm(self.session.now())
        self._show_status()
        return True

    # Navigation.

    def commands(self) -> Iterator[tuple[str, str, str]]:
        for kind, names in (("tab", TABS), ("view", VIEWS)):
            for name in names:
                title = label(f"tester.{kind}", name=label(f"tester.{kind}.{name}"))
                yield title, label(f"tester.{kind}.tip"), f"{kind}('{name}')"

    def action_part(self, by: int) -> None:
        parts = list(self.query(_PART_SELECTOR))
        here = next((at for at, part in enumerate(parts) if part.has_focus_within), -1 if by > 0 else 0)
        for step in range(1, len(parts) + 1):
            if self._focus_first_in(parts[(here + by * step) % len(parts)]):
                return

    def action_next_tab(self) -> None:
        here = self.query_one("#tabs", ChoiceRow).chosen
        self.action_tab(TABS[(TABS.index(here) + 1) % len(TABS)])

    def action_next_view(self) -> None:
        here = self.query_one("#view", ChoiceRow).chosen
        self.action_view(VIEWS[(VIEWS.index(here) + 1) % len(VIEWS)])

    def action_tab(self, name: str) -> None:
        self.query_one(FormTabs).show_tab(name)
        self.call_after_refresh(self._focus_first_in, self.query_one("#panels"))

    def action_view(self, name: str) -> None:
        self.query_one(PacketPane).show_view(name)
        self.call_after_refresh(self._focus_first_in, self.query_one(f"#{name}"))

    def _focus_first_in(self, part: Widget) -> bool:
        """Focus the first usable widget in an area of the screen; return whether there is one."""
        among = (part, *part.query(_FOCUS_SELECTOR).exclude(_SKIP_SELECTOR))
        shown = (each for each in among if all(node.display for node in each.ancestors_with_self))
        found = next((each for each in shown if each.focusable), None)
        if found is not None:
            found.focus()
        return found is not None
