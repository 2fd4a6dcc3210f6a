"""The tabs below the connection panel: robot, variables, tasks, any function, raw packets."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial

from textual import on
from textual.app import ComposeResult
from textual.containers import Horizontal, Vertical, VerticalScroll
from textual.suggester import SuggestFromList
from textual.widgets import Button, ContentSwitcher, Input, Select

from bcapscope.client.handle_table import ObjectHandle
from bcapscope.live.controller.guided_connect import start_robslave
from bcapscope.live.controller.history_record import HistoryRecord
from bcapscope.protocol.closing_calls import RELEASES
from bcapscope.protocol.codec.variant import EMPTY, VT, Variant
from bcapscope.protocol.tables.enumerations import TASK_START_MODES, TASK_STOP_MODES
from bcapscope.protocol.tables.function_table import FUNCTIONS, Function, ObjectClass, function_by_name
from bcapscope.protocol.tables.variables import VARIABLES, find_variable
from bcapscope.render.escape import printable
from bcapscope.tui.app import app_of
from bcapscope.tui.reader_language import label
from bcapscope.tui.tester.call_forms import (
    CommandForm,
    FunctionForm,
    FunctionPanel,
    RawForm,
    select_named_value,
)
from bcapscope.tui.tester.call_lists import WatchList
from bcapscope.tui.tester.call_steps import CallWanted, function_step, opening_step
from bcapscope.tui.tester.form_widgets import Box, Caption, ChoiceRow, FormButton
from bcapscope.tui.tester.pickers import function_picker
from bcapscope.tui.tester.result_view import ResultView
from bcapscope.tui.tester.typed_value import TypedValue, expected_input, type_numbers


class OpenObjectRow(Horizontal):
    def __init__(
        self,
        parent: ObjectClass,
        kind: ObjectClass,
        name: str,
        known: Sequence[str],
        result: ResultView,
        *,
        on_opened: Callable[[str], object] = lambda name: None,
    ) -> None:
        """After the request to open an object, `on_opened` gets the name of this object."""
        super().__init__(classes="row")
        self._parent_kind = parent
        self._kind = kind
        self._initial_name = name
        self._known = known
        self._result = result
        self._on_opened = on_opened
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

    def find_open(self, missing: str) -> ObjectHandle | None:
        """Return the newest object with the name in the field; if none is open, show the text `missing`."""
        name = self.object_name.casefold()
        for each in reversed(self._open_objects):
            is_owned = each.parent is not None and each.parent.kind is self._parent_kind
            if is_owned and each.label.casefold() == name:
                return each
        self._result.show_error(missing)
        return None

    @on(Button.Pressed, ".add")
    @on(Input.Submitted)
    def _add(self) -> None:
        name = self.object_name
        if not name:
            self._result.show_error(label("tester.name.missing"))
            return
        step = opening_step(self._parent_kind, self._kind, name, self.query_one(".option", Input).value)
        self.post_message(CallWanted(self._result, step, partial(self._on_opened, name)))

    @on(Button.Pressed, ".release")
    def _release(self) -> None:
        found = self.find_open(label("tester.release.missing", name=printable(self.object_name)))
        if found is not None:
            self.post_message(CallWanted(self._result, function_step(RELEASES[self._kind], (), found)))


_ROBOT_EXECUTE, _ROBOT_CHANGE, _ROBOT_MOVE = 64, 66, 72
_TASK_EXECUTE, _TASK_START, _TASK_STOP = 87, 88, 89
_VARIABLE_GET, _VARIABLE_PUT = 101, 102
_NO_OPTION = Variant(VT.BSTR, "")


class VariablePanel(Box):
    """A form for variables of a controller, robot or task. The buttons act on the variable in the field."""

    def __init__(self, owner: ObjectClass, name: str, *, id: str) -> None:
        super().__init__("tester.box.variable", id=id)
        self._owner = owner
        self._initial_name = name

    def compose(self) -> ComposeResult:
        result = ResultView()
        known = (each for each in VARIABLES if each.owner is self._owner)
        names = [f"{each.name}1" if each.is_numbered else each.name for each in known]
        yield OpenObjectRow(
            self._owner, ObjectClass.VARIABLE, self._initial_name, names, result, on_opened=self._select_type
        )
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
        value = self.query_one(TypedValue).checked_value
        if isinstance(value, str):
            self.query_one(ResultView).show_problem(value)
        else:
            self._post_call(_VARIABLE_PUT, value)

    def _post_call(self, function_id: int, *values: Variant) -> None:
        found = self.query_one(OpenObjectRow).find_open(label("tester.variable.missing"))
        if found is not None:
            step = function_step(FUNCTIONS[function_id], values, found)
            self.post_message(CallWanted(self.query_one(ResultView), step))

    @on(Button.Pressed, ".watch")
    def _request_watch(self) -> None:
        found = self.query_one(OpenObjectRow).find_open(label("tester.variable.missing"))
        if found is not None:
            self.post_message(WatchList.ChangeWanted(lambda watcher: watcher.add(found)))

    def _select_type(self, name: str) -> None:
        """Select the type of a newly opened variable, if the type is known."""
        known = find_variable(self._owner, name)
        types = type_numbers(known.types) if known else ()
        if types:
            with self.prevent(TypedValue.Changed):
                self.query_one(TypedValue).select_type(types[0])


class RobotPanel(VerticalScroll, can_focus=False):
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
        self.post_message(CallWanted(self.query_one("#task-result", ResultView), start_robslave))

    def _selected_mode(self, name: str) -> int:
        value = self.query_one(f"#{name}", Select).value
        return value if isinstance(value, int) else 0

    def _post_call(self, function_id: int, *values: Variant) -> None:
        found = self.query_one(OpenObjectRow).find_open(label("tester.task.missing"))
        if found is not None:
            step = function_step(FUNCTIONS[function_id], values, found)
            self.post_message(CallWanted(self.query_one("#task-result", ResultView), step))


TABS = ("robot", "variable", "task", "function", "raw")


class FormTabs(Vertical):
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
        """Show and return the form of a function, filled with `values`: all arguments except the handle."""
        self.show_tab("function")
        form = await self.query_one(FunctionPanel).show_function(function)
        form.fill_values(values)
        return form

    async def edit_call(self, record: HistoryRecord) -> None:
        """Fill the form of the call's function. If no form fits the call, fill the form for raw packets."""
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
