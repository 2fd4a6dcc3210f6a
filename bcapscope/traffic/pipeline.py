"""The pipeline: the only place that turns observations into calls, handles and changes of slave mode."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from typing import ClassVar, Concatenate, ParamSpec, TypeVar

from bcapscope.traffic.alike_set_points import AlikeSetPoints
from bcapscope.traffic.bounded_dict import BoundedDict
from bcapscope.traffic.call import Call, PairingResult, StrayReply
from bcapscope.traffic.call_kind import MAX_CONVERSATIONS
from bcapscope.traffic.capture_point import CapturePoint
from bcapscope.traffic.handle_tracker import HandleTracker, TrackedObject
from bcapscope.traffic.joining.joined_observation import JoinedObservation
from bcapscope.traffic.joining.joiner import Joiner
from bcapscope.traffic.observation import Conversation, Observation
from bcapscope.traffic.slave_mode_tracker import SlaveModeChange, SlaveModeTracker
from bcapscope.traffic.tracker import Tracker

_Owner = TypeVar("_Owner")
_Parameters = ParamSpec("_Parameters")
_Result = TypeVar("_Result")


def overriding_methods(
    objects: Iterable[_Owner], method: Callable[Concatenate[_Owner, _Parameters], _Result]
) -> list[Callable[_Parameters, _Result]]:
    name = method.__name__
    return [getattr(each, name) for each in objects if getattr(type(each), name) is not method]


class PipelineSubscriber:
    """Receives the events of a `Pipeline`. A subclass overrides the methods for the events that it needs. The
    pipeline computes only events that a subscriber needs. `on_frame` receives a frame before `on_call`
    receives the calls that this frame completed.

    If `needs_targets` is False, the `target` of `on_call` may be None even if the pipeline could find the
    object of the call's handle.
    """

    needs_targets: ClassVar[bool] = False

    def on_frame(self, observation: Observation) -> None:
        """Process the next frame, or the next bytes that are no frame."""

    def on_call(self, call: Call, target: TrackedObject | None) -> None:
        """Process a completed call. `target` is the object to which the call's handle refers; None if this
        object is unknown.
        """

    def on_set_points(self, calls: Sequence[Call]) -> None:
        """Process successive set points of one client that differ only in serials, reserved fields and
        numbers (see `AlikeSetPoints`). If a subclass does not override `on_set_points`, its `on_call`
        receives these set points.
        """

    def on_stray_reply(self, stray: StrayReply) -> None:
        """Process a reply that belongs to no call."""

    def on_slave_mode(self, change: SlaveModeChange) -> None:
        """Process a change of a client's slave mode, after the call that made the change."""

    def on_conversation_closed(self, conversation: Conversation) -> None:
        """Release the data of an ended conversation. The subscriber has already received all calls of this
        conversation.
        """


class CallCollector(PipelineSubscriber):
    """Collects completed calls. Code that reads `calls` may remove calls from it."""

    def __init__(self, is_selected: Callable[[Call], bool] | None = None) -> None:
        self.calls: list[Call] = []
        self._is_selected = is_selected

    def on_call(self, call: Call, target: TrackedObject | None) -> None:
        if self._is_selected is None or self._is_selected(call):
            self.calls.append(call)


