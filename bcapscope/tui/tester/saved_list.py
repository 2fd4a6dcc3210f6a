"""The list of saved requests, which are the files of a folder.

Enter sends the saved request under the cursor; the E key puts the request into a form.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import ClassVar

from rich.cells import set_cell_size
from textual.binding import Binding, BindingType
from textual.message import Message

from bcapscope.render.escape import printable
from bcapscope.tui.controller_access.saved_requests import SavedRequest, list_requests
from bcapscope.tui.ink import INK
from bcapscope.tui.reader_language import label
from bcapscope.tui.widgets.item_list import ItemList

_NAME_WIDTH = 28


class SavedList(ItemList[tuple[str, SavedRequest | str] | None]):
    BINDINGS: ClassVar[list[BindingType]] = [
        Binding("e", "edit", "tester.edit"),
        Binding("u", "reload", "tester.reload"),
    ]

    @dataclass
    class RequestWanted(Message):
        """The user wants to send a saved request, or to put the request into a form if `edit` is set."""

        saved: SavedRequest
        edit: bool

    def __init__(self, folder: Path, *, id: str | None = None) -> None:
        super().__init__(id=id)
        self.folder = folder

    def on_mount(self) -> None:
        self.action_reload()

    def action_reload(self) -> None:
        """Read the folder again; the last line of the list shows the folder's name."""
        self.show_items([*list_requests(self.folder), None])

    def item_line(self, item: tuple[str, SavedRequest | str] | None) -> str:
        if item is None:
            return f"{INK.dim}{label('tester.saved.folder', path=printable(str(self.folder)))}{INK.reset}"
        name, found = item
        head = f"{INK.name}{set_cell_size(printable(name), _NAME_WIDTH)}{INK.reset}"
        if isinstance(found, str):
            return f"{head} {INK.bad}{printable(found)}{INK.reset}"
        values = " ".join(printable(str(each.value)) for each in found.values)
        note = f"  {INK.dim}{printable(found.note)}{INK.reset}" if found.note else ""
        return f"{head} {found.function.name} {INK.number}{values}{INK.reset}{note}"

    def on_lines_chosen(self) -> None:
        self._post_request(False)

    def action_edit(self) -> None:
        self._post_request(True)

    def _post_request(self, edit: bool) -> None:
        if self.current_item is not None and isinstance(self.current_item[1], SavedRequest):
            self.post_message(self.RequestWanted(self.current_item[1], edit))
