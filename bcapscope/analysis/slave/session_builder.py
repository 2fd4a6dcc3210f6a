"""Build the facts of one slave-mode session from its set points."""

from __future__ import annotations

import copy
from collections.abc import Callable
from typing import NamedTuple, TypeAlias

import numpy as np

from bcapscope.analysis.slave.column_templates import PoseColumns
from bcapscope.analysis.slave.session_models import SessionModels, SlaveSetup
from bcapscope.analysis.slave.set_point_batch import SetPointBatch
from bcapscope.analysis.slave.set_point_table import SetPointTable, table_of
from bcapscope.analysis.slave.slave_session import CallFact, FrameTime, SessionExit, SlaveSession
from bcapscope.traffic.observation import Conversation

BATCH_SIZE = 4096
"""Set points that are processed together: enough to make columns worthwhile, one or two MB of them."""

_FAILURES = 0x80000000
_I4_ARGUMENT, _I4_SIZE = b"\x0a\x00\x00\x00\x03\x00", 14

SessionKey: TypeAlias = "tuple[Conversation, bytes]"
"""A client, and the argument by which it names the robot."""

SetPointHandler: TypeAlias = "Callable[[SetPointChunk], None]"
"""Receives the set points of all slave-mode sessions, some thousand at a time."""


class SlaveSessionBuilder:
    """Builds a slave-mode session while it may still go on.

    Attributes:
        key: Client that sends the set points, and its robot; before the first set point, the client that
            entered slave mode.
        mode: Value of the mode, and its source.
        entry_call: The slvChangeMode that began it; None if that was not seen.
        entered_at: Time of the reply to `entry_call`, ns since 1970.
        models: Models of the processed set points; None before the first.
        error_exit: Error that ended it, unless a later set point is accepted; None without one.
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
        self.models: SessionModels | None = None
        self.error_exit: SessionExit | None = None
        self.after_end = 0
        self.last_accepted: int | None = None
        self._window = window
        self._on_set_points = on_set_points
        self._first_set_point: FrameTime | None = None
        self._last_set_point: FrameTime | None = None
        self._last_activity = 0

    @property
    def conversation(self) -> Conversation:
        return self.key[0]

    @property
    def handle(self) -> bytes:
        """First argument of the set points, as raw bytes."""
        return self.key[1]

    @property
    def robot(self) -> int | None:
        known = self.handle[:6] == _I4_ARGUMENT and len(self.handle) == _I4_SIZE
        return int.from_bytes(self.handle[-4:], "little", signed=True) if known else None

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
        if self.batch:
            self._process(self.batch, slave_setup)
            self.batch.clear()

    def processed(self, slave_setup: SlaveSetup) -> SlaveSessionBuilder:
        """Return the builder as it is once the waiting set points are processed. This one is not changed."""
        if not self.batch:
            return self
        processed = copy.copy(self)
        processed._on_set_points = None
        # The models hold a few MB at most, however long the session is. Copying them takes 2 ms.
        processed.models = copy.deepcopy(self.models)
        processed._process(self.batch, slave_setup)
        processed.batch = SetPointBatch()
        return processed

    def _process(self, batch: SetPointBatch, slave_setup: SlaveSetup) -> None:
        if self.models is None:
            self._first_set_point = FrameTime(batch[0].frame, batch[0].time)
            self.models = SessionModels(self.conversation.transport, slave_setup, batch, self._window)
        self._last_set_point, self._last_activity = (
            FrameTime(batch[-1].frame, batch[-1].time),
            self.last_activity,
        )
        rows = table_of(batch, self.models.origin)
        accepted = np.flatnonzero(rows.answered & (rows.codes < _FAILURES))
        if len(accepted):
            self.last_accepted = rows.origin + int(rows.times[accepted[-1]])
        with np.errstate(all="ignore"):  # numbers from the wire may be infinite or too large to square
            commanded, returned = self.models.add(rows, batch)
        if self._on_set_points is not None:
            self._on_set_points(SetPointChunk(self, self.models, rows, commanded, returned))

    @np.errstate(all="ignore")  # as above
    def session(
        self, exit_: SessionExit, slave_setup: SlaveSetup, other_calls: tuple[CallFact, ...]
    ) -> SlaveSession:
        """Return the slave-mode session with this end, without the set points that wait."""
        models = self.models or SessionModels(
            self.conversation.transport, slave_setup, SetPointBatch(), self._window
        )
        slices, left_off = models.slices()
        first = self._first_set_point
        return SlaveSession(
            number=self.number,
            conversation=self.conversation,
            robot=self.robot,
            entry_call=self.entry_call,
            entered_at=self.began_at(exit_.time),
            mode=models.mode,
            send_format=models.slave_setup.send_format,
            receive_format=models.slave_setup.receive_format,
            first_set_point=first,
            last_set_point=self._last_set_point,
            exit=exit_,
            counts=models.counts(self.after_end),
            timing=models.timing.facts(),
            buffer=models.buffer.facts(),
            clock=models.clock.facts(),
            motion=models.motion.facts(models.timing.grid.ms, models.start_distance) if first else None,
            refused_set_points=tuple(models.refused_list),
            forbidden_retry_frames=tuple(models.forbidden_retries),
            other_calls=other_calls,
            slices=slices,
            slices_left_off=left_off,
            samples=models.sampler.samples(),
        )


class SetPointChunk(NamedTuple):
    """Successive set points of one slave-mode session, including refused ones.

    Attributes:
        models: Its models, which have processed these set points.
        commanded: Poses of the requests, one row per call.
        returned: Poses of the same type and time stamps in the replies, one row per call.
    """

    builder: SlaveSessionBuilder
    models: SessionModels
    table: SetPointTable
    commanded: PoseColumns
    returned: PoseColumns
