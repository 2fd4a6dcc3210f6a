"""Calls that were asked for, and which incidents concern them."""

from __future__ import annotations

from collections.abc import Callable

from bcapscope.analysis.rules.rule_checker import Occurrence, OccurrenceSink, call_observations
from bcapscope.protocol.codec.frame import Frame
from bcapscope.traffic.call import Call, PairingResult
from bcapscope.traffic.observation import Observation


class CallSelection:
    """Stands between the rules, which see all calls, and the book, which tells of some.

    A rule reasons about what was not called as well, so it has to see everything; an incident is asked for
    if one of the frames that prove it belongs to a call that was chosen. Whether a call is chosen is known
    when it settles: incidents about a frame that was only just seen wait for that.

    Attributes:
        selected_calls: that were chosen so far.
    """

    def __init__(self, is_selected: Callable[[Call], bool], report_occurrence: OccurrenceSink) -> None:
        """Begin.

        Args:
            is_selected: tells whether a call is asked for.
            report_occurrence: is given every incident, marked.
        """
        self.selected_calls = 0
        self._is_selected = is_selected
        self._report_occurrence = report_occurrence
        self._selected_frames = bytearray()  # a bit a frame
        self._unsettled_frame: int | None = None
        self._held_occurrences: dict[int, list[Occurrence]] = {}

    def on_observation(self, observation: Observation) -> None:
        """Hold what is reported from here on about a frame, until it settles what that belongs to."""
        self._unsettled_frame = observation.number if isinstance(observation.item, Frame) else None

    def on_pairing_result(self, settled: PairingResult) -> None:
        """Take notice of what has settled, before the rules see it."""
        self._unsettled_frame = None
        whole = call_observations(settled) if isinstance(settled, Call) else (settled.observation,)
        frames = [seen.number for seen in whole]
        if isinstance(settled, Call) and self._is_selected(settled):
            self.selected_calls += 1
            for frame in frames:
                self._select_frame(frame)
        if self._held_occurrences:
            for frame in frames:
                self._release_frame(frame)

    def add_occurrence(self, occurrence: Occurrence) -> None:
        """Take what a rule found."""
        if self._unsettled_frame is not None:
            self._held_occurrences.setdefault(self._unsettled_frame, []).append(occurrence)
            return
        occurrence.selected = any(map(self._is_frame_selected, occurrence.frames))
        self._report_occurrence(occurrence)

    def release_all(self) -> None:
        """Report what still waits: it concerns no call."""
        self._unsettled_frame = None
        for frame in list(self._held_occurrences):
            self._release_frame(frame)

    def _release_frame(self, frame: int) -> None:
        for incident in self._held_occurrences.pop(frame, ()):
            self.add_occurrence(incident)

    def _select_frame(self, frame: int) -> None:
        byte, bit = divmod(frame, 8)
        if byte >= len(self._selected_frames):
            self._selected_frames.extend(bytes(byte + 1 - len(self._selected_frames)))
        self._selected_frames[byte] |= 1 << bit

    def _is_frame_selected(self, frame: int) -> bool:
        byte, bit = divmod(frame, 8)
        return byte < len(self._selected_frames) and bool(self._selected_frames[byte] >> bit & 1)
