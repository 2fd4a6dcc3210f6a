"""The box SendData or ReceiveData: packets in hex with offsets, and beside them their fields."""

from __future__ import annotations

from typing import ClassVar

from textual.app import ComposeResult
from textual.binding import Binding, BindingType
from textual.containers import Vertical

from bcapscope.protocol.codec.frame import Frame
from bcapscope.traffic.call_kind import CallKind
from bcapscope.traffic.observation import Observation
from bcapscope.tui.ink import INK
from bcapscope.tui.reader_language import label
from bcapscope.tui.widgets.inked_text import InkedText
from bcapscope.tui.widgets.packet_view import PacketView

MAX_PACKETS = 2000
MAX_BYTES = 16 << 20
"""Maximum size in bytes of the packets in a box while Overwrite is off; the oldest are dropped first."""


class PacketBox(Vertical):
    """Shows one of its packets at a time; the keys ``[`` and ``]`` show the previous and the next packet."""

    BINDINGS: ClassVar[list[BindingType]] = [
        Binding("left_square_bracket", "step(-1)", "tester.packet.before", key_display="["),
        Binding("right_square_bracket", "step(1)", "tester.packet.after", key_display="]"),
    ]

    def __init__(self, name: str, *, id: str | None = None) -> None:
        super().__init__(id=id)
        self._title = name
        self._packets: list[tuple[Observation, CallKind | None]] = []
        self._index = 0

    def compose(self) -> ComposeResult:
        yield InkedText(classes="title")
        yield PacketView()

    def on_mount(self) -> None:
        self._show_packet()

    @property
    def shown_packet(self) -> Observation | None:
        return self._packets[self._index][0] if self._packets else None

    def clear_packets(self) -> None:
        self._packets = []
        self._index = 0
        self._show_packet()

    def add_packets(
        self, packets: tuple[Observation, ...], question: CallKind | None, overwrite: bool, show_first: bool
    ) -> None:
        """Add packets; show the first new packet if `show_first` is set, else the last."""
        if overwrite:
            self._packets = []
        self._packets += [(seen, question) for seen in packets]
        del self._packets[:-MAX_PACKETS]
        while sum(len(seen.item.raw) for seen, _ in self._packets) > MAX_BYTES and len(self._packets) > 1:
            del self._packets[: len(self._packets) // 10 or 1]
        self._index = max(0, len(self._packets) - (len(packets) if show_first else 1))
        self._show_packet()

    def action_step(self, by: int) -> None:
        if 0 <= self._index + by < len(self._packets):
            self._index += by
            self._show_packet()

    def _show_packet(self) -> None:
        seen, question = self._packets[self._index] if self._packets else (None, None)
        self.query_one(PacketView).show_packet(seen, question)
        self._show_title()

    def _show_title(self) -> None:
        text = f"{INK.name}{label(self._title)}{INK.reset}"
        if self._packets:
            item = self._packets[self._index][0].item
            text += f"  {INK.dim}{label('tester.size', count=len(item.raw))}"
            if isinstance(item, Frame):
                text += f"  serial {item.serial}  reserved {item.reserved}"
            if len(self._packets) > 1:
                text += f"  [{self._index + 1}/{len(self._packets)}]"
            text += INK.reset
        self.query_one(".title", InkedText).show_text(text)
