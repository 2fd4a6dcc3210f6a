"""Dialogs to choose a command, a function or a file."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import ClassVar

from rich.text import Text
from textual import on
from textual.app import ComposeResult
from textual.binding import Binding, BindingType
from textual.containers import Vertical
from textual.screen import ModalScreen
from textual.widgets import DirectoryTree, Input, OptionList, Static
from textual.widgets.option_list import Option

from bcapscope.protocol.tables.call_effect import CallEffect
from bcapscope.protocol.tables.command_catalogue import CommandSpec, commands_of
from bcapscope.protocol.tables.function_table import FUNCTIONS
from bcapscope.render.escape import printable
from bcapscope.tui.ink import Styles
from bcapscope.tui.reader_language import label, table_text

_WARNINGS = {CallEffect.ENERGISES: "tester.energises", CallEffect.MOVES: "tester.moves"}


class ListPicker(ModalScreen[str | None]):
    BINDINGS: ClassVar[list[BindingType]] = [
        Binding("escape", "dismiss(None)", "shell.close", key_display="esc"),
        Binding("down", "app.focus_next", "", show=False),
    ]

    def __init__(self, title: str, entries: Iterable[tuple[str, Text, str]]) -> None:
        """Each entry has a name, a text to show, and a search text. The list shows an entry if its search
        text contains all words that the user typed.
        """
        super().__init__()
        self._title = title
        self._entries = tuple(entries)

    def compose(self) -> ComposeResult:
        with Vertical(classes="dialog") as box:
            box.border_title = self._title
            yield Input(placeholder=label("tester.narrow"))
            yield OptionList(markup=False)

    def on_mount(self) -> None:
        self._show_matching("")

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

    def _show_matching(self, typed: str) -> None:
        words, found = typed.casefold().split(), self.query_one(OptionList)
        found.clear_options()
        found.add_options(
            Option(text, id=name)
            for name, text, searched in self._entries
            if all(word in searched.casefold() for word in words)
        )
        if found.option_count:
            found.highlighted = 0


def command_picker(function_id: int, styles: Styles) -> ListPicker:
    return ListPicker(
        label("tester.catalogue", name=FUNCTIONS[function_id].name),
        (
            (each.name, _command_text(each, styles), f"{each.name} {each.text} {table_text(each.text)}")
            for each in commands_of(function_id)
        ),
    )


def _command_text(command: CommandSpec, styles: Styles) -> Text:
    types = " ".join(name.removeprefix("VT_").replace("|VT_ARRAY", "[]") for name in command.parameter_types)
    warning = _WARNINGS.get(command.effect)
    return Text.assemble(
        (f"{command.name:<24} ", styles["name"]),
        (f"{types:<14} ", styles["number"]),
        (f"{label(warning)} ", styles["bad"]) if warning else "",
        (table_text(command.text), styles["dim"]),
    )


def function_picker(styles: Styles) -> ListPicker:
    entries = []
    for each in FUNCTIONS.values():
        text = Text.assemble(
            (f"{each.id:>3} ", styles["number"]),
            (f"{each.name:<30} ", styles["name"]),
            (" ".join(param.name for param in each.params), styles["dim"]),
        )
        entries.append((each.name, text, f"{each.id} {each.name}"))
    return ListPicker(label("tester.functions"), entries)


class FilePicker(ModalScreen[str | None]):
    BINDINGS: ClassVar[list[BindingType]] = [
        Binding("escape", "dismiss(None)", "shell.close", key_display="esc"),
        Binding("backspace", "up", "", show=False),
    ]

    def __init__(self, title: str, recent: Sequence[str], folder: Path) -> None:
        super().__init__()
        self._title = title
        self._recent = [path for path in recent if Path(path).exists()]
        self._folder = folder.absolute()  # the relative path "." has no name and no parent folder

    def compose(self) -> ComposeResult:
        with Vertical(classes="dialog -tall") as box:
            box.border_title = self._title
            box.border_subtitle = label("tester.browse.hint")
            if self._recent:
                yield Static(label("tester.recent"), markup=False, classes="caption")
                options = [Option(Text(printable(path)), id=str(at)) for at, path in enumerate(self._recent)]
                yield OptionList(*options, markup=False, id="recent")
            yield DirectoryTree(self._folder, id="tree")

    def action_up(self) -> None:
        tree = self.query_one(DirectoryTree)
        tree.path = Path(tree.path).parent
        tree.focus()

    @on(OptionList.OptionSelected)
    def _choose_recent(self, message: OptionList.OptionSelected) -> None:
        self.dismiss(self._recent[int(message.option_id or 0)])

    @on(DirectoryTree.FileSelected)
    def _choose_file(self, message: DirectoryTree.FileSelected) -> None:
        self.dismiss(str(message.path))
