"""Find the slave-mode sessions of selected set points."""

from __future__ import annotations

from collections.abc import Callable, Sequence

from bcapscope.analysis.slave.session_detector import SlaveSessionDetector, is_set_point
from bcapscope.analysis.slave.slave_session import SlaveSession
from bcapscope.traffic.call import Call


class SelectedSlaveSessions:
    """Finds the slave-mode sessions of selected set points.

    All other calls still count for the start and end of these sessions.
    """

    def __init__(self, is_selected: Callable[[Call], bool] | None, window: int | None = None) -> None:
        """Create a detector.

        Args:
            is_selected: Returns whether a set point is selected; None for all set points, and for slave-mode
                sessions without set points.
            window: Length of a time slice, as in `SlaveSessionDetector`.
        """
        self._is_selected = is_selected
        self._detector = SlaveSessionDetector(window)

    def add_call(self, call: Call) -> Sequence[SlaveSession]:
        """Add a completed call; return the slave-mode sessions that are finished."""
        chosen = self._is_selected
        if chosen is None:
            return self._detector.add_call(call)
        if is_set_point(call) and not chosen(call):
            return ()
        return _with_set_points(self._detector.add_call(call))

    def remaining_sessions(self, ended_at: int = 0) -> Sequence[SlaveSession]:
        """Return the slave-mode sessions not yet returned, as `SlaveSessionDetector.remaining_sessions`."""
        sessions = self._detector.remaining_sessions(ended_at)
        return sessions if self._is_selected is None else _with_set_points(sessions)


def _with_set_points(sessions: Sequence[SlaveSession]) -> Sequence[SlaveSession]:
    return [session for session in sessions if session.first_set_point is not None]
