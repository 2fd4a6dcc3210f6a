"""Figures of frames captured at two places: the delay, and the frames lost between the places."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from bcapscope.analysis.statistics.distribution import Histogram
from bcapscope.analysis.statistics.distribution_summary import DistributionSummary
from bcapscope.traffic.call import Call
from bcapscope.traffic.joining.joined_observation import JoinedObservation
from bcapscope.traffic.observation import Conversation

_FLUSH_AT = 512
_MILLISECOND = 1_000_000


@dataclass(frozen=True, slots=True)
class OneWayFigures:
    """Loss and delay of a conversation's requests, or of its replies.

    Attributes:
        frames: Number of frames that were captured at both places.
        delay: Time from the sender's place to the receiver's place, ms; None if there are no frames.
    """

    frames: int
    lost: int
    delay: DistributionSummary | None


@dataclass(frozen=True, slots=True)
class PlaceFigures:
    """Figures of one conversation that was captured at two places.

    Attributes:
        is_relayed: Whether a proxy forwards the conversation between the two places.
        delay_error: Uncertainty of the delays, ms.
    """

    conversation: Conversation
    is_relayed: bool
    delay_error: float
    requests: OneWayFigures
    replies: OneWayFigures


class _OneWayTally:
    def __init__(self) -> None:
        self.frames = self.lost = 0
        self._histogram = Histogram()
        self._delays: list[int] = []

    def add_frame(self, seen: JoinedObservation) -> None:
        self.lost += seen.was_lost_between
        delay = seen.delay
        if delay is not None:
            self.frames += 1
            self._delays.append(delay)
            if len(self._delays) >= _FLUSH_AT:
                self._flush()

    def figures(self) -> OneWayFigures:
        self._flush()
        return OneWayFigures(self.frames, self.lost, self._histogram.distribution())

    def _flush(self) -> None:
        # Replace negative delays by 0: they are within the uncertainty, and a histogram has no bins for them.
        self._histogram.add(np.maximum(np.array(self._delays, dtype=np.float64) / _MILLISECOND, 0))
        self._delays = []


class PlaceTally:
    def __init__(self, conversation: Conversation) -> None:
        self._conversation = conversation
        self._requests, self._replies = _OneWayTally(), _OneWayTally()
        self._is_relayed = False
        self._error = 0

    def add_call(self, call: Call) -> None:
        for seen in call.joined_frames:
            self._is_relayed, self._error = seen.is_relayed, seen.delay_error
            (self._requests if seen.is_request else self._replies).add_frame(seen)

    def figures(self) -> PlaceFigures:
        error = self._error / _MILLISECOND
        requests, replies = self._requests.figures(), self._replies.figures()
        return PlaceFigures(self._conversation, self._is_relayed, error, requests, replies)
