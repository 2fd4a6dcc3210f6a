"""Build the facts of one slave-mode session from its set points."""

from __future__ import annotations

import copy
from collections.abc import Callable
from typing import NamedTuple, TypeAlias

import numpy as np

from bcapscope.analysis.slave.column_templates import PoseColumns
from bcapscope.analysis.slave.motion_model import KnownPosition
from bcapscope.analysis.slave.session_models import SessionModels, SlaveSetup
from bcapscope.analysis.slave.set_point_batch import SetPointBatch
from bcapscope.analysis.slave.set_point_table import SetPointTable, table_of
from bcapscope.analysis.slave.slave_session import CallFact, FrameTime, SessionExit, SlaveSession
from bcapscope.traffic.observation import Conversation

BATCH_SIZE = 4096
"""Number of set points that are processed together. Larger batches need over 2 MB and are not faster."""

_FAILURES = 0x80000000
_I4_ARGUMENT, _I4_SIZE = b"\x0a\x00\x00\x00\x03\x00", 14

SessionKey: TypeAlias = "tuple[Conversation, bytes]"
"""The conversation of a client, and the raw bytes of the robot's handle."""

SetPointHandler: TypeAlias = "Callable[[SetPointChunk], None]"


class SlaveSessionBuilder:
    """Builds the facts of a slave-mode session, even while the session continues.

    Attributes:
        key: Conversation and robot handle of the client that sends set points. Before the first set point,
            `key` refers to the client that entered slave mode.
        entered_at: Time of the reply to `entry_call`, ns since 1970; without a reply, time of its request.
        error_exit: End of the session, if an error ended the session and no later set point was accepted.
        after_end: Number of set points that were refused or unanswered because the session had ended.
        last_accepted: Time when the latest accepted set point was first sent, ns since 1970.
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
        self.position: KnownPosition | None = None
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
        """The robot's handle as raw bytes: the first argument of every set point."""
        return self.key[1]

    @property
    def robot(self) -> int | None:
        known = self.handle[:6] == _I4_ARGUMENT and len(self.handle) == _I4_SIZE
        return int.from_bytes(self.handle[-4:], "little", signed=True) if known else None

    @property
    def last_activity(self) -> int:
        """Latest time of a set point, of a reply or of `entered_at`, ns since 1970; 0 if unknown."""
        last = max(self.batch[-1].time, self.batch[-1].reply_time) if self.batch else self._last_activity
        return max(last, self.entered_at or 0)

    def began_at(self, ended_at: int) -> int:
        if self.entered_at is not None:
            return self.entered_at
        if self._first_set_point is not None:
            return self._first_set_point.time
        return self.batch[0].time if self.batch else ended_at

    def process_batch(self, slave_setup: SlaveSetup) -> None:
        """Process and empty `batch`. Only the first batch of a session uses `slave_setup`."""
        if self.batch:
            self._process(self.batch, slave_setup)
            self.batch.clear()

    def processed(self, slave_setup: SlaveSetup) -> SlaveSessionBuilder:
        """Return a builder that has processed `batch`. This builder stays unchanged."""
        if not self.batch:
            return self
        processed = copy.copy(self)
        processed._on_set_points = None
        # Copying is cheap: even for a long session, the models use at most a few MB, and the copy takes 2 ms.
        processed.models = copy.deepcopy(self.models)
        processed._process(self.batch, slave_setup)
        processed.batch = SetPointBatch()
        return processed

    def _process(self, batch: SetPointBatch, slave_setup: SlaveSetup) -> None:
        if self.models is None:
            self._first_set_point = FrameTime(batch[0].frame, batch[0].time)
            self.models = SessionModels(self.conversation.transport, slave_setup, batch, self._window)
        self._last_set_point = FrameTime(batch[-1].frame, batch[-1].time)
        self._last_activity = self.last_activity
        rows = table_of(batch, self.models.origin)
        accepted = np.flatnonzero(rows.answered & (rows.codes < _FAILURES))
        if len(accepted):
            self.last_accepted = rows.origin + int(rows.times[accepted[-1]])
        with np.errstate(all="ignore"):  # a number from the wire may be infinite, or too large to square
            commanded, returned = self.models.add(rows, batch)
        if self._on_set_points is not None:
            self._on_set_points(SetPointChunk(self, self.models, rows, commanded, returned))

    @np.errstate(all="ignore")  # numbers from the wire may be infinite, or too large to square
    def session(
        self, exit_: SessionExit, slave_setup: SlaveSetup, other_calls: tuple[CallFact, ...]
    ) -> SlaveSession:
        """Return the session with the figures of all processed set points. The figures do not include the set
        points that are still in `batch`.
        """
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
            pace=models.pace.facts(),
            buffer=models.buffer.facts(),
            clock=models.clock.facts(),
            motion=models.motion.facts(models.timing.grid.ms) if first else None,
            refused_set_points=tuple(models.refused_list),
            forbidden_retry_frames=tuple(models.forbidden_retries),
            other_calls=other_calls,
            slices=slices,
            slices_left_off=left_off,
            samples=models.sampler.samples(),
        )


class SetPointChunk(NamedTuple):
    """Successive set points of one slave-mode session, accepted or refused, after `models` processed them.

    Attributes:
        returned: Poses and time stamps in the replies; the poses have the same type as in the requests.
    """

    builder: SlaveSessionBuilder
    models: SessionModels
    table: SetPointTable
    commanded: PoseColumns
    returned: PoseColumns
