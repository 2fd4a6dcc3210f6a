"""Read several captures, and folders of captures, as one input."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable, Iterator, Sequence
from functools import partial
from typing import TYPE_CHECKING, TypeVar

from bcapscope.capture.capture_file import CaptureFile, expand_folders, open_capture
from bcapscope.capture.capture_sequence import CaptureSequence, RunTable, capture_names
from bcapscope.capture.packet import Packet, PacketOrigin
from bcapscope.capture.packet_decoder import PacketDecoder
from bcapscope.capture.role_detection import BCAP_PORTS
from bcapscope.errors import CaptureError
from bcapscope.traffic.joining.joined_observation import CapturePlace
from bcapscope.traffic.observation import Observation

if TYPE_CHECKING:
    from bcapscope.capture.place_decoder import PlaceDecoder
    from bcapscope.capture.place_plan import PlacePlan
    from bcapscope.traffic.capture_point import CapturePoint
    from bcapscope.traffic.handle_tracker import HandleTracker
    from bcapscope.traffic.joining.joiner import Joiner
    from bcapscope.traffic.pipeline import Pipeline, PipelineSubscriber

T = TypeVar("T")


class CaptureInput:
    """Several captures that are read as one input. A `CaptureInput` can be read only once.

    Attributes:
        on_first_time: Called with the time of the first observation, before this observation is yielded.
        first_time: Time of the first observation, ns since 1970; 0 until the first observation was read.
        plans: Pairs of captures that hold the same conversations.
        decoder: Holds the counts, the comments and the conversations so far.
        captures: The captures in the order of reading. Each folder is replaced by the captures in it.
    """

    def __init__(
        self,
        paths: Sequence[str],
        ports: Collection[int],
        on_problem: Callable[[str, CaptureError], None],
        *,
        side: CapturePlace | None = None,
        taken_at: CapturePoint | None = None,
    ) -> None:
        """Prepare to read captures.

        Args:
            paths: Paths of captures and of folders with captures.
            ports: Ports of controllers; if empty, the usual ports.
            on_problem: Receives the path and the error of a capture that cannot be read to its end. bcapscope
                then reads the next capture.
            side: The side to read if a conversation was captured at both sides; None to read both sides.
            taken_at: Where the captures were taken; None to infer the place from the traffic.
        """
        self.on_first_time: Callable[[int], object] = lambda time: None
        self.first_time = 0
        self.plans: list[PlacePlan] = []
        self._side = side
        self._taken_at = taken_at
        self._joiner: Joiner | None = None
        known_ports = frozenset(ports) or BCAP_PORTS
        expanded = list(expand_folders(paths, on_problem))
        names = capture_names(expanded)
        open_sequence = partial(CaptureSequence, names=names, open_file=self._open, on_problem=on_problem)
        captures = open_sequence(expanded)
        decoder = PacketDecoder(known_ports)
        self.captures: CaptureSequence | PlaceDecoder = captures
        self.decoder: PacketDecoder | PlaceDecoder = decoder
        self._read: Callable[[], Iterator[Observation]] = lambda: decoder.decode(self._packets(captures))
        if len(expanded) > 1:
            from bcapscope.capture.place_decoder import PlaceDecoder  # noqa: PLC0415 - for two or more captures
            from bcapscope.capture.place_plan import plan_places  # noqa: PLC0415 - for two or more captures

            self.plans = plan_places(expanded, known_ports)
            if self.plans:
                places = PlaceDecoder(expanded, self.plans, known_ports, open_sequence)
                self.captures = self.decoder = places
                self._read = places.observations
        self._packets_of_frames = RunTable()
        if len(expanded) > 1:
            self.remember_origins()

    def _open(self, path: str) -> CaptureFile:
        return open_capture(path)

    def _packets(self, captures: CaptureSequence) -> Iterable[Packet]:
        return captures

    def observations(self) -> Iterator[Observation]:
        """Yield all observations, or only those of the chosen side. `on_problem` receives all errors."""
        observations = self._all_observations()
        return observations if self._side is None else self._of_side(observations, self._side)

    def _all_observations(self) -> Iterator[Observation]:
        observations = self._read()
        for first in observations:
            self.first_time = first.time
            self.on_first_time(first.time)
            yield first
            break
        yield from observations

    @staticmethod
    def _of_side(observations: Iterator[Observation], side: CapturePlace) -> Iterator[Observation]:
        from bcapscope.traffic.joining.joiner import Joiner  # noqa: PLC0415 - few commands need it

        joiner = Joiner(only=side)
        for observation in observations:
            yield from joiner.add(observation)
        yield from joiner.close()

    def pipeline(self, *subscribers: PipelineSubscriber, handles: HandleTracker | None = None) -> Pipeline:
        """Return a pipeline that joins conversations that were captured at several places."""
        from bcapscope.traffic.joining.joiner import Joiner  # noqa: PLC0415 - `decode` needs no pipeline
        from bcapscope.traffic.pipeline import Pipeline  # noqa: PLC0415 - `decode` needs no pipeline

        self._joiner = Joiner(self.decoder.comments) if self._side is None else None
        return Pipeline(*subscribers, handles=handles, joiner=self._joiner, taken_at=self._taken_at)

    @property
    def own_requests(self) -> int:
        """Number of requests that a proxy sent on its own, in conversations whose two legs were joined."""
        return 0 if self._joiner is None else self._joiner.own_requests

    @property
    def ended_at(self) -> int:
        """Latest time of all packets read so far, of any protocol, ns since 1970."""
        return self.decoder.end_time

    def remember_origins(self) -> None:
        """Remember the packet of each frame for `origin_of_frame`. Call this method before reading."""
        self.decoder.note_packet = lambda frame, packet: self._packets_of_frames.add(frame, 0, packet)

    def origin_of_frame(self, frame: int) -> PacketOrigin | None:
        """Return the packet that completed a frame; None if not known."""
        found = self._packets_of_frames.find(frame)
        return None if found is None else self.captures.origin_of(found[1])

    def find_frame(self, frame: int) -> tuple[str, int] | None:
        """Return the name of a frame's capture, and the frame's packet number there; None if not known."""
        origin = self.origin_of_frame(frame)
        return None if origin is None else (origin.name, origin.packet)

    def read_items(self, pipeline: Pipeline, items: list[T]) -> Iterator[T]:
        """Read the input to its end, and yield the items that the pipeline's subscribers add to `items`."""
        add = pipeline.add
        for observation in self.observations():
            add(observation)
            if items:
                yield from items
                items.clear()
        pipeline.finish(self.ended_at)
        yield from items
        items.clear()
