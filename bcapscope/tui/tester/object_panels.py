"""The tabs Robot, Variable and Task. Their forms open and use objects."""

from __future__ import annotations

from collections.abc import Sequence

from textual import on
from textual.app import ComposeResult
from textual.containers import Horizontal, Vertical, VerticalScroll
from textual.suggester import SuggestFromList
from textual.widgets import Button, ContentSwitcher, Input, Select

from bcapscope.client.handle_table import ObjectHandle
from bcapscope.protocol.closing_calls import RELEASES
from bcapscope.protocol.codec.variant import EMPTY, VT, Variant
from bcapscope.protocol.tables.enumerations import TASK_START_MODES, TASK_STOP_MODES
from bcapscope.protocol.tables.function_table import FUNCTIONS, ObjectClass
from bcapscope.protocol.tables.variables import VARIABLES, find_variable
from bcapscope.render.escape import printable
from bcapscope.tui.reader_language import label
from bcapscope.tui.tester.call_forms import CommandForm, FunctionForm, select_named_value
from bcapscope.tui.tester.call_runner import (
    CallWanted,
    OpenWanted,
    ResultDisplay,
    RobSlaveWanted,
    WatchWanted,
)
from bcapscope.tui.tester.form_widgets import Box, Caption, ChoiceRow, FormButton
from bcapscope.tui.tester.result_view import ResultView
from bcapscope.tui.tester.typed_value import TypedValue, expected_input, type_numbers


class OpenObjectRow(Horizontal):
    def __init__(
        self,
        parent: ObjectClass,
        kind: ObjectClass,
        name: str,
        known: Sequence[str],
        result_display: ResultDisplay,
        *,
        id: str | None = None,
    ) -> None:
        """`kind` is the class of the objects that the user opens. `parent` is the class of the objects that
        own them.
        """
        super().__init__(id=id, classes="row")
        self._parent_kind = parent
        self._kind = kind
        self._initial_name = name
        self._known = list(known)
        self._result_display = result_display
        self._open_objects: tuple[ObjectHandle, ...] = ()

    def compose(self) -> ComposeResult:
        yield Caption("tester.name")
        yield Input(
            self._initial_name, suggester=SuggestFromList(self._known, case_sensitive=False), classes="name"
        )
        yield Caption("tester.option")
        yield Input(classes="option")
        yield FormButton("tester.add", "primary", classes="add")
        yield FormButton("tester.release", classes="release")

    @property
    def object_name(self) -> str:
        return self.query_one(".name", Input).value.strip()

    def set_open_objects(self, open_objects: Sequence[ObjectHandle]) -> None:
        self._open_objects = tuple(each for each in open_objects if each.kind is self._kind)

    def find_open(self, owner: ObjectClass | None = None) -> ObjectHandle | None:
        """Return the most recently opened object with the name in the field. If `owner` is given, the parent
        of the object must have the class `owner`.
        """
        name = self.object_name.casefold()
        for each in reversed(self._open_objects):
            is_owned = owner is None or (each.parent is not None and each.parent.kind is owner)
            if is_owned and each.label.casefold() == name:
                return each
        return None

    @on(Button.Pressed, ".add")
    @on(Input.Submitted)
    def _add(self) -> None:
        if not self.object_name:
            self._result_display.show_error(label("tester.name.missing"))
            return
        option = self.query_one(".option", Input).value
        self.post_message(
            OpenWanted(self._result_display, self._parent_kind, self._kind, self.object_name, option)
        )

    @on(Button.Pressed, ".release")
    def _release(self) -> None:
        found = self.find_open()
        if found is None:
            text = label("tester.release.missing", name=printable(self.object_name))
            self._result_display.show_error(text)
        else:
            self.post_message(CallWanted(self._result_display, RELEASES[self._kind], (), found))


_ROBOT_EXECUTE, _ROBOT_CHANGE, _ROBOT_MOVE = 64, 66, 72
_TASK_EXECUTE, _TASK_START, _TASK_STOP = 87, 88, 89
_VARIABLE_GET, _VARIABLE_PUT = 101, 102
_NO_OPTION = Variant(VT.BSTR, "")


