"""The lines that a proxy displays: frames or calls as they arrive, in the format of `decode` and `calls`."""

from __future__ import annotations

from collections.abc import Callable

from bcapscope.live.proxy_options import TrafficFormat, ViewOptions
from bcapscope.messages import ENGLISH_WORDS, Message, MessageFormatter
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


class ProxyView(PipelineSubscriber):
    """Appends the lines of the selected frames or calls to `lines`, and counts the completed calls."""

    needs_targets = True

    def __init__(self, options: ViewOptions, palette: Palette) -> None:
        wanted, words = options.compiled_filter(), MessageFormatter(options.language)
        self.lines: list[str | bytes] = []
        self.call_count = self.retry_count = 0
        self._shown, self._form = options.shown, options.form
        self._selects = wanted is not None
        self._wants_frame: Callable[[AnnotatedFrame], bool] = lambda frame: True
        self._wants_call: Callable[[Call], bool] = lambda call: True
        if wanted is not None and options.shown is RecordKind.FRAME:
            self._wants_frame = wanted.bind(FRAME_GETTERS, lambda: self._first_time)
        elif wanted is not None and options.shown is RecordKind.CALL:
            self._wants_call = wanted.bind(CALL_GETTERS, lambda: self._first_time)
        self._requests = RecentRequests()
        self._note_words = ENGLISH_WORDS if options.form is TrafficFormat.JSON else words
        self._frame_lines = FrameLineRenderer(options.time_format, palette, words=words)
        self._frame_trees = FrameTreeRenderer(palette, words=words)
        self._frame_records = FrameRecordRenderer()
        self._call_lines = CallRenderer(options.time_format, palette, words=words)
        self._call_records = CallRecordRenderer()
        self._first_time = 0

    def add_frame(self, observation: Observation, note: Message | None) -> None:
        """Render a frame. `note` says how the proxy's rules affected the frame; None if no rule did."""
        if not self._first_time:
            self._first_time = observation.time
            self._frame_lines.set_time_origin(observation.time)
            self._call_lines.set_time_origin(observation.time)
        if self._shown is not RecordKind.FRAME:
            return
        call_kind = self._requests.kind_of(observation)
        notes = () if note is None else (self._note_words.text(note),)
        if not self._wants_frame(AnnotatedFrame(observation, call_kind, notes)):
            return
        if self._form is TrafficFormat.JSON:
            self.lines.append(self._frame_records.record(observation, call_kind, notes))
            return
        self.lines.append(self._frame_lines.line(observation, call_kind, notes))
        if self._form is TrafficFormat.TREE:
            details = self._frame_trees.lines(observation, call_kind)
            self.lines += [*(f"       {detail}" for detail in details), ""]

    def on_call(self, call: Call, target: TrackedObject | None) -> None:
        self.call_count += 1
        self.retry_count += call.retries
        if self._shown is not RecordKind.CALL or not self._wants_call(call):
            return
        if self._form is TrafficFormat.JSON:
            self.lines.append(self._call_records.record(call, target))
        else:
            self._add_call_lines(call, target)

    def on_stray_reply(self, stray: StrayReply) -> None:
        if self._shown is RecordKind.CALL and self._form is not TrafficFormat.JSON and not self._selects:
            self._add_call_lines(stray, None)

    def _add_call_lines(self, settled: PairingResult, target: TrackedObject | None) -> None:
        if self._form is TrafficFormat.TREE:
            self.lines += self._call_lines.tree(settled, target)
        else:
            self.lines.append(self._call_lines.line(settled, target))

    def on_conversation_closed(self, conversation: Conversation) -> None:
        self._requests.close_conversation(conversation)
        self._call_records.drop_conversation(conversation)
