"""Build the facts of one slave-mode session from its set points."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from typing import NamedTuple, TypeAlias

import numpy as np

from bcapscope.analysis.slave.buffer_model import BufferBehaviour, BufferModel, SetPointArrivals
from bcapscope.analysis.slave.column_templates import ColumnReader, NumberPicker, PickedNumbers, PoseColumns
from bcapscope.analysis.slave.controller_clock import ControllerClock
from bcapscope.analysis.slave.generation_clues import GenerationClue
from bcapscope.analysis.slave.motion_model import MotionModel, PoseTable, StartDistance
from bcapscope.analysis.slave.notable_set_points import MAX_LISTED, SetPointFact, set_point_fact
from bcapscope.analysis.slave.plot_samples import PlotSampler
from bcapscope.analysis.slave.session_slices import SessionSlice, SessionSlicer
from bcapscope.analysis.slave.set_point_batch import SetPointBatch
from bcapscope.analysis.slave.set_point_chunk import SetPointChunk, SetPointHandler
from bcapscope.analysis.slave.set_point_table import SetPointTable, table_of
from bcapscope.analysis.slave.slave_session import (
    AcceptedFormat,
    CallFact,
    FrameTime,
    KnownMode,
    SessionExit,
    SetPointCounts,
    SlaveSession,
)
from bcapscope.analysis.slave.timing_model import TimingModel
from bcapscope.analysis.statistics.distribution import Floats
from bcapscope.messages import Message
from bcapscope.protocol.codec.frame import Frame
from bcapscope.protocol.codec.variant import Variant
from bcapscope.protocol.slave_mode.formats import ReceiveFormat, SendFormat
from bcapscope.protocol.slave_mode.modes import Generation, PoseType, pose_type_of_mode, slave_mode_by_number
from bcapscope.protocol.slave_mode.poses import Axis, Pose
from bcapscope.protocol.slave_mode.slvmove_values import parse_feedback, parse_set_point
from bcapscope.protocol.tables.hresult import E_SLAVE_OVERFLOW, S_BUF_FULL, is_failure
from bcapscope.traffic.call import Call
from bcapscope.traffic.observation import Conversation, Transport

BATCH_SIZE = 4096
"""Set points that are processed together: enough to make columns worthwhile, one or two MB of them."""

MAX_CODES = 256
"""Different HRESULTs of refused set points that are counted separately; further ones count under 0."""

_PARAMETER = 2
_RESULT = 0
_UNKNOWN = -1
_FAILURES = 0x80000000
_I4_ARGUMENT, _I4_SIZE = b"\x0a\x00\x00\x00\x03\x00", 14

SessionKey: TypeAlias = "tuple[Conversation, bytes]"
"""A client, and the argument by which it names the robot."""


class KnownPosition(NamedTuple):
    """Position of the robot that the controller reported earlier.

    Attributes:
        pose_type: Type of the pose.
        values: Numbers of the pose.
        known_by: Source of the position.
        frames: Request and reply frame.
    """

    pose_type: PoseType
    values: tuple[float, ...]
    known_by: Message
    frames: tuple[int, ...]


class SlaveSetup(NamedTuple):
    """What client and controller agreed on before the first set point.

    Attributes:
        mode_value: Value of the slave mode; None if unknown.
        known_by: Source of that value.
        generation_clue: Clue to the controller's generation.
        send_format: Accepted send format; None if none was seen.
        receive_format: Accepted receive format; None if none was seen.
        position: Position of the robot; None if unknown.
    """

    mode_value: int | None
    known_by: str
    generation_clue: GenerationClue
    send_format: AcceptedFormat | None
    receive_format: AcceptedFormat | None
    position: KnownPosition | None


class SlaveSessionBuilder:
    """Builds a slave-mode session while it may still go on.

    Attributes:
        number: Number of the slave-mode session.
        key: Client that sends the set points, and its robot; before the first set point, the client that
            entered slave mode.
        mode: Value of the mode, and its source.
        entry_call: The slvChangeMode that began it; None if that was not seen.
        entered_at: Time of the reply to `entry_call`, ns since 1970.
        batch: Set points that wait to be processed.
        slave_setup: Fixed when the first set points are processed.
        after_end: Number of set points refused as a consequence of the end, or not answered after it.
        last_accepted: Send time of the latest processed set point that was accepted, ns since 1970; None
            without one.
    """

    def __init__(
        self,
        number: int,
        key: SessionKey,
        entry: CallFact | None,
        mode: tuple[int | None, str],
        *,
        window: int | None = None,
        on_set_points: SetPointHandler | None = None,
    ) -> None:
        self.number = number
        self.key = key
        self.mode = mode
        self.entry_call = entry
        self.entered_at: int | None = None if entry is None else entry.reply_time or entry.time
        self.batch = SetPointBatch()
        self.slave_setup: SlaveSetup | None = None
        self.after_end = 0
        self.last_accepted: int | None = None
        self._window = window
        self._on_set_points = on_set_points
        self._first_set_point: FrameTime | None = None
        self._last_set_point: FrameTime | None = None
        self._last_activity = 0
        self._models: _SessionModels | None = None

    @property
    def conversation(self) -> Conversation:
        """Conversation of the client that sends the set points."""
        return self.key[0]

    @property
    def handle(self) -> bytes:
        """First argument of the set points, as raw bytes."""
        return self.key[1]

    @property
    def last_activity(self) -> int:
        """Time when the latest set point was answered, or else sent, ns since 1970; 0 if unknown.

        It is never before `entered_at`. A client that does not wait for the reply to slvChangeMode sends set
        points before that time.
        """
        last = max(self.batch[-1].time, self.batch[-1].reply_time) if self.batch else self._last_activity
        return max(last, self.entered_at or 0)

    def began_at(self, ended_at: int) -> int:
        """Return the start time, ns since 1970; `ended_at` if it is unknown."""
        if self.entered_at is not None:
            return self.entered_at
        if self._first_set_point is not None:
            return self._first_set_point.time
        return self.batch[0].time if self.batch else ended_at

    def process_batch(self, slave_setup: SlaveSetup) -> None:
        """Process the waiting set points. `slave_setup` counts only for the first batch."""
        batch = self.batch
        if not batch:
            return
        if self._models is None:
            self._first_set_point = FrameTime(batch[0].frame, batch[0].time)
            self.slave_setup = slave_setup
            self._models = _SessionModels(self.conversation.transport, slave_setup, batch, self._window)
        self._last_set_point, self._last_activity = (
            FrameTime(batch[-1].frame, batch[-1].time),
            self.last_activity,
        )
        rows = table_of(batch, self._models.origin)
        accepted = np.flatnonzero(rows.answered & (rows.codes < _FAILURES))
        if len(accepted):
            self.last_accepted = rows.origin + int(rows.times[accepted[-1]])
        with np.errstate(all="ignore"):  # numbers from the wire may be infinite or too large to square
            commanded, returned = self._models.add(rows, batch)
        batch.clear()
        if self._on_set_points is not None:
            self._on_set_points(self._make_chunk(self._models, rows, commanded, returned))

    def _make_chunk(
        self, figures: _SessionModels, rows: SetPointTable, commanded: PoseColumns, returned: PoseColumns
    ) -> SetPointChunk:
        setting = self.slave_setup
        return SetPointChunk(
            session_number=self.number,
            conversation=self.conversation,
            robot=_handle_value(self.handle),
            mode=figures.mode,
            send_format=None if setting is None else setting.send_format,
            receive_format=None if setting is None else setting.receive_format,
            grid_ms=float(figures.timing.grid.ms),
            microseconds=figures.clock.microseconds,
            axes=figures.axes,
            table=rows,
            commanded=commanded,
            returned=returned,
        )

    @np.errstate(all="ignore")  # as above
    def finish(
        self, exit_: SessionExit, slave_setup: SlaveSetup, other_calls: tuple[CallFact, ...]
    ) -> SlaveSession:
        """Return the finished slave-mode session; add nothing afterwards."""
        self.process_batch(slave_setup)
        slave_setup = self.slave_setup or slave_setup
        figures = self._models or _SessionModels(
            self.conversation.transport, slave_setup, SetPointBatch(), self._window
        )
        slices, left_off = figures.slices()
        first = self._first_set_point
        return SlaveSession(
            number=self.number,
            conversation=self.conversation,
            robot=_handle_value(self.handle),
            entry_call=self.entry_call,
            entered_at=self.began_at(exit_.time),
            mode=figures.mode,
            send_format=slave_setup.send_format,
            receive_format=slave_setup.receive_format,
            first_set_point=first,
            last_set_point=self._last_set_point,
            exit=exit_,
            counts=figures.counts(self.after_end),
            timing=figures.timing.facts(),
            buffer=figures.buffer.facts(),
            clock=figures.clock.facts(),
            motion=figures.motion.facts(figures.timing.grid.ms, figures.start_distance) if first else None,
            refused_set_points=tuple(figures.refused_list),
            forbidden_retry_frames=tuple(figures.forbidden_retries),
            other_calls=other_calls,
            slices=slices,
            slices_left_off=left_off,
            samples=figures.sampler.samples(),
        )


def _handle_value(argument: bytes) -> int | None:
    known = argument[:6] == _I4_ARGUMENT and len(argument) == _I4_SIZE
    return int.from_bytes(argument[-4:], "little", signed=True) if known else None


def known_mode(slave_setup: SlaveSetup, pose_type: PoseType | None) -> KnownMode:
    """Return what a mode means on this controller, as far as known."""
    value, generation = slave_setup.mode_value, slave_setup.generation_clue.generation
    meaning = None if value is None else slave_mode_by_number(value, generation or Generation.RC8)
    return KnownMode(
        value=value,
        known_by=slave_setup.known_by if value is not None else "",
        generation=generation,
        generation_known_by=slave_setup.generation_clue.reason,
        meaning=meaning,
        guessed=meaning is not None and generation is None,
        pose_type=pose_type,
    )


class _SessionModels:
    """Feeds all models of one slave-mode session."""

    def __init__(
        self, transport: Transport, setting: SlaveSetup, batch: SetPointBatch, window: int | None
    ) -> None:
        self._slave_setup = setting
        self.origin = batch[0].time if batch else 0
        pose = next(_poses_in(batch, setting), None)
        self._pose_type = pose.type if pose else _pose_type(setting)
        self.axes: tuple[Axis, ...] = pose.axes if pose else ()
        self.mode = known_mode(setting, self._pose_type)
        rules = BufferBehaviour.of_mode(self.mode.meaning, self.mode.guessed)
        self._replies_pace = rules.replies_pace
        self.forbids_retries = rules.overwrites and transport is Transport.UDP
        self.timing = TimingModel(self.mode.meaning, transport, rules.slots)
        self.buffer = BufferModel(rules, self.origin)
        self.clock = ControllerClock(
            None if setting.receive_format is None else setting.receive_format.microseconds
        )
        self.motion = MotionModel(self.axes, self._pose_type, pose.guessed if pose else False)
        self.sampler = PlotSampler(len(self.axes), self.origin)
        self.start_distance = StartDistance()
        self.refused_list: list[SetPointFact] = []
        self.forbidden_retries: list[int] = []
        self._slicer = SessionSlicer(window, self.origin) if window else None
        self._axes = len(self.axes)
        self._has_set_points = False
        self._command_columns = ColumnReader(NumberPicker(_PARAMETER, self._pick_command))
        self._result_columns = ColumnReader(NumberPicker(_RESULT, self._pick_result))
        self._last_poses = np.full((2, len(self.axes)), np.nan)  # the last two commanded poses
        self._sent = self._accepted = self._unanswered = self._open = self._not_followed = (
            self._buffer_full
        ) = 0
        self._retries: Counter[int] = Counter()
        self._late_replies = self._lost_replies = 0
        self._refused: Counter[int] = Counter()

    def add(self, rows: SetPointTable, batch: SetPointBatch) -> tuple[PoseColumns, PoseColumns]:
        commanded = self._command_columns.read(batch.requests, len(batch), self._axes)
        returned = self._result_columns.read(batch.results, len(batch), self._axes)
        cycles = self.timing.add(rows)
        slacks = self._add_to_buffer(rows, commanded)
        self._count(rows, cycles)
        self._add_motion(rows, commanded, returned)
        stamped = np.flatnonzero(~np.isnan(returned.stamps))
        self.clock.add(returned.stamps[stamped], rows.replies[stamped])
        latencies = np.where(rows.answered, rows.latencies, np.nan)
        poses = commanded.poses, returned.poses
        self.sampler.add(rows.times, rows.frames, (cycles, latencies, slacks), poses)
        if self._slicer is not None:
            self._slicer.add(rows, cycles, slacks)
        return commanded, returned

    def counts(self, after_end: int) -> SetPointCounts:
        retries = sum(times * count for times, count in self._retries.items())
        return SetPointCounts(
            sent=self._sent,
            accepted=self._accepted,
            refused=dict(self._refused),
            unanswered=self._unanswered,
            open=self._open - self._not_followed,
            not_followed=self._not_followed,
            buffer_full=self._buffer_full,
            after_end=after_end,
            retries=retries,
            by_retries={times: count for times, count in sorted(self._retries.items()) if count},
            retries_forbidden=retries if self.forbids_retries else 0,
            late_replies=self._late_replies,
            lost_replies=self._lost_replies,
        )

    def slices(self) -> tuple[tuple[SessionSlice, ...], int]:
        if self._slicer is None:
            return (), 0
        return self._slicer.finish(), self._slicer.left_off

    def _pick_command(self, parameter: Variant) -> PickedNumbers:
        send, receive = _formats(self._slave_setup)
        pose = parse_set_point(parameter, self._pose_type, send, receive).pose
        return (pose.values if pose and pose.type is self._pose_type else ()), None

    def _pick_result(self, result: Variant) -> PickedNumbers:
        _, receive = _formats(self._slave_setup)
        feedback = parse_feedback(result, self._pose_type, receive)
        fitting = (pose.values for pose in feedback.poses if pose.type is self._pose_type)
        return next(fitting, ()), feedback.timestamp

    def _add_to_buffer(self, rows: SetPointTable, commanded: PoseColumns) -> Floats:
        points = np.vstack((self._last_poses, commanded.poses))
        known = ~np.isnan(points).any(axis=1)
        differ = (points[1:] != points[:-1]).any(axis=1)
        moving = np.where(known[1:] & known[:-1] & (self._axes > 0), differ, _UNKNOWN)[:-1]
        self._last_poses = points[-2:]
        entered = np.maximum(rows.arrivals, rows.replies) if self._replies_pace else rows.arrivals
        slacks = self.buffer.add(
            SetPointArrivals(rows.arrivals, entered, rows.codes, rows.frames, rows.reply_frames, moving)
        )
        found = slacks / 1e6
        if not self._has_set_points:
            found[0] = np.nan
        return found

    def _count(self, rows: SetPointTable, cycles: Floats) -> None:
        sent = len(rows.calls)
        self._sent += sent
        open_ = int(np.count_nonzero(rows.open))
        without_reply = int(np.count_nonzero(~rows.answered))
        self._open += open_
        self._unanswered += without_reply - open_
        refused = 0
        for row in np.flatnonzero(rows.codes).tolist():
            code = int(rows.codes[row])
            if is_failure(code):
                refused += 1
                self._refused[code if code in self._refused or len(self._refused) < MAX_CODES else 0] += 1
                if len(self.refused_list) < MAX_LISTED:
                    self.refused_list.append(set_point_fact(rows, row, cycles))
            elif code == S_BUF_FULL:
                self._buffer_full += 1
        self._accepted += sent - without_reply - refused
        self._retries[0] += sent - len(rows.irregular)
        for _, call in rows.irregular:
            self._retries[call.retries] += 1
            self._count_irregular(call)

    def _count_irregular(self, call: Call) -> None:
        self._late_replies += len(call.late_replies)
        self._lost_replies += len(call.lost_replies)
        self._not_followed += call.evicted
        if self.forbids_retries and len(self.forbidden_retries) < MAX_LISTED:
            self.forbidden_retries += [request.number for request in call.attempts[call.first_attempt_seen :]]
            del self.forbidden_retries[MAX_LISTED:]

    def _add_motion(self, rows: SetPointTable, commanded: PoseColumns, returned: PoseColumns) -> None:
        accepted = returned.has_pose & rows.answered
        if not self._has_set_points:
            self._has_set_points = True
            self.start_distance = self._start_distance(rows, commanded, returned)
        self.motion.add(
            PoseTable(
                commanded=commanded.poses,
                readable=commanded.has_pose & (self._axes > 0) & (rows.codes != E_SLAVE_OVERFLOW),
                returned=returned.poses,
                has_returned=accepted,
                frames=rows.frames,
                times=rows.origin + rows.times,
            )
        )

    def _start_distance(
        self, rows: SetPointTable, commanded: PoseColumns, returned: PoseColumns
    ) -> StartDistance:
        """Compare the first set point with the pose in its reply, or else with the position known before."""
        goal, position = commanded.poses[0], self._slave_setup.position
        if not self._axes or not np.isfinite(goal).all():
            return StartDistance()
        if returned.has_pose[0] and np.isfinite(returned.poses[0]).all():
            frames: tuple[int, ...] = int(rows.frames[0]), int(rows.reply_frames[0])
            known_by = Message("position-by.reply")
            return StartDistance(_distance(goal, returned.poses[0]), known_by, frames)
        if position and position.pose_type is self._pose_type and len(position.values) >= self._axes:
            stood = np.array(position.values[: self._axes])
            if np.isfinite(stood).all():
                frames = *position.frames, int(rows.frames[0])
                return StartDistance(_distance(goal, stood), position.known_by, frames)
        return StartDistance()


def _distance(goal: Floats, stood: Floats) -> tuple[float, ...]:
    return tuple((goal - stood).tolist())


def _formats(slave_setup: SlaveSetup) -> tuple[SendFormat | None, ReceiveFormat | None]:
    send, receive = slave_setup.send_format, slave_setup.receive_format
    return (
        None if send is None else SendFormat.parse(send.value),
        None if receive is None else ReceiveFormat.parse(receive.value, receive.microseconds),
    )


def _pose_type(slave_setup: SlaveSetup) -> PoseType | None:
    return None if slave_setup.mode_value is None else pose_type_of_mode(slave_setup.mode_value)


def _poses_in(batch: SetPointBatch, slave_setup: SlaveSetup) -> Iterator[Pose]:
    """Yield the readable poses of known type among the first 16 set points."""
    send, receive = _formats(slave_setup)
    pose_type = _pose_type(slave_setup)
    for place in range(min(len(batch), 16)):
        parameter = execute_parameter(Frame(batch.requests[place]))
        if parameter is not None:
            pose = parse_set_point(parameter, pose_type, send, receive).pose
            if pose is not None and pose.type is not None:
                yield pose


def execute_parameter(request: Frame) -> Variant | None:
    """Return vntParam of an ..._Execute request; None if it is missing."""
    arguments = request.arguments
    return arguments[_PARAMETER].variant if len(arguments) > _PARAMETER else None
