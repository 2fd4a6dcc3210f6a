"""The form for variables: Name, Option, Value; Add, Release, Get, Put, and Watch."""

from __future__ import annotations

from textual import on
from textual.app import ComposeResult
from textual.containers import Horizontal, Vertical
from textual.widgets import Button

from bcapscope.client.handle_table import ObjectHandle
from bcapscope.protocol.codec.variant import VT
from bcapscope.protocol.tables.function_table import FUNCTIONS, ObjectClass
from bcapscope.protocol.tables.variables import VARIABLES, find_variable
from bcapscope.tui.controller_access.parameter_input import expected_input, type_number
from bcapscope.tui.reader_language import label
from bcapscope.tui.tester.form_widgets import Caption, FormButton
from bcapscope.tui.tester.open_object_row import OpenObjectRow
from bcapscope.tui.tester.result_view import ResultView
from bcapscope.tui.tester.typed_value import TypedValue
from bcapscope.tui.tester.wanted_messages import CallWanted, WatchWanted

_GET, _PUT = 101, 102


class VariablePanel(Vertical):
    """A form for variables of a controller, robot or task; it acts on the variable in the name field."""

    def __init__(self, owner: ObjectClass, name: str, *, id: str | None = None) -> None:
        super().__init__(id=id, classes="box")
        self._owner = owner
        self._initial_name = name

    def compose(self) -> ComposeResult:
        result = ResultView()
        known = [
            f"{each.name}1" if each.is_numbered else each.name
            for each in VARIABLES
            if each.owner is self._owner
        ]
        yield OpenObjectRow(self._owner, ObjectClass.VARIABLE, self._initial_name, known, result)
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
        found = self._require_variable()
        if found is not None:
            self.post_message(CallWanted(self.query_one(ResultView), FUNCTIONS[_GET], (), found))

    @on(Button.Pressed, ".put")
    @on(TypedValue.Submitted)
    def _put_value(self) -> None:
        found, checked = self._require_variable(), self.query_one(TypedValue).checked_text
        if found is None:
            return
        if checked.value is None:
            self.query_one(ResultView).show_problem(checked.problem)
            return
        self.post_message(CallWanted(self.query_one(ResultView), FUNCTIONS[_PUT], (checked.value,), found))

    @on(Button.Pressed, ".watch")
    def _request_watch(self) -> None:
        found = self._require_variable()
        if found is not None:
            self.post_message(WatchWanted(found))

    def variable_opened(self, owner: ObjectClass, name: str) -> None:
        """Select the type of a newly opened variable, if that type is known and this form shows it."""
        if owner is not self._owner:
            return
        known = find_variable(self._owner, name)
        types = [vt for each in known.types if (vt := type_number(each)) is not None] if known else []
        if types:
            with self.prevent(TypedValue.Changed):
                self.query_one(TypedValue).select_type(types[0])

    def _require_variable(self) -> ObjectHandle | None:
        found = self.query_one(OpenObjectRow).find_open(self._owner)
        if found is None:
            self.query_one(ResultView).show_error(label("tester.variable.missing"))
        return found