class VariablePanel(Box):
    """A form for variables of a controller, robot or task. The buttons act on the variable in the name
    field.
    """

    def __init__(self, owner: ObjectClass, name: str, *, id: str) -> None:
        super().__init__("tester.box.variable", id=id)
        self._owner = owner
        self._initial_name = name

    def compose(self) -> ComposeResult:
        result = ResultView()
        known = (each for each in VARIABLES if each.owner is self._owner)
        names = [f"{each.name}1" if each.is_numbered else each.name for each in known]
        yield OpenObjectRow(self._owner, ObjectClass.VARIABLE, self._initial_name, names, result)
        with Horizontal(classes="row"):
            yield Caption("tester.value")
            yield TypedValue(VT.I4)
            yield FormButton("tester.get", "primary", classes="get")
            yield FormButton("tester.put", classes="put")
            yield FormButton("tester.watch", classes="watch")
        yield result

    @on(TypedValue.Changed)
    def _show_check(self, message: TypedValue.Changed) -> None:
        self.query_one(ResultView).show_check(message.problem, expected_input(message.value.vt))

    @on(Button.Pressed, ".get")
    def _get_value(self) -> None:
        self._post_call(_VARIABLE_GET)

    @on(Button.Pressed, ".put")
    @on(TypedValue.Submitted)
    def _put_value(self) -> None:
        checked = self.query_one(TypedValue).checked_text
        if checked.value is None:
            self.query_one(ResultView).show_problem(checked.problem)
        else:
            self._post_call(_VARIABLE_PUT, checked.value)

    def _post_call(self, function_id: int, *values: Variant) -> None:
        found = self._require_variable()
        if found is not None:
            self.post_message(CallWanted(self.query_one(ResultView), FUNCTIONS[function_id], values, found))

    @on(Button.Pressed, ".watch")
    def _request_watch(self) -> None:
        found = self._require_variable()
        if found is not None:
            self.post_message(WatchWanted(found))

    def variable_opened(self, owner: ObjectClass, name: str) -> None:
        """Select the type of a newly opened variable in this form, if the type is known and the form shows
        the variable.
        """
        if owner is not self._owner:
            return
        known = find_variable(self._owner, name)
        types = type_numbers(known.types) if known else ()
        if types:
            with self.prevent(TypedValue.Changed):
                self.query_one(TypedValue).select_type(types[0])

    def _require_variable(self) -> ObjectHandle | None:
        found = self.query_one(OpenObjectRow).find_open(self._owner)
        if found is None:
            self.query_one(ResultView).show_error(label("tester.variable.missing"))
        return found


class RobotPanel(VerticalScroll, can_focus=False):
    """The tab for robots: open a robot, execute its commands, move it, and access its variables."""

    def compose(self) -> ComposeResult:
        added = ResultView(id="added")
        with Box("tester.box.robot", id="add-robot"):
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
                yield CommandForm(_ROBOT_EXECUTE, id="execute")
                yield FunctionForm(FUNCTIONS[_ROBOT_MOVE], id="move")
                yield FunctionForm(FUNCTIONS[_ROBOT_CHANGE], id="change")
        yield VariablePanel(ObjectClass.ROBOT, "@CURRENT_POSITION", id="robot-variable")

    @on(ChoiceRow.Chosen, "#robot-choice")
    def _switch(self, message: ChoiceRow.Chosen) -> None:
        self.query_one("#robot-switch", ContentSwitcher).current = message.value


class TaskPanel(VerticalScroll, can_focus=False):
    """The tab for tasks: open, start and stop a task, read its state; a button starts RobSlave."""

    def compose(self) -> ComposeResult:
        result = ResultView(id="task-result")
        with Box("tester.box.task", id="task-box"):
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
            yield CommandForm(_TASK_EXECUTE)

    @on(Button.Pressed, "#start")
    def _start_task(self) -> None:
        self._post_call(_TASK_START, Variant(VT.I4, self._selected_mode("start-mode")), _NO_OPTION)

    @on(Button.Pressed, "#stop")
    def _stop_task(self) -> None:
        self._post_call(_TASK_STOP, Variant(VT.I4, self._selected_mode("stop-mode")), _NO_OPTION)

    @on(Button.Pressed, "#state")
    def _read_task_state(self) -> None:
        self._post_call(_TASK_EXECUTE, Variant(VT.BSTR, "GetStatus"), EMPTY)

    @on(Button.Pressed, "#robslave")
    def _start_robslave(self) -> None:
        self.post_message(RobSlaveWanted(self.query_one("#task-result", ResultView)))

    def _selected_mode(self, name: str) -> int:
        value = self.query_one(f"#{name}", Select).value
        return value if isinstance(value, int) else 0

    def _post_call(self, function_id: int, *values: Variant) -> None:
        result, found = self.query_one("#task-result", ResultView), self.query_one(OpenObjectRow).find_open()
        if found is None:
            result.show_error(label("tester.task.missing"))
        else:
            self.post_message(CallWanted(result, FUNCTIONS[function_id], values, found))
