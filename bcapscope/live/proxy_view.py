"""What a proxy displays: frames or calls as they arrive, formatted as by `decode` and `calls`."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from typing import TypeAlias

from bcapscope.live.proxy_options import TrafficFormat, ViewOptions
from bcapscope.messages import ENGLISH_WORDS, Message, MessageFormatter
from bcapscope.messages.places import Count
from bcapscope.render.call_record import CallRecordRenderer
from bcapscope.render.call_text import CallRenderer
from bcapscope.render.color_palette import Palette
from bcapscope.render.frame_line import FrameLineRenderer
from bcapscope.render.frame_record import FrameRecordRenderer
from bcapscope.render.frame_tree import FrameTreeRenderer
from bcapscope.traffic.call import Call, PairingResult, StrayReply
from bcapscope.traffic.call_kind import RecentRequests
from bcapscope.traffic.filter.field_table import RecordKind
from bcapscope.traffic.filter.getters import CALL_GETTERS, FRAME_GETTERS, AnnotatedFrame
from bcapscope.traffic.handle_tracker import TrackedObject
from bcapscope.traffic.observation import Conversation, Observation
from bcapscope.traffic.pipeline import PipelineSubscriber

RenderedLines: TypeAlias = Iterator[str | bytes]


class ProxyView:
    """Renders the frames or calls that the options choose."""

    def __init__(self, options: ViewOptions, palette: Palette) -> None:
        """Prepare the renderers and the filter that the options call for."""
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
        self._note_words = ENGLISH_WORDS if options.form is TrafficFormat.JSON else words
        self._chooses_calls = wanted is not None or options.form is TrafficFormat.JSON

    def drop_conversation(self, conversation: Conversation) -> None:
        """Forget a client that is gone."""
        self._questions.close_conversation(conversation)
        self._records.drop_conversation(conversation)

    def frame_lines(self, observation: Observation, note: Message | None) -> Sequence[str | bytes]:
        """Return the lines of a frame, () if it is not displayed.

        Args:
            observation: The frame.
            note: What a rule did to it; None for nothing.
        """
        if not self._has_begun and (self._frame_renderer is not None or self._call_renderer is not None):
            self._has_begun = True
            self._set_time_origin(observation.time)
        if self._frame_renderer is None:
            return ()
        comments = () if note is None else (self._note_words.text(note),)
        told = AnnotatedFrame(observation, self._questions.kind_of(observation), comments)
        return list(self._frame_renderer(told)) if self._wants_frame(told) else ()

    def call_lines(self, settled: PairingResult, subject: TrackedObject | None) -> Sequence[str | bytes]:
        """Return the lines of a call or of a stray reply, () if it is not displayed."""
        if self._call_renderer is None:
            return ()
        chosen = self._wants_call(settled) if isinstance(settled, Call) else not self._chooses_calls
        return list(self._call_renderer(settled, subject)) if chosen else ()


class TrafficDisplay(PipelineSubscriber):
    """Renders the traffic as the options say, and counts the calls.

    Attributes:
        lines: Lines that wait to be displayed.
    """

    needs_targets = True

    def __init__(self, view: ProxyView) -> None:
        self.lines: list[str | bytes] = []
        self._calls = self._retries = 0
        self._view = view

    def add_frame(self, observation: Observation, note: Message | None) -> None:
        """Render a frame; `note` says what a rule did to it."""
        self.lines += self._view.frame_lines(observation, note)

    @property
    def counts(self) -> Message:
        """How many calls and retries there were."""
        return Message("relay.calls", calls=Count(self._calls, "call"), retries=Count(self._retries, "retry"))

    def on_call(self, call: Call, target: TrackedObject | None) -> None:
        self._calls += 1
        self._retries += call.retries
        self.lines += self._view.call_lines(call, target)

    def on_stray_reply(self, stray: StrayReply) -> None:
        self.lines += self._view.call_lines(stray, None)

    def on_conversation_closed(self, conversation: Conversation) -> None:
        self._view.drop_conversation(conversation)


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
