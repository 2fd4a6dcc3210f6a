"""The tabs below the connection panel: robot, variables, tasks, any function, raw packets."""

from __future__ import annotations

from textual import on
from textual.app import ComposeResult
from textual.containers import Vertical
from textual.widgets import Button, ContentSwitcher

from bcapscope.live.controller.history_record import HistoryRecord
from bcapscope.protocol.codec.variant import Variant
from bcapscope.protocol.tables.function_table import FUNCTIONS, Function, ObjectClass, function_by_name
from bcapscope.tui.app import app_of
from bcapscope.tui.tester.call_forms import FunctionForm, FunctionPanel, RawForm
from bcapscope.tui.tester.form_widgets import ChoiceRow
from bcapscope.tui.tester.object_panels import RobotPanel, TaskPanel, VariablePanel
from bcapscope.tui.tester.pickers import function_picker

TABS = ("robot", "variable", "task", "function", "raw")
"""Names of the tabs, in the order on the screen."""


class FormTabs(Vertical):
    """Shows one tab at a time, and fills the forms in the tabs with earlier calls."""

    def __init__(self, initial_function: Function) -> None:
        super().__init__()
        self._initial_function = initial_function

    def compose(self) -> ComposeResult:
        yield ChoiceRow([(tab, f"tester.tab.{tab}") for tab in TABS], id="tabs")
        with ContentSwitcher(initial=TABS[0], id="panels"):
            yield RobotPanel(id="robot")
            yield VariablePanel(ObjectClass.CONTROLLER, "@MODE", id="variable")
            yield TaskPanel(id="task")
            yield FunctionPanel(self._initial_function, id="function")
            yield RawForm(id="raw")

    def show_tab(self, tab: str) -> None:
        self.query_one("#tabs", ChoiceRow).chosen = tab
        self.query_one("#panels", ContentSwitcher).current = tab

    async def fill_function(self, function: Function, values: tuple[Variant, ...]) -> FunctionForm:
        """Fill the form of a function with its arguments except the handle, and return the form."""
        self.show_tab("function")
        form = await self.query_one(FunctionPanel).show_function(function)
        form.fill_values(values)
        return form

    async def edit_call(self, record: HistoryRecord) -> None:
        """Fill the form of a call's function with the call's arguments. If the function is unknown, fill the
        form for raw packets.
        """
        function = FUNCTIONS.get(record.function_id)
        if function is None or len(function.params) != len(record.arguments):
            self.show_tab("raw")
            self.query_one(RawForm).fill_bytes(record.sent_packets[0].item.raw)
            return
        values = record.arguments[1:] if function.takes_handle else record.arguments
        form = await self.fill_function(function, values)
        form.focus_first()

    @on(ChoiceRow.Chosen, "#tabs")
    def _switch_tab(self, message: ChoiceRow.Chosen) -> None:
        self.query_one("#panels", ContentSwitcher).current = message.value

    @on(Button.Pressed, "#choose-function")
    def _choose_function(self) -> None:
        async def choose(name: str | None) -> None:
            function = function_by_name(name) if name else None
            if function is not None:
                form = await self.query_one(FunctionPanel).show_function(function)
                form.focus_first()

        self.app.push_screen(function_picker(app_of(self).text_styles), choose)
