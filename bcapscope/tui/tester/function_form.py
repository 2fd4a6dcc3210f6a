"""A form for any function, built from its signature."""

from __future__ import annotations

from collections.abc import Iterator, Mapping

from textual import on
from textual.app import ComposeResult
from textual.containers import Horizontal, Vertical
from textual.widgets import Button, Label, Select

from bcapscope.protocol.codec.variant import VT, Variant
from bcapscope.protocol.tables.enumerations import INTERPOLATIONS, TASK_START_MODES, TASK_STOP_MODES
from bcapscope.protocol.tables.function_table import Function, Param
from bcapscope.tui.controller_access.parameter_input import PARAMETER_TYPES
from bcapscope.tui.reader_language import table_text
from bcapscope.tui.tester.form_widgets import Caption, FormButton
from bcapscope.tui.tester.result_view import ResultView
from bcapscope.tui.tester.typed_value import TypedValue
from bcapscope.tui.tester.wanted_messages import CallWanted

_PARAMETER_TYPES = {"VT_I4": VT.I4, "VT_R4": VT.R4, "VT_BSTR": VT.BSTR}
_NAMED_VALUES: dict[tuple[str, str], Mapping[int, str]] = {
    ("Robot_Move", "lComp"): INTERPOLATIONS,
    ("Task_Start", "lMode"): TASK_START_MODES,
    ("Task_Stop", "lMode"): TASK_STOP_MODES,
}


class FunctionForm(Vertical):
    """A form with one row per argument except the handle; it reports invalid text at once."""

    def __init__(self, function: Function, *, id: str | None = None) -> None:
        super().__init__(id=id)
        self.function = function
        self.params = function.params[1:] if function.takes_handle else function.params

    def compose(self) -> ComposeResult:
        for index, param in enumerate(self.params):
            last = index == len(self.params) - 1
            with Horizontal(classes="row"):
                yield Label(param.name, markup=False, classes="param")
                yield from self._make_field(index, param)
                if last:
                    yield self._execute_button()
        if not self.params:
            with Horizontal(classes="row"):
                yield self._execute_button()
        yield ResultView()

    def _execute_button(self) -> Button:
        return FormButton("tester.execute", "primary", classes="execute")

    def _make_field(self, index: int, param: Param) -> Iterator[Select[int] | TypedValue]:
        known = _NAMED_VALUES.get((self.function.name, param.name))
        if known is not None:
            yield select_named_value(known, f"field{index}")
        elif param.type == "VARIANT":
            yield TypedValue(VT.BSTR, PARAMETER_TYPES, id=f"field{index}")
        else:
            vt = _PARAMETER_TYPES[param.type]
            yield TypedValue(vt, (vt,), id=f"field{index}")

    def focus_first(self) -> None:
        found = [each for each in self.query("Input, Select, Button") if each.focusable]
        if found:
            found[0].focus()

    def fill_values(self, values: tuple[Variant, ...], texts: tuple[str, ...]) -> None:
        for index, (value, text) in enumerate(zip(values, texts, strict=True)):
            field = self.query_one(f"#field{index}")
            if isinstance(field, TypedValue):
                field.fill_value(value.vt, text)
            elif isinstance(field, Select) and isinstance(value.value, int):
                field.value = value.value

    def argument_values(self) -> tuple[Variant, ...] | str:
        """Return the arguments without the handle, or what is wrong with the first invalid argument."""
        found: list[Variant] = []
        for index, param in enumerate(self.params):
            field = self.query_one(f"#field{index}")
            if isinstance(field, TypedValue):
                value, problem = field.checked_text
                if value is None:
                    return f"{param.name}: {problem}"
                found.append(value)
            elif isinstance(field, Select) and isinstance(field.value, int):
                found.append(Variant(VT.I4, field.value))
        return tuple(found)

    @on(TypedValue.Changed)
    def _show_check(self, message: TypedValue.Changed) -> None:
        self.query_one(ResultView).show_check(message.problem, message.value.hint)

    @on(Button.Pressed, ".execute")
    @on(TypedValue.Submitted)
    def _execute(self) -> None:
        values = self.argument_values()
        result = self.query_one(ResultView)
        if isinstance(values, str):
            result.show_problem(values)
        else:
            self.post_message(CallWanted(result, self.function, values))


def select_named_value(texts: Mapping[int, str], name: str) -> Select[int]:
    """Return a widget that offers several numbers, each with its meaning."""
    options = [(f"{value} {table_text(text)}", value) for value, text in texts.items()]
    return Select(options, allow_blank=False, compact=True, id=name, classes="named")


class FunctionPanel(Vertical):
    """Lets the user choose one of the 137 functions, and shows the function's form."""

    def __init__(self, initial_function: Function, *, id: str | None = None) -> None:
        super().__init__(id=id)
        self._initial_function = initial_function

    def compose(self) -> ComposeResult:
        with Horizontal(classes="row"):
            yield Caption("tester.function")
            yield Button(self._button_label(self._initial_function), compact=True, id="choose-function")
        yield FunctionForm(self._initial_function)

    async def show_function(self, function: Function) -> FunctionForm:
        button = self.query_one("#choose-function", Button)
        button.label = self._button_label(function)
        button.refresh(layout=True)  # its width follows its label
        await self.query_one(FunctionForm).remove()
        form = FunctionForm(function)
        await self.mount(form)
        return form

    def _button_label(self, function: Function) -> str:
        return f"{function.id} {function.name} ▾"
