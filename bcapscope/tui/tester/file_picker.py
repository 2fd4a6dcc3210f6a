"""A dialog for choosing a file, with recent files and the folders of this machine."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import ClassVar

from rich.text import Text
from textual import on
from textual.app import ComposeResult
from textual.binding import Binding, BindingType
from textual.containers import Vertical
from textual.screen import ModalScreen
from textual.widgets import DirectoryTree, OptionList, Static
from textual.widgets.option_list import Option

from bcapscope.render.escape import printable
from bcapscope.tui.reader_language import label


class FilePicker(ModalScreen[str | None]):
    """Shows recent files above a tree of folders."""

    BINDINGS: ClassVar[list[BindingType]] = [
        Binding("escape", "dismiss(None)", "shell.close", key_display="esc"),
        Binding("backspace", "up", "", show=False),
    ]

    def __init__(self, title: str, recent: Sequence[str], folder: Path) -> None:
        super().__init__()
        self._title = title
        self._recent = [path for path in recent if Path(path).exists()]
        self._folder = folder.absolute()  # a relative path may have neither a name to show nor a parent

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
