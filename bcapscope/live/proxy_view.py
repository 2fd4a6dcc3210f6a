"""What a proxy displays: frames or calls as they arrive, formatted as by `decode` and `calls`."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from typing import TypeAlias

from bcapscope.live.proxy_options import TrafficFormat, ViewOptions
from bcapscope.messages import MessageFormatter
from bcapscope.render.call_record import CallRecordRenderer
from bcapscope.render.call_text import CallRenderer
from bcapscope.render.color_palette import Palette
from bcapscope.render.frame_line import FrameLineRenderer
from bcapscope.render.frame_record import FrameRecordRenderer
from bcapscope.render.frame_tree import FrameTreeRenderer
from bcapscope.traffic.call import Call, PairingResult
from bcapscope.traffic.call_kind import RecentRequests
from bcapscope.traffic.filter.field_table import RecordKind
from bcapscope.traffic.filter.getters import CALL_GETTERS, FRAME_GETTERS, AnnotatedFrame
from bcapscope.traffic.handle_tracker import TrackedObject
from bcapscope.traffic.observation import Conversation, Observation

RenderedLines: TypeAlias = Iterator[str | bytes]


class ProxyView:
    """Renders the frames or calls that the options choose."""

    def __init__(self, options: ViewOptions, palette: Palette) -> None:
        wanted, words = options.compiled_filter(), MessageFormatter(options.language)
        self._questions = RecentRequests()
        self._records = CallRecordRenderer()
        self._has_begun = False
        self._frame_renderer: Callable[[AnnotatedFrame], RenderedLines] | None = None
        self._call_renderer: Callable[[PairingResult, TrackedObject | None], RenderedLines] | None = None
        self._wants_frame: Callable[[AnnotatedFrame], bool] = lambda told: True
        self._wants_call: Callable[[Call], bool] = lambda call: True
        if options.shown is RecordKind.FRAME:
            lines = FrameLineRenderer(options.time_format, palette, words=words)
            self._set_time_origin: Callable[[int], None] = lines.set_time_origin
            self._frame_renderer = _frame_renderer_for(
                options.form, lines, FrameTreeRenderer(palette, words=words)
            )
            if wanted is not None:
                self._wants_frame = wanted.bind(FRAME_GETTERS)
        elif options.shown is RecordKind.CALL:
            calls = CallRenderer(options.time_format, palette, words=words)
            self._set_time_origin = calls.set_time_origin
            self._call_renderer = _call_renderer_for(options.form, calls, self._records)
            if wanted is not None:
                self._wants_call = wanted.bind(CALL_GETTERS)
        self._chooses_calls = wanted is not None or options.form is TrafficFormat.JSON

    def drop_conversation(self, conversation: Conversation) -> None:
        self._questions.close_conversation(conversation)
        self._records.drop_conversation(conversation)

    def frame_lines(self, observation: Observation, note: str) -> Sequence[str | bytes]:
        """Return the lines of a frame, () if it is not displayed. `note` says what a rule did to it; "" for
        nothing.
        """
        if not self._has_begun and (self._frame_renderer is not None or self._call_renderer is not None):
            self._has_begun = True
            self._set_time_origin(observation.time)
        if self._frame_renderer is None:
            return ()
        told = AnnotatedFrame(observation, self._questions.kind_of(observation), (note,) if note else ())
        return list(self._frame_renderer(told)) if self._wants_frame(told) else ()

    def call_lines(self, settled: PairingResult, subject: TrackedObject | None) -> Sequence[str | bytes]:
        """Return the lines of a call or of a stray reply, () if it is not displayed."""
        if self._call_renderer is None:
            return ()
        chosen = self._wants_call(settled) if isinstance(settled, Call) else not self._chooses_calls
        return list(self._call_renderer(settled, subject)) if chosen else ()


def _frame_renderer_for(
    form: TrafficFormat, line: FrameLineRenderer, tree: FrameTreeRenderer
) -> Callable[[AnnotatedFrame], RenderedLines]:
    if form is TrafficFormat.JSON:
        record = FrameRecordRenderer().record
        return lambda told: iter((record(*told),))
    if form is TrafficFormat.LINE:
        return lambda told: iter((line.line(*told),))

    def lines(told: AnnotatedFrame) -> Iterator[str]:
        yield line.line(*told)
        for detail in tree.lines(told.observation, told.call_kind):
            yield f"       {detail}"
        yield ""

    return lines


def _call_renderer_for(
    form: TrafficFormat, renderer: CallRenderer, records: CallRecordRenderer
) -> Callable[[PairingResult, TrackedObject | None], RenderedLines]:
    if form is TrafficFormat.TREE:
        return renderer.tree
    if form is TrafficFormat.LINE:
        return lambda settled, subject: iter((renderer.line(settled, subject),))
    record = records.record

    def lines(settled: PairingResult, subject: TrackedObject | None) -> Iterator[bytes]:
        if isinstance(settled, Call):
            yield record(settled, subject)

    return lines
