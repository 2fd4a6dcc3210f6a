"""The catalogue of commands: what each does, what it takes, and whether it energises or moves something."""

from __future__ import annotations

from typing import ClassVar

from rich.text import Text
from textual import on
from textual.app import ComposeResult
from textual.binding import Binding, BindingType
from textual.containers import Vertical
from textual.screen import ModalScreen
from textual.widgets import Input, OptionList
from textual.widgets.option_list import Option

from bcapscope.protocol.commands import Command, commands
from bcapscope.protocol.effects import Effect
from bcapscope.protocol.functions import FUNCTIONS
from bcapscope.tui.app import scope_of
from bcapscope.tui.words import say, told

_WARNINGS = {Effect.ENERGISES: "tester.energises", Effect.MOVES: "tester.moves"}


class Picker(ModalScreen[str | None]):
    """A list to choose from, with a field that narrows it down."""

    BINDINGS: ClassVar[list[BindingType]] = [
        Binding("escape", "dismiss(None)", "shell.close", key_display="esc"),
        Binding("down", "down", "", show=False),
    ]

    def __init__(self, title: str) -> None:
        super().__init__()
        self._title = title

    def compose(self) -> ComposeResult:
        """Put the field above the list."""
        with Vertical(classes="dialog") as box:
            box.border_title = self._title
            yield Input(placeholder=say("tester.narrow"))
            yield OptionList(markup=False)

    def on_mount(self) -> None:
        """Show all."""
        self._fill("")

    def options(self, words: list[str]) -> list[Option]:
        """Return what to choose from, narrowed down to what holds all `words`, in small letters."""
        raise NotImplementedError

    def action_down(self) -> None:
        """Go to the list."""
        self.query_one(OptionList).focus()

    @on(Input.Changed)
    def _narrow(self, message: Input.Changed) -> None:
        self._fill(message.value)

    @on(Input.Submitted)
    def _first(self) -> None:
        found = self.query_one(OptionList)
        if found.option_count:
            self.dismiss(found.get_option_at_index(found.highlighted or 0).id)

    @on(OptionList.OptionSelected)
    def _choose(self, message: OptionList.OptionSelected) -> None:
        self.dismiss(message.option_id)

    def _fill(self, text: str) -> None:
        found = self.query_one(OptionList)
        found.clear_options()
        found.add_options(self.options(text.casefold().split()))
        if found.option_count:
            found.highlighted = 0


class CommandPicker(Picker):
    """The commands of one of the ..._Execute functions."""

    def __init__(self, function_id: int) -> None:
        super().__init__(say("tester.catalogue", name=FUNCTIONS[function_id].name))
        self._commands = commands(function_id)

    def options(self, words: list[str]) -> list[Option]:
        """Show name, types, what moves, and what it does."""
        return [Option(self._row(each), id=each.name) for each in self._commands if _fits(each, words)]

    def _row(self, each: Command) -> Text:
        inks = scope_of(self).inks
        types = " ".join(name.removeprefix("VT_").replace("|VT_ARRAY", "[]") for name in each.parameter_types)
        return Text.assemble(
            (f"{each.name:<24} ", inks["name"]),
            (f"{types:<14} ", inks["number"]),
            (f"{say(_WARNINGS[each.effect])} ", inks["bad"]) if each.effect in _WARNINGS else "",
            (told(each.text), inks["dim"]),
        )


class FunctionPicker(Picker):
    """All 137 functions."""

    def __init__(self) -> None:
        super().__init__(say("tester.functions"))

    def options(self, words: list[str]) -> list[Option]:
        """Show id, name and arguments."""
        inks = scope_of(self).inks
        return [
            Option(
                Text.assemble(
                    (f"{each.id:>3} ", inks["number"]),
                    (f"{each.name:<30} ", inks["name"]),
                    (" ".join(param.name for param in each.params), inks["dim"]),
                ),
                id=each.name,
            )
            for each in FUNCTIONS.values()
            if all(word in f"{each.id} {each.name.casefold()}" for word in words)
        ]


def _fits(each: Command, words: list[str]) -> bool:
    text = f"{each.name} {each.text} {told(each.text)}".casefold()
    return all(word in text for word in words)
