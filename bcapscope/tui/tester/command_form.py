"""The Execute form, as in b-CAP Tester: Command, Type, Parameter, Result."""

from __future__ import annotations

from typing import ClassVar

from textual import on
from textual.app import ComposeResult
from textual.binding import Binding, BindingType
from textual.containers import Horizontal, Vertical
from textual.suggester import SuggestFromList
from textual.widgets import Button, Input

from bcapscope.protocol.codec.variant import VT, Variant
from bcapscope.protocol.tables.command_catalogue import commands_of
from bcapscope.protocol.tables.function_table import FUNCTIONS
from bcapscope.tui.app import app_of
from bcapscope.tui.controller_access.parameter_input import command_hint
from bcapscope.tui.reader_language import label
from bcapscope.tui.tester.form_widgets import Caption, FormButton
from bcapscope.tui.tester.pickers import command_picker
from bcapscope.tui.tester.result_view import ResultView
from bcapscope.tui.tester.typed_value import TypedValue
from bcapscope.tui.tester.wanted_messages import CallWanted


class CommandForm(Vertical):
    """A form for calls of one ..._Execute function, with completion of command names."""

    BINDINGS: ClassVar[list[BindingType]] = [
        Binding("f4", "pick", "tester.pick"),
    ]

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
        """Select the type of the typed command's parameter, and show what the command does.

        A parameter that belongs to another command is cleared; the parameter last sent with this command is
        restored.
        """
        found = command_hint(self.function.id, message.value)
        if found is None:
            self.query_one(ResultView).show_hint("")
            return
        typed = self.query_one(TypedValue)
        before = self._sent_parameters.get(message.value.strip().casefold())
        if before is not None:
            typed.fill_value(*before)
        elif typed.typed == self._last_parameter:
            typed.fill_value(found.types[0] if found.types else typed.vt, "")
        elif found.types:
            typed.select_type(found.types[0])
        self.query_one(ResultView).show_hint(found.text)

    @on(TypedValue.Changed)
    def _show_check(self, message: TypedValue.Changed) -> None:
        found = command_hint(self.function.id, self.query_one(".command", Input).value)
        hint = found.text if found else message.value.hint
        self.query_one(ResultView).show_check(message.problem, hint)

    @on(Input.Submitted, ".command")
    def _submit_command(self, message: Input.Submitted) -> None:
        """Complete a partly typed name.

        A command is executed if its name is known, or if no known name begins with the text.

        If the command's parameter is missing, the parameter gets the focus instead.
        """
        begun = message.value.strip().casefold()
        names = [
            each.name for each in commands_of(self.function.id) if each.name.casefold().startswith(begun)
        ]
        if begun and names and begun not in map(str.casefold, names):
            message.input.value = names[0]
            message.input.cursor_position = len(names[0])
        elif begun and self.query_one(TypedValue).is_missing:
            self.query_one(TypedValue).query_one(Input).focus()
        else:
            self._execute()

    @on(Button.Pressed)
    @on(TypedValue.Submitted)
    def _execute(self) -> None:
        result, name = self.query_one(ResultView), self.query_one(".command", Input).value.strip()
        checked = self.query_one(TypedValue).checked_text
        if not name:
            result.show_problem(label("tester.command.missing"))
        elif checked.value is None:
            result.show_problem(checked.problem)
        else:
            if command_hint(self.function.id, name) is not None:  # an unknown name may be a typing error
                self._last_parameter = self._sent_parameters[name.casefold()] = self.query_one(
                    TypedValue
                ).typed
            self.post_message(CallWanted(result, self.function, (Variant(VT.BSTR, name), checked.value)))

    def action_pick(self) -> None:
        def take(name: str | None) -> None:
            if name:
                self.query_one(".command", Input).value = name
                self.query_one(TypedValue).query_one(Input).focus()

        app_of(self).push_screen(command_picker(self.function.id, app_of(self).text_styles), take)
