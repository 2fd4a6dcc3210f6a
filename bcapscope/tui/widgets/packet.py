"""A frame as a tree and as bytes, side by side: moving in one lights the other."""

from __future__ import annotations

from textual.app import ComposeResult
from textual.containers import Container, Horizontal
from textual.events import Resize

from bcapscope.render.hexdump import PER_LINE
from bcapscope.render.outline import sections
from bcapscope.traffic.observation import Observation
from bcapscope.traffic.question import Question
from bcapscope.tui.widgets.fieldtree import FieldTree
from bcapscope.tui.widgets.ground import Ground
from bcapscope.tui.widgets.hexview import HexView, width_for
from bcapscope.tui.widgets.lines import Lines

_TREE_AT_LEAST = 48
"""Columns of the tree below which the bytes take half the width: eight of them a line."""


class PacketView(Horizontal, Ground):
    """Shows one frame, or the bytes that are none; its two halves are linked."""

    def compose(self) -> ComposeResult:
        """Put the two side by side; the line between them is not theirs, so that it is drawn once."""
        yield FieldTree(id="fields")
        yield Container(classes="edge")
        yield HexView(id="bytes")

    def show(self, seen: Observation | None, question: Question | None = None) -> None:
        """Show an item, or nothing.

        Args:
            seen: what to show.
            question: for a reply, the request that it answers, where that was seen.
        """
        found = () if seen is None else sections(seen, question)
        self.query_one(HexView).show(found)
        with self.prevent(Lines.Moved):
            self.query_one(FieldTree).show(found)

    def on_resize(self, event: Resize) -> None:
        """Give the bytes the columns that they need, and the rest to the tree."""
        scrollbar, edge = 1, 1
        wide = width_for(PER_LINE) + scrollbar
        fits = event.size.width - edge - wide >= _TREE_AT_LEAST
        self.query_one(HexView).styles.width = wide if fits else width_for(8) + scrollbar

    def on_field_tree_lit(self, message: FieldTree.Lit) -> None:
        """Light the bytes of the field."""
        message.stop()
        self.query_one(HexView).light(message.section, message.begin, message.end)

    def on_hex_view_at(self, message: HexView.At) -> None:
        """Go to the field of the byte and light all of its bytes."""
        message.stop()
        start, stop = self.query_one(FieldTree).light(message.section, message.offset)
        if stop:
            self.query_one(HexView).light(message.section, start, stop, follow=False)
