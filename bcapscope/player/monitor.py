"""What is done beside sending set points: orders are looked for, and progress is told."""

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
"""ns from one telling to the next."""


class PlayMonitor:
    """Does it, quickly, each time it is called.

    Attributes:
        pacer: that is watched.
    """

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
        """Look for orders, and tell of progress when it is time to.

        Raises:
            HaltedError: that is the order.
        """
        order = self._pipe.poll_order()
        if order is Order.HALT:
            raise HaltedError
        if order is Order.STOP:
            self._sequence.stop()
        if now >= self._next_report:
            self._next_report = now + PROGRESS_INTERVAL
            self._pipe.try_send(self.progress(now))

    def progress(self, now: int) -> PlayProgress:
        """Return how far it is."""
        pacer, course = self.pacer, self._sequence
        left = max(0, course.total - course.index) * self._period / 1e9 if course.total else None
        return PlayProgress(
            PlayState.STOPPING if course.is_stopping else PlayState.PLAYING,
            course.index,
            course.total,
            0.0 if pacer.started_at is None else (now - pacer.started_at) / 1e9,
            None if course.is_stopping else left,
            pacer.lateness.estimated_spread(),
            pacer.counts,
            pacer.commanded,
            _pose_in(pacer.last_reply),
            self._recorder.last_sent,
            self._recorder.last_received,
            pacer.cycle.bins(),
        )


def _pose_in(reply: Frame | None) -> SetPointValues:
    """Read the pose out of a reply; nothing where it holds none, or NaN, which no message carries."""
    if reply is None or not reply.arguments:
        return ()
    row = pose_numbers(reply.arguments[0].variant) or ()
    return row if all(map(isfinite, row)) else ()
