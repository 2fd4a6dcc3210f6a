"""Find the slave-mode sessions that contain selected set points."""

from __future__ import annotations

from collections.abc import Callable, Sequence

from bcapscope.analysis.slave.session_detector import SlaveSessionDetector
from bcapscope.analysis.slave.slave_session import SlaveSession
from bcapscope.traffic.call import Call
from bcapscope.traffic.handle_tracker import TrackedObject
from bcapscope.traffic.pipeline import PipelineSubscriber
from bcapscope.traffic.slave_mode_tracker import is_set_point


class SelectedSlaveSessions(PipelineSubscriber):
    """Finds the slave-mode sessions that contain set points which `is_selected` accepts. The found sessions
    contain no other set points. `is_selected` does not test other calls, because the class needs all of them
    to find where sessions begin and end. If `is_selected` is None, the class finds all sessions.
    """

    def __init__(
        self,
        is_selected: Callable[[Call], bool] | None,
        on_slave_session: Callable[[SlaveSession], object],
        window: int | None = None,
    ) -> None:
        self._is_selected = is_selected
        self._on_slave_session = on_slave_session
        self._detector = SlaveSessionDetector(window)

    def on_call(self, call: Call, target: TrackedObject | None) -> None:
        if self._is_selected is None or not is_set_point(call.kind) or self._is_selected(call):
            self._report(self._detector.add_call(call))

    def on_set_points(self, calls: Sequence[Call]) -> None:
        if self._is_selected is not None:
            calls = list(filter(self._is_selected, calls))
        if calls:
            self._report(self._detector.add_set_points(calls))

    def remaining_sessions(self, ended_at: int = 0) -> list[SlaveSession]:
        """Return the sessions not yet passed to `on_slave_session`, as if the traffic ended now."""
        return self._chosen(self._detector.remaining_sessions(ended_at))

    def _report(self, sessions: Sequence[SlaveSession]) -> None:
        for session in self._chosen(sessions):
            self._on_slave_session(session)

    def _chosen(self, sessions: Sequence[SlaveSession]) -> list[SlaveSession]:
        return [each for each in sessions if self._is_selected is None or each.first_set_point is not None]
