"""The traffic of a running proxy: join both legs as in a recording, and pass all frames to the pipeline."""

from __future__ import annotations

from collections.abc import Callable, Iterable

from bcapscope.messages import Message
from bcapscope.proxy.record_decoder import RecordDecoder
from bcapscope.traffic.joining.joined_observation import JoinedObservation, numbered
from bcapscope.traffic.joining.leg_joiner import LegJoiner, RelayedObservation
from bcapscope.traffic.observation import Conversation, Observation
from bcapscope.traffic.pipeline import Pipeline


class RelayedTraffic:
    """Shows and analyses the frames that the decoder finds in the relay's records.

    A frame on the client's leg is shown at once. A frame on the controller's leg is shown only if the same
    frame does not appear on the client's leg in time.
    """

    def __init__(
        self, pipeline: Pipeline, show_frame: Callable[[Observation, Message | None], object]
    ) -> None:
        """`show_frame` receives each frame, and a note of what a rule did to it."""
        self._pipeline = pipeline
        self._show_frame = show_frame
        self._legs = LegJoiner()
        self.decoder = RecordDecoder(self._legs.join)

    @property
    def analysed_until(self) -> int:
        """Time up to which all frames were analysed, ns since 1970."""
        return self._legs.delivered_until

    def add(self, seen: Observation, note: Message | None) -> None:
        if seen.number:
            self._show_frame(seen, note)
        if self._legs.is_idle:
            self._pipeline.add(seen)
        else:
            self._add_joined(self._legs.add(seen))

    def expire(self, now: int) -> None:
        """Complete the calls that are too old at the time `now` (ns since 1970) to receive further frames."""
        self._add_joined(self._legs.expire(now))
        self._pipeline.expire(self._legs.delivered_until)

    def flush(self) -> None:
        """Analyse all frames now, including frames that the proxy has not forwarded yet."""
        self._add_joined(self._legs.close())

    def close_conversation(self, conversation: Conversation) -> None:
        self._add_joined(self._legs.close_conversation(conversation))
        self._pipeline.close_conversation(conversation)

    def _add_joined(self, observations: Iterable[Observation]) -> None:
        for each in observations:
            seen = each
            if isinstance(each, JoinedObservation) and not each.number:
                seen, sighting = numbered(each, self.decoder.next_number()), each.at_controller
                self._show_frame(seen, sighting.note if isinstance(sighting, RelayedObservation) else None)
            self._pipeline.add_joined((seen,))
