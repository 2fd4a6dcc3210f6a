"""A stay in slave mode in the making: takes set points in, keeps figures."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from typing import NamedTuple, TypeAlias

import numpy as np

from bcapscope.analysis.batch import Batch
from bcapscope.analysis.buffer import Arrivals, BufferModel, BufferRules
from bcapscope.analysis.clock import ControllerClock
from bcapscope.analysis.distribution import Floats
from bcapscope.analysis.forms import Columns, Forms, Picked, Picker
from bcapscope.analysis.generation import Clue
from bcapscope.analysis.moments import MOST_LISTED, SetPointFact, set_point_fact
from bcapscope.analysis.motion import MotionModel, Poses, Start
from bcapscope.analysis.points import Heed, Points
from bcapscope.analysis.rows import Rows, rows_of
from bcapscope.analysis.samples import Sampler
from bcapscope.analysis.slices import Slice, Slicer
from bcapscope.analysis.stay import Call, Counts, Exit, Format, Mode, Spot, Stay
from bcapscope.analysis.timing import TimingModel
from bcapscope.protocol.frame import Frame
from bcapscope.protocol.hresult import E_SLAVE_OVERFLOW, S_BUF_FULL, is_failure
from bcapscope.protocol.poses import Axis, Pose
from bcapscope.protocol.setpoints import split_feedback, split_set_point
from bcapscope.protocol.slaveformat import ReceiveFormat, SendFormat
from bcapscope.protocol.slavemode import Generation, PoseType, mode_pose_type, slave_mode
from bcapscope.protocol.variant import Variant
from bcapscope.traffic.exchange import Exchange
from bcapscope.traffic.observation import Conversation, Transport

BATCH = 4096
"""Set points that are looked at together: enough for columns to pay, a MB or two of them."""

MOST_CODES = 256
"""Different HRESULTs of refused set points that are counted apart; further ones count under 0."""

_PARAMETER = 2
_RESULT = 0
_UNKNOWN = -1
_FAILURES = 0x80000000
_I4_ARGUMENT, _I4_SIZE = b"\x0a\x00\x00\x00\x03\x00", 14

Key: TypeAlias = "tuple[Conversation, bytes]"
"""A client, and the argument by which it names the robot."""


class Position(NamedTuple):
    """Where the robot stood, as the controller said before.

    Attributes:
        type: of the pose.
        values: its numbers.
        known_by: what told it, one clause.
        frames: request and reply.
    """

    type: PoseType
    values: tuple[float, ...]
    known_by: str
    frames: tuple[int, ...]


class Setting(NamedTuple):
    """What was agreed before the first set point.

    Attributes:
        value: of the mode; None where it was not seen.
        known_by: what told it.
        clue: to the controller's generation.
        send: accepted send format; None where none was seen.
        receive: likewise.
        position: where the robot stood; None where that is not known.
    """

    value: int | None
    known_by: str
    clue: Clue
    send: Format | None
    receive: Format | None
    position: Position | None


class Course:
    """A stay that may go on.

    Attributes:
        number: of the stay.
        key: whose set points these are; of one that has none yet, who began it.
        mode: value, and what told it.
        entry: what began it; None where that was not seen.
        entered: when, by the reply to that.
        batch: set points that wait to be looked at.
        setting: fixed when the first set points are looked at.
        after_end: set points refused as a consequence, or not answered.
        last_accepted: when the latest of the set points looked at that were accepted was sent; None as long
            as there is none.
    """

    def __init__(
        self,
        number: int,
        key: Key,
        entry: Call | None,
        mode: tuple[int | None, str],
        *,
        window: int | None = None,
        heed: Heed | None = None,
    ) -> None:
        self.number = number
        self.key = key
        self.mode = mode
        self.entry = entry
        self.entered: int | None = None if entry is None else entry.replied or entry.time
        self.batch = Batch()
        self.setting: Setting | None = None
        self.after_end = 0
        self.last_accepted: int | None = None
        self._window = window
        self._heed = heed
        self._first: Spot | None = None
        self._last: Spot | None = None
        self._last_seen = 0
        self._figures: _Figures | None = None

    @property
    def conversation(self) -> Conversation:
        """Whose set points these are."""
        return self.key[0]

    @property
    def handle(self) -> bytes:
        """The first argument of the set points, as it stands in their frames."""
        return self.key[1]

    @property
    def last_seen(self) -> int:
        """When the latest set point was answered or else sent, not before the stay was entered; 0 if unknown.

        A client that does not wait for the reply to slvChangeMode has set points before that.
        """
        last = max(self.batch[-1].time, self.batch[-1].replied) if self.batch else self._last_seen
        return max(last, self.entered or 0)

    def began(self, ended: int) -> int:
        """Return when it began; where nothing tells, when it ended."""
        if self.entered is not None:
            return self.entered
        if self._first is not None:
            return self._first.time
        return self.batch[0].time if self.batch else ended

    def flush(self, setting: Setting) -> None:
        """Look at the set points that wait; `setting` counts where none were looked at before."""
        batch = self.batch
        if not batch:
            return
        if self._figures is None:
            self._first = Spot(batch[0].frame, batch[0].time)
            self.setting = setting
            self._figures = _Figures(self.conversation.transport, setting, batch, self._window)
        self._last, self._last_seen = Spot(batch[-1].frame, batch[-1].time), self.last_seen
        rows = rows_of(batch, self._figures.origin)
        accepted = np.flatnonzero(rows.answered & (rows.codes < _FAILURES))
        if len(accepted):
            self.last_accepted = rows.origin + int(rows.times[accepted[-1]])
        with np.errstate(all="ignore"):  # numbers from the wire may be infinite or too large to square
            commanded, returned = self._figures.add(rows, batch)
        batch.clear()
        if self._heed is not None:
            self._heed(self._points(self._figures, rows, commanded, returned))

    def _points(self, figures: _Figures, rows: Rows, commanded: Columns, returned: Columns) -> Points:
        setting = self.setting
        return Points(
            stay=self.number,
            conversation=self.conversation,
            robot=_handle_value(self.handle),
            mode=figures.mode,
            send=None if setting is None else setting.send,
            receive=None if setting is None else setting.receive,
            grid_ms=float(figures.timing.grid.ms),
            microseconds=figures.clock.microseconds,
            axes=figures.axes,
            rows=rows,
            commanded=commanded,
            returned=returned,
        )

    @np.errstate(all="ignore")  # as above
    def stay(self, exit_: Exit, setting: Setting, others: tuple[Call, ...]) -> Stay:
        """Tell all that is known; nothing is taken in afterwards."""
        self.flush(setting)
        setting = self.setting or setting
        figures = self._figures or _Figures(self.conversation.transport, setting, Batch(), self._window)
        slices, left_off = figures.slices()
        first = self._first
        return Stay(
            number=self.number,
            conversation=self.conversation,
            robot=_handle_value(self.handle),
            entry=self.entry,
            entered=self.began(exit_.time),
            mode=figures.mode,
            send_format=setting.send,
            receive_format=setting.receive,
            first=first,
            last=self._last,
            exit=exit_,
            counts=figures.counts(self.after_end),
            timing=figures.timing.facts(),
            buffer=figures.buffer.facts(),
            clock=figures.clock.facts(),
            motion=figures.motion.facts(figures.timing.grid.ms, figures.start) if first else None,
            refused_list=tuple(figures.refused_list),
            forbidden_retry_list=tuple(figures.forbidden_retries),
            other_calls=others,
            slices=slices,
            slices_left_off=left_off,
            samples=figures.sampler.samples(),
        )


def _handle_value(argument: bytes) -> int | None:
    known = argument[:6] == _I4_ARGUMENT and len(argument) == _I4_SIZE
    return int.from_bytes(argument[-4:], "little", signed=True) if known else None


def mode_of(setting: Setting, pose_type: PoseType | None) -> Mode:
    """Say what a mode means on this controller, as far as that is known."""
    value, generation = setting.value, setting.clue.generation
    meaning = None if value is None else slave_mode(value, generation or Generation.RC8)
    return Mode(
        value=value,
        known_by=setting.known_by if value is not None else "",
        generation=generation,
        generation_known_by=setting.clue.why,
        meaning=meaning,
        guessed=meaning is not None and generation is None,
        pose_type=pose_type,
    )


class _Figures:
    """All models of a stay, fed together."""

    def __init__(self, transport: Transport, setting: Setting, batch: Batch, window: int | None) -> None:
        self._setting = setting
        self.origin = batch[0].time if batch else 0
        pose = next(_poses_in(batch, setting), None)
        self._pose_type = pose.type if pose else _pose_type(setting)
        self.axes: tuple[Axis, ...] = pose.axes if pose else ()
        self.mode = mode_of(setting, self._pose_type)
        rules = BufferRules.of(self.mode.meaning, self.mode.guessed)
        self._paces = rules.paces
        self.forbids_retries = rules.overwrites and transport is Transport.UDP
        self.timing = TimingModel(self.mode.meaning, transport, rules.slots)
        self.buffer = BufferModel(rules, self.origin)
        self.clock = ControllerClock(None if setting.receive is None else setting.receive.microseconds)
        self.motion = MotionModel(self.axes, self._pose_type, pose.guessed if pose else False)
        self.sampler = Sampler(len(self.axes), self.origin)
        self.start = Start()
        self.refused_list: list[SetPointFact] = []
        self.forbidden_retries: list[int] = []
        self._slicer = Slicer(window, self.origin) if window else None
        self._axes = len(self.axes)
        self._begun = False
        self._commands = Forms(Picker(_PARAMETER, self._pick_command))
        self._results = Forms(Picker(_RESULT, self._pick_result))
        self._before = np.full((2, len(self.axes)), np.nan)  # the last two poses commanded
        self._sent = self._accepted = self._unanswered = self._open = self._let_go = self._full = 0
        self._retries: Counter[int] = Counter()
        self._late = self._lost = 0
        self._refused: Counter[int] = Counter()

    def add(self, rows: Rows, batch: Batch) -> tuple[Columns, Columns]:
        commanded = self._commands.read(batch.requests, len(batch), self._axes)
        returned = self._results.read(batch.results, len(batch), self._axes)
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

    def counts(self, after_end: int) -> Counts:
        retries = sum(times * count for times, count in self._retries.items())
        return Counts(
            sent=self._sent,
            accepted=self._accepted,
            refused=dict(self._refused),
            unanswered=self._unanswered,
            open=self._open - self._let_go,
            not_followed=self._let_go,
            buffer_full=self._full,
            after_end=after_end,
            retries=retries,
            by_retries={times: count for times, count in sorted(self._retries.items()) if count},
            retries_forbidden=retries if self.forbids_retries else 0,
            late_replies=self._late,
            lost_replies=self._lost,
        )

    def slices(self) -> tuple[tuple[Slice, ...], int]:
        if self._slicer is None:
            return (), 0
        return self._slicer.finish(), self._slicer.left_off

    def _pick_command(self, parameter: Variant) -> Picked:
        send, receive = _formats(self._setting)
        pose = split_set_point(parameter, self._pose_type, send, receive).pose
        return (pose.values if pose and pose.type is self._pose_type else ()), None

    def _pick_result(self, result: Variant) -> Picked:
        _, receive = _formats(self._setting)
        feedback = split_feedback(result, self._pose_type, receive)
        fitting = (pose.values for pose in feedback.poses if pose.type is self._pose_type)
        return next(fitting, ()), feedback.timestamp

    def _add_to_buffer(self, rows: Rows, commanded: Columns) -> Floats:
        points = np.vstack((self._before, commanded.poses))
        known = ~np.isnan(points).any(axis=1)
        differ = (points[1:] != points[:-1]).any(axis=1)
        moving = np.where(known[1:] & known[:-1] & (self._axes > 0), differ, _UNKNOWN)[:-1]
        self._before = points[-2:]
        entered = np.maximum(rows.arrivals, rows.replies) if self._paces else rows.arrivals
        slacks = self.buffer.add(
            Arrivals(rows.arrivals, entered, rows.codes, rows.frames, rows.reply_frames, moving)
        )
        found = slacks / 1e6
        if not self._begun:
            found[0] = np.nan
        return found

    def _count(self, rows: Rows, cycles: Floats) -> None:
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
                self._refused[code if code in self._refused or len(self._refused) < MOST_CODES else 0] += 1
                if len(self.refused_list) < MOST_LISTED:
                    self.refused_list.append(set_point_fact(rows, row, cycles))
            elif code == S_BUF_FULL:
                self._full += 1
        self._accepted += sent - without_reply - refused
        self._retries[0] += sent - len(rows.odd)
        for _, call in rows.odd:
            self._retries[call.retries] += 1
            self._count_trouble(call)

    def _count_trouble(self, call: Exchange) -> None:
        self._late += len(call.late_replies)
        self._lost += len(call.lost_replies)
        self._let_go += call.let_go
        if self.forbids_retries and len(self.forbidden_retries) < MOST_LISTED:
            self.forbidden_retries += [request.number for request in call.requests[call.origin_seen :]]
            del self.forbidden_retries[MOST_LISTED:]

    def _add_motion(self, rows: Rows, commanded: Columns, returned: Columns) -> None:
        accepted = returned.posed & rows.answered
        if not self._begun:
            self._begun = True
            self.start = self._where_it_began(rows, commanded, returned)
        self.motion.add(
            Poses(
                commanded=commanded.poses,
                readable=commanded.posed & (self._axes > 0) & (rows.codes != E_SLAVE_OVERFLOW),
                returned=returned.poses,
                answered=accepted,
                frames=rows.frames,
                times=rows.origin + rows.times,
            )
        )

    def _where_it_began(self, rows: Rows, commanded: Columns, returned: Columns) -> Start:
        """Compare the first set point with the pose in its reply, else with what was asked before."""
        goal, position = commanded.poses[0], self._setting.position
        if not self._axes or not np.isfinite(goal).all():
            return Start()
        if returned.posed[0] and np.isfinite(returned.poses[0]).all():
            frames = int(rows.frames[0]), int(rows.reply_frames[0])
            return Start(_distance(goal, returned.poses[0]), "the reply to the first set point", frames)
        if position and position.type is self._pose_type and len(position.values) >= self._axes:
            stood = np.array(position.values[: self._axes])
            if np.isfinite(stood).all():
                told = *position.frames, int(rows.frames[0])
                return Start(_distance(goal, stood), position.known_by, told)
        return Start()


def _distance(goal: Floats, stood: Floats) -> tuple[float, ...]:
    return tuple((goal - stood).tolist())


def _formats(setting: Setting) -> tuple[SendFormat | None, ReceiveFormat | None]:
    send, receive = setting.send, setting.receive
    return (
        None if send is None else SendFormat.parse(send.value),
        None if receive is None else ReceiveFormat.parse(receive.value, receive.microseconds),
    )


def _pose_type(setting: Setting) -> PoseType | None:
    return None if setting.value is None else mode_pose_type(setting.value)


def _poses_in(batch: Batch, setting: Setting) -> Iterator[Pose]:
    """Yield the poses of the first set points that have one of a known type."""
    send, receive = _formats(setting)
    pose_type = _pose_type(setting)
    for place in range(min(len(batch), 16)):
        parameter = parameter_of(Frame(batch.requests[place]))
        if parameter is not None:
            pose = split_set_point(parameter, pose_type, send, receive).pose
            if pose is not None and pose.type is not None:
                yield pose


def parameter_of(request: Frame) -> Variant | None:
    """Return vntParam of an ..._Execute request; None where there is none."""
    arguments = request.arguments
    return arguments[_PARAMETER].variant if len(arguments) > _PARAMETER else None
