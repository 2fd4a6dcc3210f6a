"""The Task tab: open, start and stop a task, read its state; one button for RobSlave."""

from __future__ import annotations

from textual import on
from textual.app import ComposeResult
from textual.containers import Horizontal, Vertical, VerticalScroll
from textual.widgets import Button, Select

from bcapscope.protocol.codec.variant import EMPTY, VT, Variant
from bcapscope.protocol.tables.enumerations import TASK_START_MODES, TASK_STOP_MODES
from bcapscope.protocol.tables.function_table import FUNCTIONS, ObjectClass
from bcapscope.tui.reader_language import label
from bcapscope.tui.tester.command_form import CommandForm
from bcapscope.tui.tester.form_widgets import Caption, FormButton
from bcapscope.tui.tester.function_form import select_named_value
from bcapscope.tui.tester.open_object_row import OpenObjectRow
from bcapscope.tui.tester.result_view import ResultView
from bcapscope.tui.tester.wanted_messages import CallWanted, RobSlaveWanted

_EXECUTE, _START, _STOP = 87, 88, 89
_NO_OPTION = Variant(VT.BSTR, "")


class TaskPanel(VerticalScroll, can_focus=False):
    """Forms for the task whose name is in the name field."""

    def compose(self) -> ComposeResult:
        result = ResultView(id="task-result")
        with Vertical(classes="box", id="task-box"):
            yield OpenObjectRow(ObjectClass.CONTROLLER, ObjectClass.TASK, "RobSlave", ["RobSlave"], result)
            with Horizontal(classes="row"):
                yield Caption("tester.mode")
                yield select_named_value(TASK_START_MODES, "start-mode")
                yield FormButton("tester.start", "primary", id="start")
                yield FormButton("tester.robslave", id="robslave")
            with Horizontal(classes="row"):
                yield Caption("tester.mode")
                yield select_named_value(TASK_STOP_MODES, "stop-mode")
                yield FormButton("tester.stop", id="stop")
                yield FormButton("tester.state", id="state")
            yield result
        with Vertical(classes="box", id="task-execute"):
            yield CommandForm(_EXECUTE)

    @property
    def _result_view(self) -> ResultView:
        return self.query_one("#task-result", ResultView)

    @on(Button.Pressed, "#start")
    def _start_task(self) -> None:
        self._call_task(_START, (Variant(VT.I4, self._selected_mode("start-mode")), _NO_OPTION))

    @on(Button.Pressed, "#stop")
    def _stop_task(self) -> None:
        self._call_task(_STOP, (Variant(VT.I4, self._selected_mode("stop-mode")), _NO_OPTION))

    @on(Button.Pressed, "#state")
    def _read_task_state(self) -> None:
        self._call_task(_EXECUTE, (Variant(VT.BSTR, "GetStatus"), EMPTY))

    @on(Button.Pressed, "#robslave")
    def _start_robslave(self) -> None:
        self.post_message(RobSlaveWanted(self._result_view))

    def _selected_mode(self, name: str) -> int:
        value = self.query_one(f"#{name}", Select).value
        return value if isinstance(value, int) else 0

    def _call_task(self, function_id: int, values: tuple[Variant, ...]) -> None:
        found = self.query_one(OpenObjectRow).find_open()
        if found is None:
            self._result_view.show_error(label("tester.task.missing"))
        else:
            self.post_message(CallWanted(self._result_view, FUNCTIONS[function_id], values, found))
