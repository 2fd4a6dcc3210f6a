"""Mark the reported problems that concern selected calls."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from dataclasses import replace
from itertools import chain

from bcapscope.analysis.rules.rule_checker import Occurrence, OccurrenceSink, call_observations
from bcapscope.protocol.codec.frame import Frame
from bcapscope.traffic.call import Call, StrayReply
from bcapscope.traffic.observation import Observation


class CallSelection:
    """Marks each reported problem as selected or not, then passes the problem to `report_occurrence`.

    A problem is selected if a selected call contains one of the problem's frames. Rules may report a problem
    of a frame before the frame's call is complete. `CallSelection` stores this problem until the call is
    complete, because `is_selected` tests only complete calls.
    """

    def __init__(self, is_selected: Callable[[Call], bool], report_occurrence: OccurrenceSink) -> None:
        self.selected_calls = 0
        self._is_selected = is_selected
        self._report_occurrence = report_occurrence
        self._selected_frames = bytearray()  # one bit per frame
        self._unsettled_frame: int | None = None
        self._held_occurrences: dict[int, list[Occurrence]] = {}

    def on_frame(self, observation: Observation) -> None:
        self._unsettled_frame = observation.number if isinstance(observation.item, Frame) else None

    def on_call(self, call: Call) -> None:
        """Test whether a completed call is selected. Call this method before the rules check the call."""
        self._unsettled_frame = None
        frames = [seen.number for seen in call_observations(call)]
        if self._is_selected(call):
            self.selected_calls += 1
            for frame in frames:
                self._select_frame(frame)
        if self._held_occurrences:
            for frame in frames:
                self._release_frame(frame)

    def on_stray_reply(self, stray: StrayReply) -> None:
        """Report the stored problems of a stray reply. Call this method before the rules check the reply."""
        self._unsettled_frame = None
        self._release_frame(stray.observation.number)

    def add_occurrence(self, occurrence: Occurrence) -> None:
        if self._unsettled_frame is not None:
            self._held_occurrences.setdefault(self._unsettled_frame, []).append(occurrence)
            return
        self._report_occurrence(self._marked(occurrence))

    def provisional_occurrences(self, at_end: Iterable[Occurrence]) -> Iterator[Occurrence]:
        """Yield the stored problems and those in `at_end`. Only frames of complete calls can be selected."""
        return map(self._marked, chain(*self._held_occurrences.values(), at_end))

    def _marked(self, occurrence: Occurrence) -> Occurrence:
        return replace(occurrence, selected=any(map(self._is_frame_selected, occurrence.frames)))

    def _release_frame(self, frame: int) -> None:
        for occurrence in self._held_occurrences.pop(frame, ()):
            self.add_occurrence(occurrence)

    def _select_frame(self, frame: int) -> None:
        byte, bit = divmod(frame, 8)
        if byte >= len(self._selected_frames):
            self._selected_frames.extend(bytes(byte + 1 - len(self._selected_frames)))
        self._selected_frames[byte] |= 1 << bit

    def _is_frame_selected(self, frame: int) -> bool:
        byte, bit = divmod(frame, 8)
        return byte < len(self._selected_frames) and bool(self._selected_frames[byte] >> bit & 1)
