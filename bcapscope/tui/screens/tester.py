"""The Tester: b-CAP Tester's window in the terminal.

The widgets say what they want; here it is done, at the desk, and what comes back is given to them.
"""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Coroutine
from contextlib import AsyncExitStack, ExitStack
from pathlib import Path
from typing import Any, ClassVar, NamedTuple

from textual import on
from textual.app import ComposeResult
from textual.binding import Binding, BindingType
from textual.containers import Horizontal, Vertical, VerticalScroll
from textual.message import Message
from textual.widgets import Button

from bcapscope.protocol.functions import FUNCTIONS, ObjectClass
from bcapscope.render.escape import printable
from bcapscope.traffic.observation import Observation
from bcapscope.tui.app import scope_of
from bcapscope.tui.desk.builtin import BuiltIn, builtin_simulator
from bcapscope.tui.desk.connecting import connect
from bcapscope.tui.desk.copying import copied
from bcapscope.tui.desk.desk import Desk
from bcapscope.tui.desk.halt import HaltNews, HaltState
from bcapscope.tui.desk.news import Lost, News, Status, StepNews, Trouble, WatchNews
from bcapscope.tui.desk.option import read_option
from bcapscope.tui.desk.playing import Stage
from bcapscope.tui.desk.record import Record, cause
from bcapscope.tui.desk.recovery import LastStay
from bcapscope.tui.desk.watching import Watcher
from bcapscope.tui.screens.parted import Parted
from bcapscope.tui.screens.slave import SlaveScreen
from bcapscope.tui.settings import remembered
from bcapscope.tui.tester.ask import ArmDialog
from bcapscope.tui.tester.clerk import Clerk
from bcapscope.tui.tester.command import CommandForm
from bcapscope.tui.tester.connection import ConnectionPanel
from bcapscope.tui.tester.history import HistoryLines
from bcapscope.tui.tester.messages import (
    CallWanted,
    ConnectWanted,
    DisconnectWanted,
    OpenWanted,
    RawWanted,
    RobSlaveWanted,
    WatchWanted,
)
from bcapscope.tui.tester.notice import Notice
from bcapscope.tui.tester.opener import Opener
from bcapscope.tui.tester.packets import PacketPane
from bcapscope.tui.tester.recovery import RecoveryDialog
from bcapscope.tui.tester.result import ResultView
from bcapscope.tui.tester.savedlist import SavedList
from bcapscope.tui.tester.status import facts_of, status_text
from bcapscope.tui.tester.tabs import FormTabs
from bcapscope.tui.tester.watchlist import WatchList
from bcapscope.tui.words import say

_EXECUTE_CONTROLLER = 17


class Start(NamedTuple):
    """What the Tester begins with.

    Attributes:
        host: of the controller; empty for the built-in simulator.
        port: of the controller.
        tcp: TCP instead of UDP.
        option: as in the field.
        profile: of the built-in simulator.
        requests: folder of saved requests.
        log: folder of the action log.
        tap: sees every packet, in another thread.
    """

    requests: Path
    log: Path
    host: str = ""
    port: int = 5007
    tcp: bool = False
    option: str = ""
    profile: str = "rc7"
    tap: Callable[[Observation], None] = lambda seen: None


class DeskNews(Message):
    """Something happened at the desk."""

    def __init__(self, news: News) -> None:
        super().__init__()
        self.news = news


