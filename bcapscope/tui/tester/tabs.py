"""The tabs below the connection: robot, variables, tasks, any function, raw packets."""

from __future__ import annotations

from collections.abc import Sequence

from textual import on
from textual.app import ComposeResult
from textual.containers import Vertical
from textual.widgets import Button, ContentSwitcher

from bcapscope.protocol.functions import FUNCTIONS, Function, ObjectClass, function_by_name
from bcapscope.protocol.variant import Variant
from bcapscope.render.notation import bare_text
from bcapscope.traffic.opened import Opened
from bcapscope.tui.desk.record import Record
from bcapscope.tui.desk.saved import takes_handle
from bcapscope.tui.tester.choice import Choice
from bcapscope.tui.tester.function import FunctionForm, FunctionPanel
from bcapscope.tui.tester.picker import FunctionPicker
from bcapscope.tui.tester.raw import RawForm
from bcapscope.tui.tester.robot import RobotPanel
from bcapscope.tui.tester.task import TaskPanel
from bcapscope.tui.tester.variable import VariablePanel

TABS = ("robot", "variable", "task", "function", "raw")
"""Names of the tabs, in their order."""


class FormTabs(Vertical):
    """Shows one of them at a time; puts calls that were made before into a form."""

    def __init__(self, first: Function, *, id: str | None = None) -> None:
        """Take the function whose form is shown first."""
        super().__init__(id=id)
        self._first = first

    def compose(self) -> ComposeResult:
        """Put the choice above what is chosen."""
        yield Choice([(tab, f"tester.tab.{tab}") for tab in TABS], id="tabs")
        with ContentSwitcher(initial=TABS[0], id="panels"):
            yield RobotPanel(id="robot")
            yield VariablePanel(ObjectClass.CONTROLLER, "@MODE", id="variable")
            yield TaskPanel(id="task")
            yield FunctionPanel(self._first, id="function")
            yield RawForm(id="raw")

    def show(self, open_objects: Sequence[Opened]) -> None:
        """Take note of what is open."""
        for panel in self.query(VariablePanel):
            panel.show(open_objects)
        self.query_one(TaskPanel).show(open_objects)

    def opened(self, owner: ObjectClass, name: str) -> None:
        """Take note that the user has opened a variable."""
        for panel in self.query(VariablePanel):
            panel.opened(owner, name)

    @property
    def chosen(self) -> str:
        """The tab that is shown."""
        return self.query_one("#tabs", Choice).chosen

    def turn_to(self, tab: str) -> None:
        """Show one of the tabs."""
        self.query_one("#tabs", Choice).chosen = tab
        self.query_one("#panels", ContentSwitcher).current = tab

    async def fill(self, function: Function, values: tuple[Variant, ...]) -> FunctionForm:
        """Show the form of a function with arguments, the handle not among them; return it."""
        self.turn_to("function")
        form = await self.query_one(FunctionPanel).choose(function)
        form.put(values, tuple(bare_text(value) or "" for value in values))
        return form

    async def edit(self, record: Record) -> None:
        """Put a call into a form: that of its function, or raw bytes where there is none."""
        function = FUNCTIONS.get(record.function_id)
        if function is None or len(function.params) != len(record.arguments):
            self.turn_to("raw")
            self.query_one(RawForm).put(record.sent[0].item.raw)
            return
        values = record.arguments[1:] if takes_handle(function) else record.arguments
        form = await self.fill(function, values)
        form.focus_first()

    @on(Choice.Chosen, "#tabs")
    def _turn(self, message: Choice.Chosen) -> None:
        message.stop()
        self.query_one("#panels", ContentSwitcher).current = message.value

    @on(Button.Pressed, "#choose-function")
    def _choose_function(self, message: Button.Pressed) -> None:
        message.stop()

        async def choose(name: str | None) -> None:
            function = function_by_name(name) if name else None
            if function is not None:
                form = await self.query_one(FunctionPanel).choose(function)
                form.focus_first()

        self.app.push_screen(FunctionPicker(), choose)
