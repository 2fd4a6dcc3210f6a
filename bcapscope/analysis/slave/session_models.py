"""All models of one slave-mode session: timing, buffer, clock, motion, and the counts of set points."""

from __future__ import annotations

from collections import Counter
from functools import partial
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from bcapscope.analysis.slave.buffer_model import BufferBehaviour, BufferModel
from bcapscope.analysis.slave.column_templates import ColumnReader, PickedNumbers, PoseColumns
from bcapscope.analysis.slave.controller_clock import ControllerClock
from bcapscope.analysis.slave.generation_clues import GenerationClue
from bcapscope.analysis.slave.motion_model import KnownPosition, MotionModel
from bcapscope.analysis.slave.motion_pace import MotionPaceModel
from bcapscope.analysis.slave.notable_set_points import MAX_LISTED, SetPointFact
from bcapscope.analysis.slave.plot_samples import PlotSampler
from bcapscope.analysis.slave.session_slices import SessionSlice, SessionSlicer
from bcapscope.analysis.slave.set_point_batch import SetPointBatch
from bcapscope.analysis.slave.set_point_table import SetPointTable
from bcapscope.analysis.slave.slave_session import AcceptedFormat, KnownMode, SetPointCounts
from bcapscope.analysis.slave.timing_model import TimingModel
from bcapscope.analysis.statistics.distribution import Floats
from bcapscope.protocol.codec.frame import Frame
from bcapscope.protocol.codec.variant import Variant
from bcapscope.protocol.slave_mode.formats import ReceiveFormat, SendFormat
from bcapscope.protocol.slave_mode.modes import Generation, PoseType, pose_type_of_mode, slave_mode_by_number
from bcapscope.protocol.slave_mode.poses import Axis, Pose
from bcapscope.protocol.slave_mode.slvmove_values import parse_feedback, parse_set_point
from bcapscope.protocol.tables.command_catalogue import command_parameter
from bcapscope.protocol.tables.hresult import S_BUF_FULL, is_failure
from bcapscope.traffic.call import Call
from bcapscope.traffic.call_verdict import CallVerdict, Outcome
from bcapscope.traffic.observation import Transport

MAX_CODES = 256
"""Maximum number of refusal codes that a session counts separately. All further codes count as code 0."""

_PARAMETER = 2
_RESULT = 0
_UNKNOWN = -1
_STEP = 1
_SERIALS = 1 << 16
_MOST_UNCAPTURED = 1000
"""If a client skips more serials than this, it evidently does not number its requests one by one."""
_TINY_STEP = 0.02
"""A step counts as motion only if it is larger than this share of the axis's largest step so far."""


class SlaveSetup(NamedTuple):
    """What is known about a session before its first set point. The command `known_by` shows `mode_value`."""

    mode_value: int | None
    known_by: str
    generation_clue: GenerationClue
    send_format: AcceptedFormat | None
    receive_format: AcceptedFormat | None
    position: KnownPosition | None


def known_mode(slave_setup: SlaveSetup, pose_type: PoseType | None) -> KnownMode:
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


