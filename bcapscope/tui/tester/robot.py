"""The Robot tab: AddRobot; Move, Execute, Change; variables of the robot."""

from __future__ import annotations

from textual import on
from textual.app import ComposeResult
from textual.containers import Horizontal, Vertical, VerticalScroll
from textual.widgets import Button, ContentSwitcher

from bcapscope.protocol.functions import FUNCTIONS, ObjectClass
from bcapscope.tui.tester.choice import Choice
from bcapscope.tui.tester.command import CommandForm
from bcapscope.tui.tester.function import FunctionForm
from bcapscope.tui.tester.opener import Opener
from bcapscope.tui.tester.result import ResultView
from bcapscope.tui.tester.variable import VariablePanel
from bcapscope.tui.words import say

_MOVE, _EXECUTE, _CHANGE = 72, 64, 66


class RobotPanel(VerticalScroll, can_focus=False):
    """What can be done with a robot."""

    def compose(self) -> ComposeResult:
        """Put the parts in the order that b-CAP Tester has."""
        added = ResultView(id="added")
        with Vertical(classes="box", id="add-robot"):
            yield Opener(ObjectClass.CONTROLLER, ObjectClass.ROBOT, "Arm", ["Arm", "Robot0"], added)
            yield added
        with Vertical(classes="box", id="robot-forms"):
            with Horizontal(classes="row"):
                yield Choice(
                    [("execute", "tester.execute"), ("move", "tester.move"), ("change", "tester.change")],
                    id="robot-choice",
                )
                yield Button(say("tester.slave"), compact=True, variant="warning", id="slave-mode")
            with ContentSwitcher(initial="execute", id="robot-switch"):
                yield CommandForm(_EXECUTE, id="execute")
                yield FunctionForm(FUNCTIONS[_MOVE], id="move")
                yield FunctionForm(FUNCTIONS[_CHANGE], id="change")
        yield VariablePanel(ObjectClass.ROBOT, "@CURRENT_POSITION", id="robot-variable")

    @on(Choice.Chosen, "#robot-choice")
    def _switch(self, message: Choice.Chosen) -> None:
        message.stop()
        self.query_one("#robot-switch", ContentSwitcher).current = message.value
