"""Forms for calls: commands, any function, and raw packets."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import ClassVar

from textual import on
from textual.app import ComposeResult
from textual.binding import Binding, BindingType
from textual.containers import Horizontal, Vertical
from textual.events import Paste
from textual.suggester import SuggestFromList
from textual.widgets import Button, Input, Label, Select

from bcapscope.protocol.codec.frame import Frame, Problem, parse_datagram
from bcapscope.protocol.codec.variant import VT, Variant
from bcapscope.protocol.tables.command_catalogue import commands_of, find_command
from bcapscope.protocol.tables.enumerations import INTERPOLATIONS, TASK_START_MODES, TASK_STOP_MODES
from bcapscope.protocol.tables.function_table import FUNCTIONS, Function, Param, function_name
from bcapscope.render.value_text import untyped_text
from bcapscope.tui.app import app_of
from bcapscope.tui.reader_language import label, reader_words, table_text
from bcapscope.tui.tester.call_steps import CallWanted, function_step
from bcapscope.tui.tester.form_widgets import Caption, FormButton, TickBox
from bcapscope.tui.tester.pickers import command_picker
from bcapscope.tui.tester.result_view import ResultView
from bcapscope.tui.tester.typed_value import TypedValue, command_hint, type_numbers


class CommandForm(Vertical):
    """A form for calls of one ..._Execute function."""

    BINDINGS: ClassVar[list[BindingType]] = [Binding("f4", "pick", "tester.pick")]

    def __init__(self, function_id: int, *, id: str | None = None) -> None:
        super().__init__(id=id)
        self.function = FUNCTIONS[function_id]
        self._sent_parameters: dict[str, tuple[int, str]] = {}
        self._last_parameter: tuple[int, str] | None = None

    def compose(self) -> ComposeResult:
        names = [each.name for each in commands_of(self.function.id)]
        with Horizontal(classes="row"):
            yield Caption("tester.command")
            yield Input(suggester=SuggestFromList(names, case_sensitive=False), classes="command")
        with Horizontal(classes="row"):
            yield Caption("tester.parameter")
            yield TypedValue()
            yield FormButton("tester.execute", "primary", classes="execute")
        yield ResultView()

    @on(Input.Changed, ".command")
    def _show_suggestion(self, message: Input.Changed) -> None:
        """Show what the typed command does, and fill in the parameter that was last sent with this command.
        If the user never sent the typed command, and the input field still holds the parameter that was sent
        last with another command, empty the input field.
        """
        found = find_command(self.function.id, message.value.strip())
        if found is None:
            self.query_one(ResultView).show_check("", "")
            return
        typed, types = self.query_one(TypedValue), type_numbers(found.parameter_types)
        before = self._sent_parameters.get(message.value.strip().casefold())
        if before is not None:
            typed.fill_value(*before)
        elif typed.typed == self._last_parameter:
            typed.fill_value(types[0] if types else typed.vt, "")
        elif types:
            typed.select_type(types[0])
        self.query_one(ResultView).show_check("", command_hint(found))

    @on(TypedValue.Changed)
    def _show_check(self, message: TypedValue.Changed) -> None:
        found = find_command(self.function.id, self.query_one(".command", Input).value.strip())
        hint = command_hint(found) if found else message.value.hint
        self.query_one(ResultView).show_check(message.problem, hint)

    @on(Input.Submitted, ".command")
    def _submit_command(self, message: Input.Submitted) -> None:
        """Complete an incomplete name, ask for a missing parameter, or execute the command."""
        typed = message.value.strip().casefold()
        names = [each.name for each in commands_of(self.function.id)]
        names = [name for name in names if name.casefold().startswith(typed)]
        if typed and names and typed not in map(str.casefold, names):
            message.input.value = names[0]
            message.input.cursor_position = len(names[0])
        elif typed and self.query_one(TypedValue).is_missing:
            self.query_one(TypedValue).query_one(Input).focus()
        else:
            self._execute()

    @on(Button.Pressed)
    @on(TypedValue.Submitted)
    def _execute(self) -> None:
        result, name = self.query_one(ResultView), self.query_one(".command", Input).value.strip()
        parameter = self.query_one(TypedValue)
        value = parameter.checked_value
        if not name:
            result.show_problem(label("tester.command.missing"))
        elif isinstance(value, str):
            result.show_problem(value)
        else:
            # an unknown command may be a typing error, so its parameter is not kept
            if find_command(self.function.id, name) is not None:
                self._last_parameter = self._sent_parameters[name.casefold()] = parameter.typed
            step = function_step(self.function, (Variant(VT.BSTR, name), value))
            self.post_message(CallWanted(result, step))

    def action_pick(self) -> None:
        def take(name: str | None) -> None:
            if name:
                self.query_one(".command", Input).value = name
                self.query_one(TypedValue).query_one(Input).focus()

        app_of(self).push_screen(command_picker(self.function.id, app_of(self).text_styles), take)


_PARAMETER_TYPES = {"VT_I4": VT.I4, "VT_R4": VT.R4, "VT_BSTR": VT.BSTR}
_NAMED_VALUES: dict[tuple[str, str], Mapping[int, str]] = {
    ("Robot_Move", "lComp"): INTERPOLATIONS,
    ("Task_Start", "lMode"): TASK_START_MODES,
    ("Task_Stop", "lMode"): TASK_STOP_MODES,
}


class FunctionForm(Vertical):
    """A form with one row per argument except the handle."""

    def __init__(self, function: Function, *, id: str | None = None) -> None:
        super().__init__(id=id)
        self.function = function
        self.params = function.params[1:] if function.takes_handle else function.params

    def compose(self) -> ComposeResult:
        execute = FormButton("tester.execute", "primary", classes="execute")
        for index, param in enumerate(self.params):
            with Horizontal(classes="row"):
                yield Label(param.name, markup=False, classes="param")
                yield self._make_field(param, f"field{index}")
                if param is self.params[-1]:
                    yield execute
        if not self.params:
            yield Horizontal(execute, classes="row")
        yield ResultView()

    def _make_field(self, param: Param, id: str) -> Select[int] | TypedValue:
        known = _NAMED_VALUES.get((self.function.name, param.name))
        if known is not None:
            return select_named_value(known, id)
        vt = _PARAMETER_TYPES.get(param.type)  # None if the parameter may have any type
        return TypedValue(VT.BSTR, id=id) if vt is None else TypedValue(vt, (vt,), id=id)

    def focus_first(self) -> None:
        found = [each for each in self.query("Input, Select, Button") if each.focusable]
        if found:
            found[0].focus()

    def fill_values(self, values: tuple[Variant, ...]) -> None:
        for index, value in enumerate(values):
            field = self.query_one(f"#field{index}")
            if isinstance(field, TypedValue):
                field.fill_value(value.vt, untyped_text(value) or "")
            elif isinstance(field, Select) and isinstance(value.value, int):
                field.value = value.value

    def argument_values(self) -> tuple[Variant, ...] | str:
        """Return the arguments without the handle, or what is wrong with the first invalid argument."""
        found: list[Variant] = []
        for index, param in enumerate(self.params):
            field = self.query_one(f"#field{index}")
            if isinstance(field, TypedValue):
                value = field.checked_value
                if isinstance(value, str):
                    return f"{param.name}: {value}"
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
            self.post_message(CallWanted(result, function_step(self.function, values)))


def select_named_value(texts: Mapping[int, str], id: str) -> Select[int]:
    options = [(f"{value} {table_text(text)}", value) for value, text in texts.items()]
    return Select(options, allow_blank=False, compact=True, id=id, classes="named")


class FunctionPanel(Vertical):
    """Shows the form of the function that the user chose."""

    def __init__(self, initial_function: Function, *, id: str | None = None) -> None:
        super().__init__(id=id)
        self._function = initial_function

    def compose(self) -> ComposeResult:
        with Horizontal(classes="row"):
            yield Caption("tester.function")
            label_text = f"{self._function.id} {self._function.name} ▾"
            yield Button(label_text, compact=True, id="choose-function")
        yield FunctionForm(self._function)

    async def show_function(self, function: Function) -> FunctionForm:
        self._function = function
        await self.recompose()
        return self.query_one(FunctionForm)


MAX_DATAGRAM = 65_507
"""Maximum payload of a UDP datagram in bytes."""

_EXAMPLE = "01 10 00 00 00 01 00 00 00 02 00 00 00 00 00 04"


class BytesField(Input):
    def on_paste(self, event: Paste) -> None:
        """Join the pasted lines, because Textual's own handler pastes only the first line."""
        event.text = " ".join(event.text.split())


