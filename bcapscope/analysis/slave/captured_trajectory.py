"""Extract the trajectory of each slave-mode session from the captured set points.

Refused set points are left out, because the controller did not take them. Set points without a captured reply
are kept, because the controller may have taken them, and a gap in the trajectory would look like a jump.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from enum import StrEnum
from typing import NamedTuple, TypeAlias

import numpy as np

from bcapscope.analysis.slave.session_builder import SetPointChunk
from bcapscope.analysis.slave.session_detector import SlaveSessionDetector
from bcapscope.analysis.slave.slave_session import AcceptedFormat, KnownMode, SlaveSession
from bcapscope.messages import Message
from bcapscope.protocol.slave_mode.poses import Axis
from bcapscope.protocol.tables.hresult import is_failure
from bcapscope.traffic.bounded_dict import BoundedDict
from bcapscope.traffic.call import Call
from bcapscope.traffic.handle_tracker import TrackedObject
from bcapscope.traffic.observation import Conversation
from bcapscope.traffic.pipeline import PipelineSubscriber
from bcapscope.traffic.slave_mode_tracker import is_set_point

MAX_NOT_SELECTED = 64 * 2048


class LeftOutReason(StrEnum):
    REFUSED = "refused"
    AFTER_END = "after-end"
    UNREADABLE = "unreadable"
    NOT_SELECTED = "not-selected"

    @property
    def message(self) -> Message:
        return Message(f"trajectory.left-out.{self.value}")


@dataclass(frozen=True, slots=True)
class CapturedTrajectory:
    """Facts about a trajectory that was captured in a slave-mode session.

    Attributes:
        session_number: Number of the slave-mode session, as in the output of ``slave``.
        robot: Handle of the robot; None if the handle is unreadable.
        start: Time of the trajectory's first request, ns since 1970.
        has_stamps: Whether the replies contain the controller's time stamps.
        grid_ms: Cycle time that the client should keep, ms.
    """

    session_number: int
    conversation: Conversation
    robot: int | None
    mode: KnownMode
    send_format: AcceptedFormat | None
    receive_format: AcceptedFormat | None
    axes: tuple[Axis, ...]
    start: int
    has_stamps: bool
    grid_ms: float


class TrajectoryStep(NamedTuple):
    """One set point, which the client may have sent several times.

    Attributes:
        time: Time of the first request, ns since 1970.
        reply_time: Time of the accepted reply, ns since 1970; None if no reply was captured.
        returned: Pose in the reply, one number per axis; () if the reply has no pose.
        stamp: The controller's time stamp in the reply, ms; None if the reply has no time stamp.
    """

    call: int
    time: int
    reply_time: int | None
    retries: int
    hresult: int | None
    commanded: tuple[float, ...]
    returned: tuple[float, ...]
    stamp: float | None


TrajectoryPiece: TypeAlias = "tuple[CapturedTrajectory, Sequence[TrajectoryStep]]"
"""A trajectory, and some of its set points in the order of the trajectory."""


class TrajectoryExtractor(PipelineSubscriber):
    """Appends the set points of completed calls to the list `ready`. The extractor never removes set points
    from `ready`, so the caller must empty `ready` regularly.
    """

    def __init__(
        self,
        is_selected: Callable[[Call], bool] | None = None,
        is_selected_client: Callable[[Conversation], bool] | None = None,
    ) -> None:
        """Create an extractor. It ignores the set points of all clients that `is_selected_client` rejects.
        For the other clients, `left_out` includes the set points that `is_selected` rejects.
        """
        self._is_selected = is_selected
        self._is_selected_client = is_selected_client
        self._detector = SlaveSessionDetector(on_set_points=self._on_set_points)
        self._by_session: dict[int, CapturedTrajectory] = {}
        self.ready: list[TrajectoryPiece] = []
        self.set_points = self._step_count = 0
        self._left_out: Counter[LeftOutReason] = Counter()
        # `Call.number` of each set point that `is_selected` rejected, until the set point is processed
        self._not_selected: BoundedDict[int, None] = BoundedDict(MAX_NOT_SELECTED)

    def on_call(self, call: Call, target: TrackedObject | None) -> None:
        if is_set_point(call.kind):
            self._count_set_point(call)
        self._drop_sessions(self._detector.add_call(call))

    def on_set_points(self, calls: Sequence[Call]) -> None:
        for call in calls:
            self._count_set_point(call)
        self._drop_sessions(self._detector.add_set_points(calls))

    def finish(self) -> None:
        """Append the remaining set points to `ready`. Call this method when the traffic has ended."""
        self._detector.process_waiting()

    @property
    def left_out(self) -> Mapping[LeftOutReason, int]:
        """Number of set points that were left out, for each reason; final only after `finish`."""
        counted = dict(self._left_out)
        after = self.set_points - self._step_count - sum(counted.values())
        return {**counted, LeftOutReason.AFTER_END: after} if after else counted

    def _count_set_point(self, call: Call) -> None:
        if self._is_selected_client is not None and not self._is_selected_client(call.conversation):
            return
        self.set_points += 1
        code = call.hresult
        if code and is_failure(code):
            self._left_out[LeftOutReason.REFUSED] += 1
        elif self._is_selected is not None and not self._is_selected(call):
            self._not_selected[call.number] = None

    def _drop_sessions(self, sessions: Sequence[SlaveSession]) -> None:
        for session in sessions:
            self._by_session.pop(session.number, None)

    def _on_set_points(self, points: SetPointChunk) -> None:
        if self._is_selected_client is not None and not self._is_selected_client(points.builder.conversation):
            return
        codes = enumerate(points.table.codes.tolist())
        rows = [row for row, code in codes if not (code and is_failure(code)) and self._is_step(points, row)]
        if not rows:
            return
        known = self._by_session.get(points.builder.number)
        if known is None:
            known = self._by_session[points.builder.number] = _begin(points, rows[0])
        self._step_count += len(rows)
        self.ready.append((known, tuple(_trajectory_steps(points, rows))))

    def _is_step(self, points: SetPointChunk, row: int) -> bool:
        call = points.table.calls[row]
        if call in self._not_selected:
            del self._not_selected[call]
            self._left_out[LeftOutReason.NOT_SELECTED] += 1
            return False
        if not points.models.axes or not points.commanded.has_pose[row]:
            self._left_out[LeftOutReason.UNREADABLE] += 1
            return False
        return True


def _begin(points: SetPointChunk, row: int) -> CapturedTrajectory:
    builder, models = points.builder, points.models
    return CapturedTrajectory(
        session_number=builder.number,
        conversation=builder.conversation,
        robot=builder.robot,
        mode=models.mode,
        send_format=models.slave_setup.send_format,
        receive_format=models.slave_setup.receive_format,
        axes=models.axes,
        start=points.table.origin + int(points.table.times[row]),
        has_stamps=bool((~np.isnan(points.returned.stamps)).any()),
        grid_ms=float(models.timing.grid.ms),
    )


def _trajectory_steps(points: SetPointChunk, rows: Sequence[int]) -> Iterator[TrajectoryStep]:
    unit = 1000 if points.models.clock.microseconds else 1
    commanded, returned = points.commanded.poses.tolist(), points.returned.poses.tolist()
    stamps, posed = points.returned.stamps.tolist(), points.returned.has_pose.tolist()
    origin, calls, times = points.table.origin, points.table.calls, points.table.times.tolist()
    answered, replies = points.table.answered.tolist(), points.table.replies.tolist()
    codes, retries = points.table.codes.tolist(), points.table.retries.tolist()
    for row in rows:
        stamp = stamps[row]
        yield TrajectoryStep(
            call=calls[row],
            time=origin + times[row],
            reply_time=origin + replies[row] if answered[row] else None,
            retries=retries[row],
            hresult=codes[row] if answered[row] else None,
            commanded=tuple(commanded[row]),
            returned=tuple(returned[row]) if posed[row] else (),
            stamp=None if math.isnan(stamp) else stamp / unit,
        )