class Pipeline:
    """Turns observations, added in capture order, into events for its subscribers, in bounded memory."""

    def __init__(
        self,
        *subscribers: PipelineSubscriber,
        handles: HandleTracker | None = None,
        slave_mode: SlaveModeTracker | None = None,
        joiner: Joiner | None = None,
        taken_at: CapturePoint | None = None,
    ) -> None:
        """Create a pipeline.

        Args:
            handles: Handle tracker that the pipeline updates and the caller reads. If None, the pipeline
                follows handles only for subscribers with `needs_targets`.
            slave_mode: Slave-mode tracker that the pipeline updates and the caller reads. If None, the
                pipeline tracks slave mode only for subscribers that override `on_slave_mode`.
            joiner: Joins conversations that were captured at several places.
        """
        self._tracker = Tracker(taken_at)
        self._runs: BoundedDict[Conversation, AlikeSetPoints] = BoundedDict(MAX_CONVERSATIONS)
        self._frame_handlers = overriding_methods(subscribers, PipelineSubscriber.on_frame)
        self._joiner = joiner
        self.add: Callable[[Observation], None] = self._adder(joiner)
        self._call_handlers = overriding_methods(subscribers, PipelineSubscriber.on_call)
        self._run_handlers = overriding_methods(subscribers, PipelineSubscriber.on_set_points)
        self._single_handlers = overriding_methods(
            [each for each in subscribers if type(each).on_set_points is PipelineSubscriber.on_set_points],
            PipelineSubscriber.on_call,
        )
        self._stray_handlers = overriding_methods(subscribers, PipelineSubscriber.on_stray_reply)
        self._mode_handlers = overriding_methods(subscribers, PipelineSubscriber.on_slave_mode)
        self._closed_handlers = overriding_methods(subscribers, PipelineSubscriber.on_conversation_closed)
        needs_targets = any(each.needs_targets for each in subscribers)
        self._handles = handles or (HandleTracker(max_ended=0) if needs_targets else None)
        self._slave_mode = slave_mode or (SlaveModeTracker() if self._mode_handlers else None)

    @property
    def has_open_calls(self) -> bool:
        return bool(self._tracker.open_calls)

    def expire(self, now: int) -> None:
        """Complete the calls that are too old at the time `now` (ns since 1970) to receive further frames."""
        if self._joiner is not None:
            self.add_joined(self._joiner.expire(now))
            now = min(now, self._joiner.delivered_until)
        self._emit(self._tracker.expire(now))

    def close_conversation(self, conversation: Conversation) -> None:
        """Complete the open calls of a conversation that has ended, and drop its data."""
        self._emit(self._tracker.close_conversation(conversation))
        for on_closed in self._closed_handlers:
            on_closed(conversation)
        self._runs.pop(conversation, None)
        if self._handles is not None:
            self._handles.close_conversation(conversation)
        if self._slave_mode is not None:
            self._slave_mode.close_conversation(conversation)

    def finish(self, ended_at: int = 0) -> None:
        """Complete all open calls. The traffic ended at `ended_at`, ns since 1970; 0 if this is unknown."""
        if self._joiner is not None:
            self.add_joined(self._joiner.close())
        if ended_at:
            self.expire(ended_at)
        self._emit(self._tracker.close())

    def _adder(self, joiner: Joiner | None) -> Callable[[Observation], None]:
        """Return a closure that adds an observation. A closure is a tenth faster than a method."""
        observe, emit, frame_handlers = self._tracker.observe, self._emit, self._frame_handlers

        def add(observation: Observation) -> None:
            for on_frame in frame_handlers:
                on_frame(observation)
            settled = observe(observation)
            if settled:
                emit(settled)

        self._add = add
        if joiner is None:
            return add

        def add_to_joiner(observation: Observation) -> None:
            if observation.flow not in joiner.passing:
                self.add_joined(joiner.add(observation))
                return
            # repeats the code of `add`, because an extra function call would slow down nearly all captures
            for on_frame in frame_handlers:
                on_frame(observation)
            settled = observe(observation)
            if settled:
                emit(settled)

        return add_to_joiner

    def add_joined(self, observations: Sequence[Observation]) -> None:
        """Add observations that a joiner returned, in order of time."""
        for observation in observations:
            if not isinstance(observation, JoinedObservation):
                self._add(observation)
                continue
            for on_frame in self._frame_handlers:
                on_frame(observation)
            settled = self._tracker.observe_joined(observation)
            if settled:
                self._emit(settled)

    def _emit(self, settled: Sequence[PairingResult]) -> None:
        if not self._run_handlers:
            self._emit_each(settled)
            return
        alike: list[Call] = []
        run = conversation = None
        for item in settled:
            if isinstance(item, Call):
                if run is None or item.conversation is not conversation:
                    self._emit_run(alike)
                    alike, conversation = [], item.conversation
                    run = self._run_of(conversation)
                if run.continues(item):
                    alike.append(item)
                    continue
                run.on_other_call(item)
            self._emit_run(alike)
            alike = []
            self._emit_each((item,))
        self._emit_run(alike)

    def _emit_run(self, calls: Sequence[Call]) -> None:
        if not calls:
            return
        for on_set_points in self._run_handlers:
            on_set_points(calls)
        if self._single_handlers:
            # All `calls` have the same handle, so the pipeline looks up the handle only once.
            target = None if self._handles is None else self._handles.on_call(calls[0])
            for on_call in self._single_handlers:
                for call in calls:
                    on_call(call, target)

    def _emit_each(self, settled: Sequence[PairingResult]) -> None:
        handles, slave_mode, call_handlers = self._handles, self._slave_mode, self._call_handlers
        for item in settled:
            if isinstance(item, StrayReply):
                for on_stray_reply in self._stray_handlers:
                    on_stray_reply(item)
            else:
                target = None if handles is None else handles.on_call(item)
                for on_call in call_handlers:
                    on_call(item, target)
                change = None if slave_mode is None else slave_mode.on_call(item)
                if change is not None:
                    for on_slave_mode in self._mode_handlers:
                        on_slave_mode(change)

    def _run_of(self, conversation: Conversation) -> AlikeSetPoints:
        run = self._runs.get(conversation)
        if run is None:
            run = self._runs[conversation] = AlikeSetPoints()
        return run
