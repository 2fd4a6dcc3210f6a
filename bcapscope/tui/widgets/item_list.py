"""Lists of items, one line per item."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Sequence
from typing import Generic, TypeVar

from bcapscope.tui.ink import INK
from bcapscope.tui.reader_language import label
from bcapscope.tui.widgets.lines import Lines

T = TypeVar("T")


class ItemList(Lines, Generic[T]):
    """A list of items; when the items change, the cursor remains on the same item."""

    def __init__(self, empty: str = "", *, id: str | None = None) -> None:
        """Create an empty list; `empty` is the label key of the line that an empty list shows."""
        super().__init__(id=id)
        self.items: list[T] = []
        self._empty = empty

    @abstractmethod
    def item_line(self, item: T) -> str:
        """Return the line of an item, rendered with `ink.INK`."""

    def key_of(self, item: T) -> object:
        """Return what identifies an item; None if only its position does."""
        return None

    def show_items(self, items: Sequence[T]) -> None:
        items = list(items)
        if items == self.items:
            return
        before, keys = list(map(self.key_of, self.items)), list(map(self.key_of, items))
        here = before[self.cursor] if self.cursor < len(before) else None
        self.items = items
        if None not in keys and keys == before:
            self.repaint()
        else:
            self.reset_lines(keys.index(here) if here is not None and here in keys else self.cursor)

    def add_item(self, item: T) -> None:
        self.items.append(item)
        if self._empty and len(self.items) == 1:
            self.reset_lines()
        else:
            self.lines_added()

    @property
    def current_item(self) -> T | None:
        """The item under the cursor; None in an empty list."""
        return self.items[self.cursor] if self.cursor < len(self.items) else None

    @property
    def count(self) -> int:
        return max(len(self.items), bool(self._empty))

    def line(self, index: int) -> str:
        if index < len(self.items):
            return self.item_line(self.items[index])
        return f"{INK.dim} {label(self._empty)}{INK.reset}"


class TextList(ItemList[str]):
    """A list of rendered lines."""

    def item_line(self, item: str) -> str:
        return item
