"""What the lists of frames and of calls share: the filter, the format of times, the client."""

from __future__ import annotations

from abc import abstractmethod
from array import array
from bisect import bisect_left
from collections.abc import Callable
from typing import TypeAlias

from bcapscope.protocol.text_format import display_width
from bcapscope.render.escape import printable
from bcapscope.render.timestamp import TimeFormat
from bcapscope.traffic.observation import Direction, Flow
from bcapscope.tui.reader_language import label
from bcapscope.tui.widgets.lines import Lines

EndpointWriter: TypeAlias = Callable[[Flow], str]

_MAX_CLIENT_LENGTH = 45


def direction_arrow(flow: Flow) -> str:
    """Return an arrow for the direction of a frame, for traffic of a single client."""
    return "→" if flow.direction is Direction.REQUEST else "←"


def client_and_arrow(flow: Flow) -> str:
    return f"{printable(str(flow.conversation.client))[:_MAX_CLIENT_LENGTH]:<21} {direction_arrow(flow)}"


class RecordList(Lines):
    """Shows records, all of them or the matches of a filter found so far.

    Attributes:
        clock: Format of times.
        matches: Numbers, from 1, of the records that match; None without a filter.
    """

    def __init__(self, *, id: str | None = None) -> None:
        super().__init__(id=id)
        self.matches: array[int] | None = None
        self.clock, self._shows_client, self._origin = TimeFormat.RELATIVE, False, 0
        self.use_format(self.clock, direction_arrow, 0)

    @abstractmethod
    def use_format(self, clock: TimeFormat, write_endpoints: EndpointWriter, origin: int) -> None:
        """Render lines in another format from now on; relative times count from `origin`."""

    def set_line_format(self, clock: TimeFormat, with_client: bool, origin: int) -> None:
        """Set the time format, the origin of relative times, and whether lines show the client."""
        if (clock, with_client, origin) != (self.clock, self._shows_client, self._origin):
            self.clock, self._shows_client, self._origin = clock, with_client, origin
            self.use_format(clock, client_and_arrow if with_client else direction_arrow, origin)
            self.repaint()

    @property
    def client_header(self) -> str:
        """Header of the client, if lines show it, and of the arrow."""
        return f"{left_aligned(label('traffic.head.client'), 21)}   " if self._shows_client else ""

    def row_count(self, total: int) -> int:
        """Return the number of rows for all records or the matches, out of `total` records."""
        return total if self.matches is None else len(self.matches)

    def record_at(self, row: int) -> int:
        """Return the number, from 1, of the record at a row."""
        return row + 1 if self.matches is None else self.matches[row]

    def row_of(self, number: int) -> int | None:
        """Return the row of a record; None if it is not shown."""
        row = self.nearest_row(number)
        return row if self.matches is None or number in self.matches[row : row + 1] else None

    def nearest_row(self, number: int) -> int:
        """Return the row of a record, or of the next shown one after it."""
        return number - 1 if self.matches is None else bisect_left(self.matches, number)


def left_aligned(text: str, width: int) -> str:
    """Left-align a text in a column; wide characters count two."""
    return text + " " * max(0, width - display_width(text))


def right_aligned(text: str, width: int) -> str:
    """Right-align a text in a column; wide characters count two."""
    return " " * max(0, width - display_width(text)) + text
