"""Shows a frame as a tree and as bytes, side by side; the cursor of one is highlighted in the other."""

from __future__ import annotations

from textual.app import ComposeResult
from textual.containers import Container, Horizontal
from textual.events import Resize

from bcapscope.render.frame_outline import frame_sections
from bcapscope.render.hexdump import PER_LINE
from bcapscope.traffic.call_kind import CallKind
from bcapscope.traffic.observation import Observation
from bcapscope.tui.widgets.field_tree import FieldTree
from bcapscope.tui.widgets.hex_view import HexView, width_for
from bcapscope.tui.widgets.lines import Lines
from bcapscope.tui.widgets.plain_containers import PlainContainer

_TREE_AT_LEAST = 48
"""Minimum width of the tree in columns, beside bytes of full width.

On a narrower screen, the bytes take half their width: eight bytes per line.
"""


class PacketView(Horizontal, PlainContainer):
    """Shows one frame, or bytes that are not a frame, in two linked halves."""

    def compose(self) -> ComposeResult:
        """Put the tree and the bytes side by side.

        The line between the halves is a separate widget, so that Textual draws it only once.
        """
        yield FieldTree(id="fields")
        yield Container(classes="edge")
        yield HexView(id="bytes")

    def show_packet(self, observation: Observation | None, question: CallKind | None = None) -> None:
        """Show an observation, or nothing; `question` is the kind of the call if the frame is a reply."""
        found = () if observation is None else frame_sections(observation, question)
        self.query_one(HexView).show_sections(found)
        with self.prevent(Lines.Moved):
            self.query_one(FieldTree).show_sections(found)

    def on_resize(self, event: Resize) -> None:
        """Give the bytes the columns that they need, and give the tree the rest."""
        scrollbar, edge = 1, 1
        wide = width_for(PER_LINE) + scrollbar
        fits = event.size.width - edge - wide >= _TREE_AT_LEAST
        self.query_one(HexView).styles.width = wide if fits else width_for(8) + scrollbar

    def on_field_tree_field_selected(self, message: FieldTree.FieldSelected) -> None:
        self.query_one(HexView).highlight_bytes(message.section, message.begin, message.end)

    def on_hex_view_byte_selected(self, message: HexView.ByteSelected) -> None:
        """Select the field that contains the byte under the cursor, and highlight the bytes of that field."""
        start, stop = self.query_one(FieldTree).select_field_at(message.section, message.offset)
        if stop:
            self.query_one(HexView).highlight_bytes(message.section, start, stop, follow=False)