class RawForm(Vertical):
    def compose(self) -> ComposeResult:
        with Horizontal(classes="row"):
            yield Caption("tester.bytes")
            yield BytesField(placeholder=_EXAMPLE, classes="value")
        with Horizontal(classes="row"):
            yield TickBox(label("tester.raw.length"), True)
            yield FormButton("tester.send", "primary", classes="execute")
        yield ResultView()

    def fill_bytes(self, raw: bytes) -> None:
        self.query_one(Input).value = raw.hex(" ").upper()

    @property
    def typed_bytes(self) -> bytes | str:
        """The bytes that the user typed, or a text that says why the field is invalid."""
        text = self.query_one(Input).value
        try:
            raw = bytes.fromhex(text)
        except ValueError:
            return label("tester.raw.hex")
        if not 0 < len(raw) <= MAX_DATAGRAM:
            return label("tester.raw.size", most=MAX_DATAGRAM)
        right = self.query_one(TickBox).value and len(raw) >= 16
        return raw[:1] + len(raw).to_bytes(4, "little") + raw[5:] if right else raw

    @on(Input.Changed)
    @on(TickBox.Changed)
    def _check_bytes(self) -> None:
        raw = self.typed_bytes
        problem, items = (raw, ()) if isinstance(raw, str) else ("", parse_datagram(raw))
        self.query_one(ResultView).show_check(problem, "; ".join(map(_frame_text, items)))

    @on(Button.Pressed)
    @on(Input.Submitted)
    def _request_send(self) -> None:
        raw, result = self.typed_bytes, self.query_one(ResultView)
        if isinstance(raw, str):
            result.show_problem(raw)
        else:
            self.post_message(CallWanted(result, lambda session: session.send_raw(raw)))


def _frame_text(item: object) -> str:
    if isinstance(item, Frame):
        head = label("tester.raw.frame", name=function_name(item.code), serial=item.serial, count=item.argc)
        return ": ".join(filter(None, (head, _problem_text(item.problems))))
    return _problem_text(getattr(item, "problems", ()))


def _problem_text(problems: Iterable[Problem]) -> str:
    return ", ".join(reader_words().text(problem.reason) for problem in problems)
