"""The Robot tab: AddRobot, Move, Execute, Change, and variables of the robot."""

from __future__ import annotations

from textual import on
from textual.app import ComposeResult
from textual.containers import Horizontal, Vertical, VerticalScroll
from textual.widgets import ContentSwitcher

from bcapscope.protocol.tables.function_table import FUNCTIONS, ObjectClass
from bcapscope.tui.tester.choice_row import ChoiceRow
from bcapscope.tui.tester.command_form import CommandForm
from bcapscope.tui.tester.form_widgets import FormButton
from bcapscope.tui.tester.function_form import FunctionForm
from bcapscope.tui.tester.open_object_row import OpenObjectRow
from bcapscope.tui.tester.result_view import ResultView
from bcapscope.tui.tester.variable_panel import VariablePanel

_MOVE, _EXECUTE, _CHANGE = 72, 64, 66


class RobotPanel(VerticalScroll, can_focus=False):
    def compose(self) -> ComposeResult:
        added = ResultView(id="added")
        with Vertical(classes="box", id="add-robot"):
            yield OpenObjectRow(ObjectClass.CONTROLLER, ObjectClass.ROBOT, "Arm", ["Arm", "Robot0"], added)
            yield added
        with Vertical(classes="box", id="robot-forms"):
            with Horizontal(classes="row"):
                yield ChoiceRow(
                    [("execute", "tester.execute"), ("move", "tester.move"), ("change", "tester.change")],
                    id="robot-choice",
                )
                yield FormButton("tester.slave", "warning", id="slave-mode")
            with ContentSwitcher(initial="execute", id="robot-switch"):
                yield CommandForm(_EXECUTE, id="execute")
                yield FunctionForm(FUNCTIONS[_MOVE], id="move")
                yield FunctionForm(FUNCTIONS[_CHANGE], id="change")
        yield VariablePanel(ObjectClass.ROBOT, "@CURRENT_POSITION", id="robot-variable")

    @on(ChoiceRow.Chosen, "#robot-choice")
    def _switch(self, message: ChoiceRow.Chosen) -> None:
        self.query_one("#robot-switch", ContentSwitcher).current = message.value
