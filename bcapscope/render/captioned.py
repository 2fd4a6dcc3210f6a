"""Text sections in the reader's language: a caption at the left, its text at the right."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass

from bcapscope.messages import Message, MessageFormatter
from bcapscope.messages.message import PlaceValue
from bcapscope.messages.places import FramePlace
from bcapscope.protocol.text_format import display_width
from bcapscope.render.color_palette import Palette
from bcapscope.render.columns import align_columns, wrap_text
from bcapscope.render.escape import printable

CAPTION_WIDTH = 12
TEXT_WIDTH = 62
"""Width of the wrapped text to the right of a caption. With caption and scroll bar, a line fits into 80
columns."""

_FRAMES_SHOWN = 8


@dataclass(frozen=True, slots=True)
class CaptionWriter:
    palette: Palette
    words: MessageFormatter

    def text(self, text: Message | str) -> str:
        """Return a message as escaped text. A string must be escaped already."""
        return printable(self.words.text(text)) if isinstance(text, Message) else text

    def label(self, id: str, /, **places: PlaceValue) -> str:
        """Return the escaped text of the message with this id."""
        return self.text(Message(id, **places))

    def joined(self, messages: Iterable[Message]) -> str:
        return self.words("list.comma").join(map(self.text, messages))

    def captioned(self, caption: str, text: Message | str) -> str:
        """Return a line that begins with the caption `slave.caption.<caption>`."""
        name = self.label(f"slave.caption.{caption}")
        space = " " * (CAPTION_WIDTH - display_width(name))
        return f"  {self.palette.dim}{name}{space}{self.palette.reset}{self.text(text)}".rstrip()

    def continued(self, text: Message | str) -> str:
        """Return a line without a caption, for more text that belongs to the caption above."""
        return f"  {'':<{CAPTION_WIDTH}}{self.text(text)}"

    def wrapped(self, text: Message | str, color: str = "") -> Iterator[str]:
        """Yield more text for the caption above. Each line has the colour `color` and at most `TEXT_WIDTH`
        columns.
        """
        reset = self.palette.reset if color else ""
        return (self.continued(f"{color}{line}{reset}") for line in wrap_text(self.text(text), TEXT_WIDTH))

    def table(self, rows: Sequence[Sequence[str]], alignments: str, head_rows: int = 1) -> Iterator[str]:
        """Yield the lines of a table; the first `head_rows` lines are dim."""
        for number, line in enumerate(align_columns(rows, alignments)):
            is_head = number < head_rows
            yield f"  {self.palette.dim}{line}{self.palette.reset}" if is_head else f"  {line}"


def frames_message(frames: Sequence[int], count: int | None = None) -> Message:
    """Return a message that lists the first 8 frame numbers. The message also says how many of the `count`
    frames it does not list.
    """
    shown = tuple(frames[:_FRAMES_SHOWN])
    left = (len(frames) if count is None else count) - len(shown)
    if left:
        return Message("frames.more", frames=FramePlace(shown), more=left)
    return Message("frames.one" if len(shown) == 1 else "frames.several", frames=FramePlace(shown))
