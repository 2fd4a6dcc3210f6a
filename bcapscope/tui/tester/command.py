"""Execute as b-CAP Tester has it: Command, Type, Parameter, Result."""

from __future__ import annotations

from typing import ClassVar

from textual import on
from textual.app import ComposeResult
from textual.binding import Binding, BindingType
from textual.containers import Horizontal, Vertical
from textual.suggester import SuggestFromList
from textual.widgets import Button, Input

from bcapscope.protocol.commands import commands
from bcapscope.protocol.functions import FUNCTIONS
from bcapscope.protocol.variant import VT, Variant
from bcapscope.tui.app import scope_of
from bcapscope.tui.desk.parameter import expected, suggestion
from bcapscope.tui.tester.field import Caption
from bcapscope.tui.tester.messages import CallWanted
from bcapscope.tui.tester.picker import CommandPicker
from bcapscope.tui.tester.result import ResultView
from bcapscope.tui.tester.typed import TypedValue
from bcapscope.tui.words import say


class CommandForm(Vertical):
    """Makes calls of one of the ..._Execute functions; the catalogue completes the command as it is typed."""

    BINDINGS: ClassVar[list[BindingType]] = [
        Binding("f4", "pick", "tester.pick", id="command.pick", tooltip="tester.pick.tip"),
    ]

    def __init__(self, function_id: int, *, id: str | None = None) -> None:
        """Take the function: Controller_Execute, Robot_Execute and the like."""
        super().__init__(id=id)
        self.function = FUNCTIONS[function_id]
        self._sent: dict[str, tuple[int, str]] = {}
        self._latest: tuple[int, str] | None = None

    def compose(self) -> ComposeResult:
        """Put command, type and parameter into two rows, and the result below."""
        names = [each.name for each in commands(self.function.id)]
        with Horizontal(classes="row"):
            yield Caption("tester.command")
            yield Input(suggester=SuggestFromList(names, case_sensitive=False), classes="command")
        with Horizontal(classes="row"):
            yield Caption("tester.parameter")
            yield TypedValue()
            yield Button(say("tester.execute"), compact=True, variant="primary", classes="execute")
        yield ResultView()

    def put(self, name: str, parameter: Variant, text: str) -> None:
        """Show a command with its parameter."""
        with self.prevent(Input.Changed):
            self.query_one(".command", Input).value = name
        self.query_one(TypedValue).put(parameter.vt, text)

    @on(Input.Changed, ".command")
    def _complete(self, message: Input.Changed) -> None:
        """Choose the type that the command has, and say what it does.

        The parameter that was sent with another command goes; what was sent with this one comes back.
        """
        message.stop()
        found = suggestion(self.function.id, message.value)
        if found is None:
            self.query_one(ResultView).hint("")
            return
        typed = self.query_one(TypedValue)
        before = self._sent.get(message.value.strip().casefold())
        if before is not None:
            typed.put(*before)
        elif typed.typed == self._latest:
            typed.put(found.types[0] if found.types else typed.vt, "")
        elif found.types:
            typed.choose(found.types[0])
        self.query_one(ResultView).hint(found.text)

    @on(TypedValue.Changed)
    def _check(self, message: TypedValue.Changed) -> None:
        message.stop()
        if message.problem:
            self.query_one(ResultView).problem(message.problem)
            return
        found = suggestion(self.function.id, self.query_one(".command", Input).value)
        vt = message.value.vt
        wanted = "" if vt in (VT.EMPTY, VT.NULL) else expected(vt)
        self.query_one(ResultView).hint(found.text if found else wanted)

    @on(Input.Submitted, ".command")
    def _finish(self, message: Input.Submitted) -> None:
        """Complete a name that was begun; execute one that is known, or that nothing known begins with.

        Where the parameter of it is still to be typed, go there.
        """
        begun = message.value.strip().casefold()
        names = [each.name for each in commands(self.function.id) if each.name.casefold().startswith(begun)]
        if begun and names and begun not in map(str.casefold, names):
            message.stop()
            message.input.value = names[0]
            message.input.cursor_position = len(names[0])
        elif begun and self.query_one(TypedValue).is_missing:
            message.stop()
            self.query_one(TypedValue).query_one(Input).focus()
        else:
            self._execute(message)

    @on(Button.Pressed)
    @on(TypedValue.Submitted)
    def _execute(self, message: Button.Pressed | TypedValue.Submitted | Input.Submitted) -> None:
        message.stop()
        result, name = self.query_one(ResultView), self.query_one(".command", Input).value.strip()
        checked = self.query_one(TypedValue).checked
        if not name:
            result.problem(say("tester.command.missing"))
        elif checked.value is None:
            result.problem(checked.problem)
        else:
            if suggestion(self.function.id, name) is not None:  # else it may be a slip of the pen
                self._latest = self._sent[name.casefold()] = self.query_one(TypedValue).typed
            self.post_message(CallWanted(result, self.function, (Variant(VT.BSTR, name), checked.value)))

    def action_pick(self) -> None:
        """Choose from all commands that are known."""

        def take(name: str | None) -> None:
            if name:
                self.query_one(".command", Input).value = name
                self.query_one(TypedValue).query_one(Input).focus()

        scope_of(self).push_screen(CommandPicker(self.function.id), take)
