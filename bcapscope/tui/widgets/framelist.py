"""Frames of a journal, one a line; any of a million is at hand."""

from __future__ import annotations

from array import array
from bisect import bisect_left
from collections.abc import Collection, Mapping

from bcapscope.capture.journal import Journal
from bcapscope.protocol.wording import display_width
from bcapscope.render.escape import printable
from bcapscope.render.line import LineRenderer
from bcapscope.render.moment import Clock
from bcapscope.traffic.getters import Told
from bcapscope.traffic.observation import Direction, Flow
from bcapscope.tui.ink import INK
from bcapscope.tui.widgets.lines import Lines
from bcapscope.tui.words import say, told

MARKED, RELATED, PROOF = "●", "┃", "◆"
"""Before a frame: it was marked, it belongs to the call under the cursor, it proves the finding chosen."""

_LONGEST_CLIENT = 45


def arrow(flow: Flow) -> str:
    """Tell who spoke, where there is one client only."""
    return "→" if flow.direction is Direction.REQUEST else "←"


def client_and_arrow(flow: Flow) -> str:
    """Tell who spoke, and which client it is."""
    return f"{printable(str(flow.conversation.client))[:_LONGEST_CLIENT]:<21} {arrow(flow)}"


class Rows:
    """Which rows of a source are shown: all, or those that a filter let pass, as they are found."""

    def __init__(self) -> None:
        self.found: array[int] | None = None

    def count(self, there: int) -> int:
        """Say how many are shown of those that are there."""
        return there if self.found is None else len(self.found)

    def number(self, index: int) -> int:
        """Return the number, from 1, of the row that is shown at an index."""
        return index + 1 if self.found is None else self.found[index]

    def index(self, number: int) -> int | None:
        """Tell at which index a row is shown; None where it is not."""
        if self.found is None:
            return number - 1
        at = bisect_left(self.found, number)
        return at if at < len(self.found) and self.found[at] == number else None

    def nearest(self, number: int) -> int:
        """Tell at which index a row is shown, or the next one after it that is."""
        return number - 1 if self.found is None else bisect_left(self.found, number)


class FrameList(Lines):
    """Shows frames; `open` gives it a journal.

    Attributes:
        rows: which of them are shown.
        marks: notes by number of the frame; "" for a frame that is only marked.
        related: numbers of the frames of the call that the cursor is on.
        proofs: numbers of the frames that prove the finding chosen.
    """

    def __init__(self, *, id: str | None = None) -> None:
        super().__init__(id=id)
        self.rows = Rows()
        self.marks: dict[int, str] = {}
        self.related: Collection[int] = ()
        self.proofs: Collection[int] = ()
        self._journal: Journal | None = None
        self._clock = Clock.RELATIVE
        self._with_client = False
        self._live = False
        self._timed = False
        self._renderer = LineRenderer(palette=INK, ends=arrow, tongue=told)

    def open(self, journal: Journal, live: bool) -> None:
        """Show a journal; a `live` one from its end."""
        self._journal = journal
        self._live = live

    def forget(self) -> None:
        """Show nothing, until another journal is opened."""
        self.rows, self.marks, self.related, self.proofs = Rows(), {}, (), ()
        self._journal, self._timed = None, False
        self.changed()

    def look(self, clock: Clock, with_client: bool) -> None:
        """Choose how the time is told and whether each line names the client."""
        if (clock, with_client) == (self._clock, self._with_client):
            return
        self._clock, self._with_client = clock, with_client
        self._renderer = self._new_renderer()
        self.repaint()

    def _new_renderer(self) -> LineRenderer:
        ends = client_and_arrow if self._with_client else arrow
        renderer = LineRenderer(self._clock, INK, ends=ends, tongue=told)
        if self._clock is Clock.RELATIVE and self._journal is not None and len(self._journal):
            renderer.begin(self._journal.time(1))
        return renderer

    @property
    def follows(self) -> bool:
        """Live traffic is followed as long as the cursor is on the last line."""
        return self._live

    @property
    def count(self) -> int:
        """How many frames are shown."""
        return self.rows.count(len(self._journal)) if self._journal is not None else 0

    @property
    def number(self) -> int | None:
        """Number of the frame that the cursor is on."""
        return self.rows.number(self.cursor) if self.cursor < self.count else None

    def told(self, number: int) -> Told:
        """Read a frame."""
        assert self._journal is not None
        return self._journal.told(number)

    def grown(self) -> None:
        """Show that there are more; the first one tells from when times count."""
        if not self._timed and self._clock is Clock.RELATIVE and self.count:
            self._timed = True
            self._renderer = self._new_renderer()
        super().grown()

    def line(self, index: int) -> str:
        """Write a frame's line, with what is special about it before it."""
        number = self.rows.number(index)
        if self._clock is Clock.DELTA and index and self._journal is not None:
            self._renderer.begin(self._journal.time(self.rows.number(index - 1)))
        seen, question, comments = self.told(number)
        comments = tuple(map(told, comments))
        note = self.marks.get(number)
        if note:
            comments = (*comments, note)
        return f"{self._gutter(number)}{self._renderer.line(seen, question, comments)}"

    def sign(self, index: int) -> str:
        """A line changes with what stands before it."""
        return self._gutter(self.rows.number(index))

    def _gutter(self, number: int) -> str:
        mark = f"{INK.problem}{MARKED}{INK.reset}" if number in self.marks else " "
        if number in self.proofs:
            return f"{mark}{INK.bad}{PROOF}{INK.reset}"
        return f"{mark}{INK.good}{RELATED}{INK.reset}" if number in self.related else f"{mark} "

    def relate(self, related: Collection[int]) -> None:
        """Show other frames as belonging to the call under the cursor."""
        if related != self.related:
            changed = [self.rows.index(number) for number in {*related, *self.related}]
            self.related = related
            self.redraw(*(index for index in changed if index is not None))

    def head(self) -> str:
        """Write what stands above the columns."""
        time = {Clock.UTC: 30, Clock.EPOCH: 20}.get(self._clock, 12)
        client = f"{left(say('traffic.head.client'), 21)}   " if self._with_client else "  "
        words: Mapping[str, str] = {
            name: say(f"traffic.head.{name}") for name in ("number", "time", "serial", "reserved", "what")
        }
        return (
            f"  {right(words['number'], 6)} {right(words['time'], time)} {client}"
            f"{right(words['serial'], 5)} {right(words['reserved'], 5)}  {words['what']}"
        )


def left(text: str, width: int) -> str:
    """Set a text to the left of a column; wide characters take two."""
    return text + " " * max(0, width - display_width(text))


def right(text: str, width: int) -> str:
    """Set a text to the right of a column; wide characters take two."""
    return " " * max(0, width - display_width(text)) + text
