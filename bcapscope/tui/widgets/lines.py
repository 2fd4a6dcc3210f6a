"""Lists of any length. A list renders a line only when the line is visible."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass
from typing import ClassVar, Generic, TypeVar

from rich.segment import Segment
from rich.style import Style
from textual.binding import Binding, BindingType
from textual.cache import FIFOCache
from textual.color import TRANSPARENT
from textual.events import Click, Resize
from textual.filter import LineFilter
from textual.geometry import Region, Size
from textual.message import Message
from textual.reactive import reactive
from textual.scroll_view import ScrollView
from textual.strip import Strip

from bcapscope.tui.app import app_of
from bcapscope.tui.ink import INK, Styles, styled_segments
from bcapscope.tui.reader_language import label
from bcapscope.tui.themes import readable_style

_MAX_STRIPS = 500  # rendered lines in the cache, enough for several screens
_SIDEWAYS_COLUMNS = 8


class Lines(ScrollView, can_focus=True):
    """A list with a cursor. A subclass defines `count` and `line`.

    A subclass calls `lines_added` if lines were added at the end, and `reset_lines` after any other change.
    The list has no border and no padding, because `render_lines` draws neither. In an empty list, the index
    `cursor` is 0. If `follows_end` is True and the cursor is on the last line, the cursor moves to new lines.
    """

    BINDINGS: ClassVar[list[BindingType]] = [
        Binding("up,k", "move(-1)", "", show=False),
        Binding("down,j", "move(1)", "", show=False),
        Binding("pageup", "page(-1)", "", show=False),
        Binding("pagedown", "page(1)", "", show=False),
        Binding("home,g", "to_start", "lines.start", show=False),
        Binding("end,G", "to_end", "lines.end", show=False),
        Binding("left", "sideways(-1)", "", show=False),
        Binding("right", "sideways(1)", "", show=False),
        Binding("enter", "choose", "", show=False),
    ]
    COMPONENT_CLASSES: ClassVar[set[str]] = {"lines--cursor", "lines--blurred"}
    ALLOW_SELECT = False
    cursor: reactive[int] = reactive(0, repaint=False)
    follows_end = False
    highlights_cursor_line = True

    @dataclass
    class Moved(Message):
        """The cursor moved to another line, or a new line replaced the line under the cursor."""

        lines: Lines

    class Chosen(Moved):
        """The user pressed Enter on a line, or clicked the line under the cursor."""

    def __init__(self, *, id: str | None = None) -> None:
        super().__init__(id=id)
        self._strips: FIFOCache[tuple[object, ...], Strip] = FIFOCache(_MAX_STRIPS)
        self._width = 0
        self._known_count = 0
        self._styles: dict[str, Styles] = {}
        self._background = TRANSPARENT
        self._filters: tuple[LineFilter, ...] = ()

    @property
    @abstractmethod
    def count(self) -> int: ...

    @abstractmethod
    def line(self, index: int) -> str:
        """Return a line, rendered with `ink.INK`."""

    def header(self) -> str:
        """Return the titles of the columns; "" for a list without columns."""
        return ""

    # for subclasses

    def reset_lines(self, cursor: int = 0) -> None:
        """Draw all lines anew, with the cursor on the line with index `cursor`."""
        self._strips.clear()
        self._width = 0
        self._known_count = self.count
        self._update_extent()
        self.set_reactive(Lines.cursor, max(0, min(cursor, self.count - 1)))
        self.scroll_x = self.scroll_target_x = 0
        self._scroll_to_cursor()
        self.refresh()
        self._post_moved()

    def lines_added(self) -> None:
        before, count = self._known_count, self.count
        if count == before:
            return
        self._known_count = count
        self._update_extent()
        if self.follows_end and self.cursor >= before - 1:
            self.cursor = count - 1
        if before < self.scroll_offset.y + self.size.height:
            self.refresh()
        if before == 0:
            self._post_moved()

    def _update_extent(self) -> None:
        """Update the total size and the scroll bar without a new layout of the whole screen."""
        size = Size(max(self._width, self.size.width), max(self._known_count, self.size.height))
        if size != self.virtual_size:
            self.set_reactive(Lines.virtual_size, size)
            self._update_scrollbar()

    def _update_scrollbar(self) -> None:
        bar = self.vertical_scrollbar
        bar.window_virtual_size, bar.window_size = self.virtual_size.height, self.size.height
        bar.position = self.scroll_y

    def watch_scroll_y(self, old_value: float, new_value: float) -> None:
        if round(old_value) != round(new_value):
            self.refresh(self.size.region)
            self._update_scrollbar()

    def repaint(self) -> None:
        self._strips.clear()
        self.refresh()

    def redraw_lines(self, *indexes: int) -> None:
        top, height = self.scroll_offset.y, self.size.height
        seen = [index - top for index in indexes if 0 <= index - top < height]
        if seen:
            self.refresh(*(Region(0, y, self.size.width, 1) for y in seen))

    # drawing

    def notify_style_update(self) -> None:
        self._strips.clear()
        self._styles.clear()
        super().notify_style_update()

    def on_resize(self, event: Resize) -> None:
        self._update_extent()
        self._scroll_to_cursor()

    def render_lines(self, crop: Region) -> list[Strip]:
        """Unlike Textual's own method, do not draw every line again when the user scrolls by one line."""
        look = self.background_colors[1], tuple(self.get_line_filters())
        if look != (self._background, self._filters):
            self._background, self._filters = look
            self._strips.clear()
        x, top = self.scroll_offset
        width = self.size.width
        strips = [self._line_strip(min(y + top, self._known_count), x, width) for y in crop.line_range]
        return [strip.crop(crop.x, crop.right) for strip in strips]

    def _line_strip(self, index: int, x: int, width: int) -> Strip:
        is_there = index < self._known_count
        is_cursor = is_there and self.highlights_cursor_line and index == self.cursor
        sign = self.line_state(index) if is_there else None
        key = (index, x, width, is_cursor, is_cursor and self.has_focus, sign)
        strip = self._strips.get(key)
        if strip is None:
            strip = self._strips[key] = self._draw_line(
                self.line(index) if is_there else "", x, width, is_cursor
            )
        return strip

    def line_state(self, index: int) -> str:
        """Return a text that stands for the state of a line, such as its marks. If the text differs from the
        text at the last drawing, the list draws the line again.
        """
        return ""

    def _draw_line(self, line: str, x: int, width: int, is_cursor: bool) -> Strip:
        styles = self._line_styles(("cursor" if self.has_focus else "blurred") if is_cursor else "")
        drawn = styled_segments(line, styles)
        length = sum(segment.cell_length for segment in drawn)
        if length > self._width:
            self._width = length
            self.call_later(self._update_extent)
        if length < x + width:
            drawn.append(Segment(" " * (x + width - length), styles[""]))
        for each in self._filters:
            drawn = each.apply(drawn, self._background)
        return Strip(drawn, max(length, x + width)).crop(x, x + width)

    def _line_styles(self, cursor_state: str) -> Styles:
        """Return the styles of a line by style name. The key "" has the style of text without an ink
        mark, and of the empty rest of the row. `cursor_state` is "cursor" or "blurred" for the line under the
        cursor, "" for any other line.
        """
        if cursor_state not in self._styles:
            own, inks = self._line_style(cursor_state), app_of(self).text_styles
            self._styles[cursor_state] = {"": own} | {
                name: readable_style(ink, own) for name, ink in inks.items()
            }
        return self._styles[cursor_state]

    def _line_style(self, cursor_state: str) -> Style:
        if not cursor_state:
            return self.rich_style
        if app_of(self).no_color:
            return Style(reverse=cursor_state == "cursor", underline=cursor_state == "blurred")
        return self.get_component_rich_style(f"lines--{cursor_state}")

    # the cursor

    def move_cursor_to(self, index: int) -> None:
        self.cursor = max(0, min(index, self.count - 1))

    def watch_cursor(self, old: int, new: int) -> None:
        self.redraw_lines(old, new)
        self._scroll_to_cursor()
        self._post_moved()

    def on_focus(self) -> None:
        self.repaint()

    def on_blur(self) -> None:
        self.repaint()

    def _post_moved(self) -> None:
        self.post_message(self.Moved(self))

    def _scroll_to_cursor(self) -> None:
        height = self.size.height
        top, at = self.scroll_offset.y, self.cursor
        if height and not top <= at < top + height:
            aim = at if at < top else at - height + 1
            if abs(at - top) > 2 * height:
                aim = at - height // 2
            self.scroll_to(y=max(0, aim), animate=False, force=True)

    def action_move(self, by: int) -> None:
        self.move_cursor_to(self.cursor + by)

    def action_page(self, by: int) -> None:
        self.move_cursor_to(self.cursor + by * max(1, self.size.height - 1))

    def action_to_start(self) -> None:
        self.move_cursor_to(0)

    def action_to_end(self) -> None:
        self.move_cursor_to(self.count - 1)

    def action_sideways(self, by: int) -> None:
        self.scroll_to(x=max(0, self.scroll_offset.x + by * _SIDEWAYS_COLUMNS), animate=False, force=True)

    def action_choose(self) -> None:
        if self.count:
            self.post_message(self.Chosen(self))

    def on_click(self, event: Click) -> None:
        offset = event.get_content_offset(self)
        if offset is not None:
            column, index = offset + self.scroll_offset
            if index < self.count:
                self.click_line(index, column, event.chain)

    def click_line(self, index: int, column: int, clicks: int) -> None:
        if index == self.cursor and clicks > 1:
            self.action_choose()
        self.move_cursor_to(index)


T = TypeVar("T")


class ItemList(Lines, Generic[T]):
    """A list of items. When the items change, the cursor stays on the same item."""

    def __init__(self, empty: str = "", *, id: str | None = None) -> None:
        """Create a list. An empty list shows the label whose id is `empty`."""
        super().__init__(id=id)
        self.items: list[T] = []
        self._empty = empty

    @abstractmethod
    def item_line(self, item: T) -> str:
        """Return the line of an item, rendered with `ink.INK`."""

    def key_of(self, item: T) -> object:
        """Return a value that identifies the item; None if only its position identifies the item."""
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
        return self.items[self.cursor] if self.cursor < len(self.items) else None

    @property
    def count(self) -> int:
        return max(len(self.items), bool(self._empty))

    def line(self, index: int) -> str:
        if index < len(self.items):
            return self.item_line(self.items[index])
        return f"{INK.dim} {label(self._empty)}{INK.reset}"


class TextList(ItemList[str]):
    def item_line(self, item: str) -> str:
        return item
