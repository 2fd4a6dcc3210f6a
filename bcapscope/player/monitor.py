"""Work that the player does between two set points: poll for orders and report progress."""

from __future__ import annotations

from math import isfinite

from bcapscope.player.frame_recorder import FrameRecorder
from bcapscope.player.pacer import HaltedError, Pacer
from bcapscope.player.player_messages import Order, PlayProgress, PlayState, SetPointValues
from bcapscope.player.player_pipe import PlayerPipe
from bcapscope.player.set_point_sequence import SetPointSequence
from bcapscope.protocol.codec.frame import Frame
from bcapscope.protocol.slave_mode.poses import pose_numbers

PROGRESS_INTERVAL = 50_000_000
"""Time in ns from one progress report to the next."""


class PlayMonitor:
    """Polls for orders and reports the progress of `pacer`; no method waits."""

    pacer: Pacer

    def __init__(
        self, pipe: PlayerPipe, recorder: FrameRecorder, sequence: SetPointSequence, period: int
    ) -> None:
        self._pipe = pipe
        self._recorder = recorder
        self._sequence = sequence
        self._period = period
        self._next_report = 0

    def on_idle(self, now: int) -> None:
        """Poll for an order, and report progress if due; an order to halt raises HaltedError."""
        order = self._pipe.poll_order()
        if order is Order.HALT:
            raise HaltedError
        if order is Order.STOP:
            self._sequence.stop()
        if now >= self._next_report:
            self._next_report = now + PROGRESS_INTERVAL
            self._pipe.try_send(self.progress(now))

    def progress(self, now: int) -> PlayProgress:
        pacer, sequence = self.pacer, self._sequence
        left = max(0, sequence.total - sequence.index) * self._period / 1e9 if sequence.total else None
        return PlayProgress(
            PlayState.STOPPING if sequence.is_stopping else PlayState.PLAYING,
            sequence.index,
            sequence.total,
            0.0 if pacer.started_at is None else (now - pacer.started_at) / 1e9,
            None if sequence.is_stopping else left,
            pacer.lateness.estimated_spread(),
            pacer.counts,
            pacer.commanded,
            _pose_in(pacer.last_reply),
            self._recorder.last_sent,
            self._recorder.last_received,
            pacer.cycle.bins(),
        )


def _pose_in(reply: Frame | None) -> SetPointValues:
    """Return the pose in a reply; () if there is none, or if it holds NaN, which JSON cannot carry."""
    if reply is None or not reply.arguments:
        return ()
    row = pose_numbers(reply.arguments[0].variant) or ()
    return row if all(map(isfinite, row)) else ()
