"""What a proxy shows: frames or calls as they come, as `decode` and `calls` write them."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from typing import TypeAlias

from bcapscope.cli.proxywishes import Form, Look
from bcapscope.render.call import CallRenderer
from bcapscope.render.call_record import CallRecordRenderer
from bcapscope.render.line import LineRenderer
from bcapscope.render.palette import Palette
from bcapscope.render.record import RecordRenderer
from bcapscope.render.tree import TreeRenderer
from bcapscope.traffic.exchange import Exchange, Settled
from bcapscope.traffic.fields import RecordKind
from bcapscope.traffic.getters import CALL_GETTERS, FRAME_GETTERS, Told
from bcapscope.traffic.handles import Thing
from bcapscope.traffic.observation import Conversation, Observation
from bcapscope.traffic.question import Questions

Lines: TypeAlias = Iterator[str | bytes]


class View:
    """Renders what is to be shown, nothing for the rest."""

    def __init__(self, look: Look, palette: Palette) -> None:
        """Take what is to be shown, and colours."""
        wanted = look.filter()
        self._questions = Questions()
        self._records = CallRecordRenderer()
        self._began = False
        self._frames: Callable[[Told], Lines] | None = None
        self._calls: Callable[[Settled, Thing | None], Lines] | None = None
        self._wants_frame: Callable[[Told], bool] = lambda told: True
        self._wants_call: Callable[[Exchange], bool] = lambda call: True
        if look.shown is RecordKind.FRAME:
            lines = LineRenderer(look.clock, palette)
            self._begin: Callable[[int], None] = lines.begin
            self._frames = _frame_form(look.form, lines, palette)
            if wanted is not None:
                self._wants_frame = wanted.bind(FRAME_GETTERS)
        elif look.shown is RecordKind.CALL:
            calls = CallRenderer(look.clock, palette)
            self._begin = calls.begin
            self._calls = _call_form(look.form, calls, self._records)
            if wanted is not None:
                self._wants_call = wanted.bind(CALL_GETTERS)
        self._chooses_calls = wanted is not None or look.form is Form.JSON

    def forget(self, conversation: Conversation) -> None:
        """Forget a client that has gone."""
        self._questions.forget(conversation)
        self._records.forget(conversation)

    def frame(self, seen: Observation, note: str) -> Sequence[str | bytes]:
        """Return the lines of a frame.

        Args:
            seen: the frame.
            note: what a rule did to it.
        """
        if not self._began and (self._frames is not None or self._calls is not None):
            self._began = True
            self._begin(seen.time)
        if self._frames is None:
            return ()
        told = Told(seen, self._questions.about(seen), (note,) if note else ())
        return list(self._frames(told)) if self._wants_frame(told) else ()

    def call(self, settled: Settled, subject: Thing | None) -> Sequence[str | bytes]:
        """Return the lines of a call, or of a reply that belongs to none."""
        if self._calls is None:
            return ()
        chosen = self._wants_call(settled) if isinstance(settled, Exchange) else not self._chooses_calls
        return list(self._calls(settled, subject)) if chosen else ()


def _frame_form(form: Form, line: LineRenderer, palette: Palette) -> Callable[[Told], Lines]:
    if form is Form.JSON:
        record = RecordRenderer().record
        return lambda told: iter((record(*told),))
    if form is Form.LINE:
        return lambda told: iter((line.line(*told),))
    tree = TreeRenderer(palette, False, False).lines

    def lines(told: Told) -> Iterator[str]:
        yield line.line(*told)
        for detail in tree(told.seen, told.question):
            yield f"       {detail}"
        yield ""

    return lines


def _call_form(
    form: Form, renderer: CallRenderer, records: CallRecordRenderer
) -> Callable[[Settled, Thing | None], Lines]:
    if form is Form.TREE:
        return renderer.tree
    if form is Form.LINE:
        return lambda settled, subject: iter((renderer.line(settled, subject),))
    record = records.record

    def lines(settled: Settled, subject: Thing | None) -> Iterator[bytes]:
        if isinstance(settled, Exchange):
            yield record(settled, subject)

    return lines
