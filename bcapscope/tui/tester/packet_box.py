"""SendData or ReceiveData: packets in hex with offsets, their fields beside them."""

from __future__ import annotations

from typing import ClassVar

from textual.app import ComposeResult
from textual.binding import Binding, BindingType
from textual.containers import Vertical

from bcapscope.protocol.codec.frame import Frame
from bcapscope.traffic.call_kind import CallKind
from bcapscope.traffic.observation import Observation
from bcapscope.tui.ink import INK
from bcapscope.tui.widgets.inked_text import InkedText
from bcapscope.tui.widgets.packet_view import PacketView
from bcapscope.tui.words import say

MAX_PACKETS = 2000
MAX_BYTES = 16 << 20
"""Packets that are kept where they are not overwritten; the oldest go first."""


class PacketBox(Vertical):
    """Shows one packet of those it has; ``[`` and ``]`` go to the ones before and after."""

    BINDINGS: ClassVar[list[BindingType]] = [
        Binding(
            "left_square_bracket", "step(-1)", "tester.packet.before", id="packet.before", key_display="["
        ),
        Binding("right_square_bracket", "step(1)", "tester.packet.after", id="packet.after", key_display="]"),
    ]

    def __init__(self, name: str, *, id: str | None = None) -> None:
        """Take the key of its title in the catalogue of words."""
        super().__init__(id=id)
        self._title = name
        self._packets: list[tuple[Observation, CallKind | None]] = []
        self._index = 0

    def compose(self) -> ComposeResult:
        """Put the title above the packet."""
        yield InkedText(classes="title")
        yield PacketView()

    def on_mount(self) -> None:
        """Show that there is nothing yet."""
        self._show_packet()

    @property
    def shown_packet(self) -> Observation | None:
        """The packet that is in sight."""
        return self._packets[self._index][0] if self._packets else None

    def clear_packets(self) -> None:
        """Forget all."""
        self._packets = []
        self._index = 0
        self._show_packet()

    def add_packets(
        self, packets: tuple[Observation, ...], question: CallKind | None, overwrite: bool, show_first: bool
    ) -> None:
        """Take packets and show one of them.

        Args:
            packets: in the order of their times.
            question: what they ask or answer.
            overwrite: forget those before.
            show_first: show the first of them, else the last.
        """
        if overwrite:
            self._packets = []
        self._packets += [(seen, question) for seen in packets]
        del self._packets[:-MAX_PACKETS]
        while sum(len(seen.item.raw) for seen, _ in self._packets) > MAX_BYTES and len(self._packets) > 1:
            del self._packets[: len(self._packets) // 10 or 1]
        self._index = max(0, len(self._packets) - (len(packets) if show_first else 1))
        self._show_packet()

    def action_step(self, by: int) -> None:
        """Go to the packet before or after."""
        if 0 <= self._index + by < len(self._packets):
            self._index += by
            self._show_packet()

    def _show_packet(self) -> None:
        seen, question = self._packets[self._index] if self._packets else (None, None)
        self.query_one(PacketView).show_packet(seen, question)
        self._show_title()

    def _show_title(self) -> None:
        text = f"{INK.name}{say(self._title)}{INK.reset}"
        if self._packets:
            item = self._packets[self._index][0].item
            text += f"  {INK.dim}{say('tester.size', count=len(item.raw))}"
            if isinstance(item, Frame):
                text += f"  serial {item.serial}  reserved {item.reserved}"
            if len(self._packets) > 1:
                text += f"  [{self._index + 1}/{len(self._packets)}]"
            text += INK.reset
        self.query_one(".title", InkedText).show_text(text)
