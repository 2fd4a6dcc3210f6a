"""Base class of the lists of frames and of calls: the filter, the format of times, the client."""

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
    """Return an arrow for the direction of a frame, without the client, for traffic of a single client."""
    return "→" if flow.direction is Direction.REQUEST else "←"


def client_and_arrow(flow: Flow) -> str:
    return f"{printable(str(flow.conversation.client))[:_MAX_CLIENT_LENGTH]:<21} {direction_arrow(flow)}"


class RecordList(Lines):
    """Shows all records, or the records that match a filter, as far as the search has found them.

    Attributes:
        clock: Format of the times in the lines.
        matches: Numbers, from 1, of the records that match the filter; None without a filter.
    """

    def __init__(self, *, id: str | None = None) -> None:
        super().__init__(id=id)
        self.matches: array[int] | None = None
        self.clock, self._shows_client, self._origin = TimeFormat.RELATIVE, False, 0
        self.use_format(self.clock, direction_arrow, 0)

    @abstractmethod
    def use_format(self, clock: TimeFormat, write_endpoints: EndpointWriter, origin: int) -> None:
        """From now on, render lines in the given format; `origin` is the zero of relative times."""

    def set_line_format(self, clock: TimeFormat, with_client: bool, origin: int) -> None:
        """Set the format of times, the zero of relative times, and whether lines show the client."""
        if (clock, with_client, origin) != (self.clock, self._shows_client, self._origin):
            self.clock, self._shows_client, self._origin = clock, with_client, origin
            self.use_format(clock, client_and_arrow if with_client else direction_arrow, origin)
            self.repaint()

    @property
    def client_header(self) -> str:
        """Header of the columns for client and arrow; "" if lines do not show the client."""
        return f"{left_aligned(label('traffic.head.client'), 21)}   " if self._shows_client else ""

    def row_count(self, total: int) -> int:
        """Return the number of rows: the number of matches, or `total` without a filter."""
        return total if self.matches is None else len(self.matches)

    def record_at(self, row: int) -> int:
        """Return the number, from 1, of the record that a row shows."""
        return row + 1 if self.matches is None else self.matches[row]

    def row_of(self, number: int) -> int | None:
        """Return the row that shows a record; None if the filter hides the record."""
        row = self.nearest_row(number)
        return row if self.matches is None or number in self.matches[row : row + 1] else None

    def nearest_row(self, number: int) -> int:
        """Return the row of a record; if the filter hides it, the row of the next record that is shown."""
        return number - 1 if self.matches is None else bisect_left(self.matches, number)


def left_aligned(text: str, width: int) -> str:
    """Left-align a text in a column; a wide character counts as two columns."""
    return text + " " * max(0, width - display_width(text))


def right_aligned(text: str, width: int) -> str:
    """Right-align a text in a column; a wide character counts as two columns."""
    return " " * max(0, width - display_width(text)) + text