class Tester(Parted):
    """Connects to a controller, makes calls, shows what went over the wire."""

    NAME = "tester.name.screen"
    ABOUT = "tester.about"
    HORIZONTAL_BREAKPOINTS = [(0, "-narrow"), (150, "-wide")]  # noqa: RUF012 - as Textual has it
    BINDINGS: ClassVar[list[BindingType]] = [
        Binding("f5", "connect", "tester.connect", id="connect", tooltip="tester.connect.tip"),
        Binding("f5", "disconnect", "tester.disconnect", id="disconnect", tooltip="tester.disconnect.tip"),
        Binding("f6", "next_part", "tester.part", id="part", tooltip="tester.part.tip"),
        Binding("shift+f6", "part_before", "", show=False),
        Binding("f7", "recover", "tester.recovery", id="recover", tooltip="tester.recovery.tip"),
        Binding("f8", "arm", "tester.arm", id="arm", tooltip="tester.arm.tip"),
        Binding("f9", "slave", "tester.slave", id="slave", tooltip="tester.slave.tip"),
        Binding("f10", "digits", "tester.digits", id="digits", show=False, tooltip="tester.digits.tip"),
        Binding("ctrl+n", "next_tab", "tester.tab.next", id="tab", show=False, tooltip="tester.tab.next.tip"),
        Binding("ctrl+y", "next_view", "tester.view.next", id="view", show=False, tooltip="tester.view.tip"),
        Binding("escape", "cancel", "tester.cancel", id="cancel", show=False, tooltip="tester.cancel.tip"),
        Binding("ctrl+b", "robslave", "tester.robslave", id="robslave", tooltip="tester.robslave.tip"),
    ]

    def __init__(self, start: Start) -> None:
        """Take what to begin with."""
        super().__init__()
        self._start = start
        self.desk = Desk(self._bring, start.log, start.tap)
        self.watcher = Watcher(self.desk)
        self.clerk = Clerk(self.desk, self._arm)
        self.stage = Stage()
        self._halt_news = HaltNews(HaltState.CLOSED)
        self._stack = ExitStack()
        self._builtin: BuiltIn | None = None
        self._connected = False
        self._is_connecting = False
        self._last_stay = LastStay()

    @property
    def halt_state(self) -> HaltState:
        """What pressing HALT would do, or has done."""
        return self._halt_news.state

    def content(self) -> ComposeResult:
        """Lay it out as b-CAP Tester is laid out."""
        start = self._start
        with Horizontal(id="desk"):
            with VerticalScroll(id="left", can_focus=False):
                with Vertical(classes="box", id="controller-box"):
                    yield ConnectionPanel(start.host, start.port, start.tcp, start.option)
                with Vertical(classes="box", id="execute-box"):
                    yield CommandForm(_EXECUTE_CONTROLLER, id="controller-execute")
                yield FormTabs(FUNCTIONS[_EXECUTE_CONTROLLER])
            yield PacketPane(start.requests, id="right")

    def on_mount(self) -> None:
        """Begin: HALT is at hand, and without a host the built-in simulator starts."""
        for name, title in (
            ("controller-box", "tester.box.controller"),
            ("execute-box", "tester.box.execute"),
            ("add-robot", "tester.box.robot"),
            ("robot-variable", "tester.box.variable"),
            ("variable", "tester.box.variable"),
            ("task-box", "tester.box.task"),
        ):
            self.query_one(f"#{name}").border_title = say(title)
        app = scope_of(self)
        app.at_halt(self.stage.halt)
        app.at_halt(self.desk.halt)
        app.at_close(self._close)
        self.set_interval(1.0, self._show_status)
        self.watch(app, "theme", self._show_status, init=False)
        self._show_status()
        self.query_one("#connect", Button).focus()
        if not self._start.host:
            self.run_worker(self._start_simulator(), group="simulator")

    async def _start_simulator(self) -> None:
        """Start the built-in simulator, anew where it has ended, and put its place into the fields."""
        panel = self.query_one(ConnectionPanel)
        panel.wait()
        await asyncio.to_thread(self._stack.close)
        entered = asyncio.to_thread(self._stack.enter_context, builtin_simulator(self._start.profile))
        try:
            self._builtin = await entered
        except OSError as error:
            panel.trouble(say("tester.simulator.failed", reason=printable(cause(error))))
            return
        panel.put(self._builtin.host, self._builtin.port)

    async def _close(self) -> None:
        """Let go of everything; an error in one step keeps nobody from the others."""
        async with AsyncExitStack() as stack:
            stack.push_async_callback(asyncio.to_thread, self._stack.close)
            stack.push_async_callback(asyncio.to_thread, self.desk.close)
            stack.push_async_callback(self.stage.end)
            if self.is_running:  # else an error of ours has ended the screen, and its workers
                self.workers.cancel_group(self, "call")

    # What the desk tells.

    def _bring(self, news: News) -> None:
        """Bring news from a thread of the desk's to our event loop."""
        self.post_message(DeskNews(news))

    @on(DeskNews)
    def _hear(self, message: DeskNews) -> None:
        news = message.news
        if isinstance(news, Record):
            self.query_one(PacketPane).take(news)
            self._last_stay.take(news)
        elif isinstance(news, Status):
            self._take_status(news)
        elif isinstance(news, StepNews):
            self.query_one(ConnectionPanel).step(news)
        elif isinstance(news, HaltNews):
            self._take_halt(news)
        elif isinstance(news, WatchNews):
            self.query_one(WatchList).show(tuple(self.watcher.watched))
        elif isinstance(news, Lost):
            self.query_one(ConnectionPanel).trouble(say("tester.lost", reason=printable(news.reason)))
            scope_of(self).tell(say("tester.lost", reason=printable(news.reason)), "error")
        elif isinstance(news, Trouble):
            scope_of(self).tell(say("tester.log.broken", reason=printable(news.text)), "warning")

    def _take_status(self, status: Status) -> None:
        if status.is_connected != self._connected:
            self._connected = status.is_connected
            self.query_one(ConnectionPanel).show(status)
            self.refresh_bindings()
        self.query_one(FormTabs).show(status.open)
        self._show_status()

    def _take_halt(self, news: HaltNews) -> None:
        before, self._halt_news = self._halt_news, news
        if news.state in (HaltState.HALTED, HaltState.FAILED):
            key = "tester.halted" if news.state is HaltState.HALTED else "tester.unhalted"
            text = say(key, ms=f"{news.round_trip / 1e6:.1f}", reason=printable(news.reason))
            scope_of(self).tell(text, "warning" if news.state is HaltState.HALTED else "error")
        elif news.state is HaltState.LOST and before.state is HaltState.READY:
            scope_of(self).tell(say("tester.halt.gone", reason=printable(news.reason)), "error")
        self._show_status()

    def _show_status(self) -> None:
        desk = self.desk
        line = status_text(desk.status, desk.arming, desk.now(), self._halt_news, desk.pulse)
        scope_of(self).status = tuple(line)

    # What the widgets want.

    def _work(self, step: Coroutine[Any, Any, object], group: str = "call") -> None:
        self.run_worker(step, group=group)

    @on(ConnectWanted)
    def _connect(self, message: ConnectWanted) -> None:
        gone = self._builtin
        if gone is not None and gone.has_ended and (message.host, message.port) == (gone.host, gone.port):
            self._work(self._reconnecting(), "connect")
        else:
            self._work(self._connecting(message), "connect")

    async def _reconnecting(self) -> None:
        """Connect to the built-in simulator, which has ended."""
        await self._start_simulator()
        wish = self.query_one(ConnectionPanel).wish()
        if isinstance(wish, ConnectWanted):
            await self._connecting(wish)

    async def _connecting(self, wish: ConnectWanted) -> None:
        panel = self.query_one(ConnectionPanel)
        target, providers = read_option(wish.option, wish.host, wish.port, wish.tcp)
        opener = self.query_one("#add-robot Opener", Opener)
        panel.begin()
        self._busy(panel, True)
        try:
            if await self.desk.do(connect(self.desk, target, providers, opener.object_name, "")):
                self._go_on(panel)
            if self.desk.status.is_connected and self._builtin is None:
                settings = scope_of(self).settings
                settings.hosts = remembered(wish.host, settings.hosts)
                scope_of(self).keep()
        finally:
            if panel.children:  # else the screen is being closed
                self._busy(panel, False)
                panel.show(self.desk.status)

    def _go_on(self, panel: ConnectionPanel) -> None:
        """Go to what is done next, unless the user has gone somewhere else meanwhile."""
        if self.focused is None or panel in self.focused.ancestors:
            self._go_to(self.query_one("#robot-forms")) or self._go_to(self.query_one("#panels"))

    def _busy(self, panel: ConnectionPanel, connecting: bool) -> None:
        self._is_connecting = connecting
        panel.busy(connecting)
        self.refresh_bindings()

    @on(DisconnectWanted)
    def _disconnect(self) -> None:
        for group in ("call", "connect"):
            self.workers.cancel_group(self, group)
        self._work(self._disconnecting(), "disconnect")

    async def _disconnecting(self) -> None:
        await self.desk.do(self.desk.disconnect())
        self.query_one(ConnectionPanel).show(self.desk.status)

    @on(CallWanted)
    def _call(self, message: CallWanted) -> None:
        self._work(self.clerk.call(message))

    @on(RawWanted)
    def _raw(self, message: RawWanted) -> None:
        self._work(self.clerk.raw(message.asker, message.raw))

    @on(RobSlaveWanted)
    def _robslave(self, message: RobSlaveWanted) -> None:
        self._work(self.clerk.robslave(message.asker))

    @on(OpenWanted)
    def _open(self, message: OpenWanted) -> None:
        if isinstance(message, Opener.ReleasePressed):
            self._work(self.clerk.release(message))
        else:
            self._work(self._opening(message))

    async def _opening(self, wish: OpenWanted) -> None:
        if await self.clerk.open(wish) and wish.kind is ObjectClass.VARIABLE:
            self.query_one(FormTabs).opened(wish.parent, wish.name)

    @on(WatchWanted)
    def _watch(self, message: WatchWanted) -> None:
        self.query_one(PacketPane).turn_to("watch")
        self._work(self.desk.do(self.watcher.add(message.variable)), "watch")

    @on(WatchList.Removed)
    def _unwatch(self, message: WatchList.Removed) -> None:
        self._work(self.desk.do(self.watcher.remove(message.handle)), "watch")

    @on(WatchList.Reset)
    def _reset_watch(self) -> None:
        self._work(self.desk.do(self.watcher.reset()), "watch")

    @on(SavedList.Wanted)
    async def _saved(self, message: SavedList.Wanted) -> None:
        saved = message.saved
        form = await self.query_one(FormTabs).fill(saved.function, saved.values)
        if not message.edit:
            self._work(self.clerk.saved(form.query_one(ResultView), saved))

    @on(HistoryLines.Wanted)
    async def _with_record(self, message: HistoryLines.Wanted) -> None:
        record = message.record
        if message.what == "again":
            self._work(self.clerk.again(Notice(scope_of(self)), record))
        elif message.what == "edit":
            await self.query_one(FormTabs).edit(record)
        else:
            self._copy(record, message.what)

    def _copy(self, record: Record, what: str) -> None:
        target = self.desk.status.target or read_option("", self._start.host or "127.0.0.1", 5007, False)[0]
        text = copied(record, what, target, self.desk.subject_of(record))
        if text is None:
            scope_of(self).tell(say("tester.copy.none"), "warning")
            return
        self.app.copy_to_clipboard(text)
        scope_of(self).tell(say("tester.copied", text=printable(text.partition("\n")[0])[:200]))

    # What keys do.

    def check_action(self, action: str, parameters: tuple[object, ...]) -> bool | None:
        """Offer to connect or to disconnect, as the buttons do."""
        if action in ("connect", "disconnect"):
            return (action == "disconnect") == (self._connected or self._is_connecting)
        return super().check_action(action, parameters)

    def action_connect(self) -> None:
        """Connect."""
        self.query_one(ConnectionPanel).connect()

    def action_disconnect(self) -> None:
        """Disconnect, or connect no further."""
        self._disconnect()

    def action_robslave(self) -> None:
        """Start RobSlave."""
        self._work(self.clerk.robslave(Notice(scope_of(self))))

    @on(Button.Pressed, "#slave-mode")
    def action_slave(self) -> None:
        """Open Slave Mode."""
        path = next(iter(scope_of(self).settings.trajectories), "")
        self.app.push_screen(SlaveScreen(self.desk, self.stage, self._arm, self._start.log, path))

    def action_recover(self) -> None:
        """Open the way out of an error."""
        stay = self._last_stay
        self.app.push_screen(RecoveryDialog(self.desk, self._arm, stay.position, stay.mode))

    def action_digits(self) -> None:
        """Show all digits of all results, or five behind the point where one shows all."""
        views = self.query(ResultView)
        full = not any(view.full for view in views)
        for view in views:
            view.show_digits(full)

    def action_cancel(self) -> None:
        """Give up the calls under way."""
        for group in ("call", "connect"):
            self.workers.cancel_group(self, group)

    def action_arm(self) -> None:
        """Arm, or disarm."""
        if self.desk.arming.is_armed(self.desk.now()):
            self.desk.arming.disarm()
            self._show_status()
        else:
            self.run_worker(self._arm())

    async def _arm(self) -> bool:
        """Ask the user to arm; return whether it is armed then."""
        status = self.desk.status
        if status.target is None:
            scope_of(self).tell(say("tester.not_connected"), "warning")
            return False
        if not await self.app.push_screen_wait(ArmDialog(facts_of(status))):
            return False
        self.desk.arming.arm(self.desk.now())
        self._show_status()
        return True