class SessionModels:
    def __init__(
        self, transport: Transport, slave_setup: SlaveSetup, batch: SetPointBatch, window: int | None
    ) -> None:
        self.slave_setup = slave_setup
        self.origin = batch[0].time if batch else 0
        sent, received = slave_setup.send_format, slave_setup.receive_format
        send = None if sent is None else SendFormat.parse(sent.value)
        receive = None if received is None else ReceiveFormat.parse(received.value, received.microseconds)
        mode = slave_setup.mode_value
        pose_type = None if mode is None else pose_type_of_mode(mode)
        pose = _first_pose(batch, pose_type, send, receive)
        pose_type = pose.type if pose else pose_type
        self.axes: tuple[Axis, ...] = pose.axes if pose else ()
        self.mode = known_mode(slave_setup, pose_type)
        rules = BufferBehaviour.of_mode(self.mode.meaning, self.mode.guessed)
        self.forbids_retries = rules.overwrites and transport is Transport.UDP
        self.timing = TimingModel(self.mode.meaning, transport, rules.slots)
        self.pace = MotionPaceModel()
        self.buffer = BufferModel(rules, self.origin)
        self.clock = ControllerClock(None if received is None else received.microseconds)
        guessed = pose.guessed if pose else False
        self.motion = MotionModel(self.axes, pose_type, guessed, slave_setup.position)
        self.sampler = PlotSampler(len(self.axes), self.origin)
        self.refused_list: list[SetPointFact] = []
        self.forbidden_retries: list[int] = []
        self._slicer = SessionSlicer(window, self.origin) if window else None
        self._command_columns = ColumnReader(_PARAMETER, partial(_pick_command, pose_type, send, receive))
        self._result_columns = ColumnReader(_RESULT, partial(_pick_result, pose_type, receive))
        self._last_poses = np.full((2, len(self.axes)), np.nan)  # the last two commanded poses
        self._largest_steps = np.zeros(len(self.axes))
        # serial of the last set point's first attempt, and number of retries of this set point
        self._last_sent = (-1, 0)
        self._sent = self._accepted = self._unanswered = self._open = 0
        self._not_followed = self._not_captured = self._buffer_full = 0
        self._retries: Counter[int] = Counter()
        self._late_replies = self._lost_replies = 0
        self._refused: Counter[int] = Counter()

    def add(self, rows: SetPointTable, batch: SetPointBatch) -> tuple[PoseColumns, PoseColumns]:
        commanded = self._command_columns.read(batch.requests, len(batch), len(self.axes))
        returned = self._result_columns.read(batch.results, len(batch), len(self.axes))
        cycles = self.timing.add(rows)
        steps = self._steps(commanded)
        seen = self._uncaptured(rows, batch) == 0
        slacks = self.buffer.add(rows, np.where(seen, steps[:-1], _UNKNOWN)) / 1e6
        if not self._sent:
            slacks[0] = np.nan
        in_motion = (steps[:-1] == _STEP) & (steps[1:] == _STEP) & seen
        self.pace.add(rows, cycles, in_motion, self.timing.grid.ms)
        self._count(rows, cycles)
        self.motion.add(rows, commanded, returned)
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
            open=self._open - self._not_followed - self._not_captured,
            not_followed=self._not_followed,
            not_captured=self._not_captured,
            buffer_full=self._buffer_full,
            after_end=after_end,
            retries=retries,
            by_retries={times: count for times, count in sorted(self._retries.items()) if count},
            retries_forbidden=retries if self.forbids_retries else 0,
            late_replies=self._late_replies,
            lost_replies=self._lost_replies,
        )

    def slices(self) -> tuple[tuple[SessionSlice, ...], int]:
        return ((), 0) if self._slicer is None else self._slicer.slices()

    def _uncaptured(self, rows: SetPointTable, batch: SetPointBatch) -> NDArray[np.int64]:
        """For each set point, return how many attempts between this set point and the previous set point were
        not captured. Skipped serials show these attempts.
        """
        serials = batch.requests.serials(len(batch))
        last_serial, last_retries = self._last_sent
        before = np.concatenate(((last_serial,), serials[:-1]))
        captured = 1 + np.concatenate(((last_retries,), rows.retries[:-1]))
        for index, attempts in batch.other_attempts.items():
            captured[index] += attempts
        self._last_sent = int(serials[-1]), int(rows.retries[-1])
        skipped = (serials - before) % _SERIALS - captured
        return np.where((before >= 0) & (skipped > 0) & (skipped <= _MOST_UNCAPTURED), skipped, 0)

    def _steps(self, commanded: PoseColumns) -> NDArray[np.int64]:
        """Return 1 for a set point to which the robot moves, 0 if the robot stands still, and -1 if unknown.
        The result begins with the last set point of the previous batch.

        A tiny step counts as standstill, because a smooth motion ends with tiny steps.
        """
        points = np.vstack((self._last_poses, commanded.poses))
        known = ~np.isnan(points).any(axis=1)
        sizes = np.abs(np.diff(points, axis=0))
        largest = np.fmax.accumulate(np.vstack((self._largest_steps, sizes)), axis=0)
        moves = (sizes > _TINY_STEP * largest[1:]).any(axis=1)
        self._last_poses, self._largest_steps = points[-2:], largest[-1]
        return np.where(known[1:] & known[:-1] & bool(self.axes), moves, _UNKNOWN)

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
                    self.refused_list.append(rows.fact(row, cycles))
            elif code == S_BUF_FULL:
                self._buffer_full += 1
        self._accepted += sent - without_reply - refused
        self._retries[0] += sent - len(rows.irregular)
        for _, call in rows.irregular:
            self._retries[call.retries] += 1
            self._count_irregular(call)

    def _count_irregular(self, call: Call) -> None:
        self._late_replies += len(call.late_replies)
        if call.lost_replies and call.verdict is not CallVerdict.CANNOT_TELL:
            self._lost_replies += len(call.lost_replies)
        self._not_followed += call.evicted
        self._not_captured += call.outcome is Outcome.NOT_CAPTURED
        if self.forbids_retries and len(self.forbidden_retries) < MAX_LISTED:
            self.forbidden_retries += [request.number for request in call.attempts[call.first_attempt_seen :]]
            del self.forbidden_retries[MAX_LISTED:]


def _pick_command(
    pose_type: PoseType | None, send: SendFormat | None, receive: ReceiveFormat | None, parameter: Variant
) -> PickedNumbers:
    pose = parse_set_point(parameter, pose_type, send, receive).pose
    return (pose.values if pose and pose.type is pose_type else ()), None


def _pick_result(pose_type: PoseType | None, receive: ReceiveFormat | None, result: Variant) -> PickedNumbers:
    feedback = parse_feedback(result, pose_type, receive)
    fitting = (pose.values for pose in feedback.poses if pose.type is pose_type)
    return next(fitting, ()), feedback.timestamp


def _first_pose(
    batch: SetPointBatch, pose_type: PoseType | None, send: SendFormat | None, receive: ReceiveFormat | None
) -> Pose | None:
    """Return the first readable pose of a known type in the first 16 set points."""
    for place in range(min(len(batch), 16)):
        parameter = command_parameter(Frame(batch.requests[place]).variants)
        if parameter is not None:
            pose = parse_set_point(parameter, pose_type, send, receive).pose
            if pose is not None and pose.type is not None:
                return pose
    return None
