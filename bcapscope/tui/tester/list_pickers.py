"""Dialogs to choose a command or function; they show purpose, parameters, and possible motion."""

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

from bcapscope.protocol.tables.call_effect import CallEffect
from bcapscope.protocol.tables.command_catalogue import CommandSpec, commands_of
from bcapscope.protocol.tables.function_table import FUNCTIONS
from bcapscope.tui.app import app_of
from bcapscope.tui.reader_language import label, table_text

_WARNINGS = {CallEffect.ENERGISES: "tester.energises", CallEffect.MOVES: "tester.moves"}


class ListPicker(ModalScreen[str | None]):
    """A dialog with a list to choose from, and a field that filters the list."""

    BINDINGS: ClassVar[list[BindingType]] = [
        Binding("escape", "dismiss(None)", "shell.close", key_display="esc"),
        Binding("down", "down", "", show=False),
    ]

    def __init__(self, title: str) -> None:
        super().__init__()
        self._title = title

    def compose(self) -> ComposeResult:
        with Vertical(classes="dialog") as box:
            box.border_title = self._title
            yield Input(placeholder=label("tester.narrow"))
            yield OptionList(markup=False)

    def on_mount(self) -> None:
        self._show_matching("")

    def matching_options(self, words: list[str]) -> list[Option]:
        """Return the options that contain all `words`, which must be in lower case."""
        raise NotImplementedError

    def action_down(self) -> None:
        self.query_one(OptionList).focus()

    @on(Input.Changed)
    def _narrow(self, message: Input.Changed) -> None:
        self._show_matching(message.value)

    @on(Input.Submitted)
    def _choose_highlighted(self) -> None:
        found = self.query_one(OptionList)
        if found.option_count:
            self.dismiss(found.get_option_at_index(found.highlighted or 0).id)

    @on(OptionList.OptionSelected)
    def _choose(self, message: OptionList.OptionSelected) -> None:
        self.dismiss(message.option_id)

    def _show_matching(self, text: str) -> None:
        found = self.query_one(OptionList)
        found.clear_options()
        found.add_options(self.matching_options(text.casefold().split()))
        if found.option_count:
            found.highlighted = 0


class CommandPicker(ListPicker):
    """A dialog to choose a command of one ..._Execute function."""

    def __init__(self, function_id: int) -> None:
        super().__init__(label("tester.catalogue", name=FUNCTIONS[function_id].name))
        self._commands = commands_of(function_id)

    def matching_options(self, words: list[str]) -> list[Option]:
        return [
            Option(self._command_text(each), id=each.name)
            for each in self._commands
            if _matches_words(each, words)
        ]

    def _command_text(self, each: CommandSpec) -> Text:
        inks = app_of(self).text_styles
        types = " ".join(name.removeprefix("VT_").replace("|VT_ARRAY", "[]") for name in each.parameter_types)
        return Text.assemble(
            (f"{each.name:<24} ", inks["name"]),
            (f"{types:<14} ", inks["number"]),
            (f"{label(_WARNINGS[each.effect])} ", inks["bad"]) if each.effect in _WARNINGS else "",
            (table_text(each.text), inks["dim"]),
        )


class FunctionPicker(ListPicker):
    def __init__(self) -> None:
        super().__init__(label("tester.functions"))

    def matching_options(self, words: list[str]) -> list[Option]:
        inks = app_of(self).text_styles
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


def _matches_words(each: CommandSpec, words: list[str]) -> bool:
    text = f"{each.name} {each.text} {table_text(each.text)}".casefold()
    return all(word in text for word in words)
