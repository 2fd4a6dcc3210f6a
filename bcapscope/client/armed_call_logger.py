"""Log the armed calls of a connection, and their replies, in the action log."""

from __future__ import annotations

import time

from bcapscope.client.action_log import ActionLog, LoggedConnection
from bcapscope.protocol.codec.frame import SMALLEST_FRAME, Frame
from bcapscope.protocol.guard import needs_arming
from bcapscope.traffic.call_kind import call_kind_of
from bcapscope.traffic.observation import Direction, Observation

_WHO = "user"
_FUNCTION_ID = 9


class ArmedCallLogger:
    """Logs the calls that need arming, from all frames of a connection.

    Of consecutive set points, the logger logs the first one like any other call, and later the number of set
    points. A set point that is sent again before any reply is a retry.
    """

    def __init__(self, log: ActionLog, connection: LoggedConnection) -> None:
        self._log = log
        self._connection = connection
        self._set_points = 0
        self._unanswered = b""

    def on_observation(self, observation: Observation) -> None:
        self.add_frame(
            observation.flow.direction is Direction.REQUEST, observation.item.raw, observation.time
        )

    def add_frame(self, sent: bool, raw: bytes, timestamp: int) -> None:
        """Process a frame that was sent or received; `timestamp` is ns since 1970-01-01 UTC."""
        if len(raw) < SMALLEST_FRAME:
            return
        frame = Frame(raw)
        if not sent:
            self._unanswered = b""
            self._log.log_reply(self._connection, frame, timestamp)
            return
        if (call_kind_of(frame).command or "").casefold() == "slvmove":
            is_retry, self._unanswered = raw[_FUNCTION_ID:] == self._unanswered, raw[_FUNCTION_ID:]
            self._set_points += not is_retry
            self._log.log_request(
                self._connection, frame, timestamp, _WHO, is_logged=self._set_points == 1 and not is_retry
            )
            return
        wanted = needs_arming(frame.code, frame.variants)
        if wanted:
            self.end_set_points(timestamp)
        self._log.log_request(self._connection, frame, timestamp, _WHO, wanted)

    def add_set_points(self, count: int) -> None:
        """Count set points that were sent without `add_frame`."""
        self._set_points += count

    def end_set_points(self, timestamp: int | None = None) -> None:
        """Log the number of set points since the last call, if any; `timestamp` is in ns, None means now."""
        count, self._set_points = self._set_points, 0
        if count:
            self._log.log_set_points(
                self._connection, count, time.time_ns() if timestamp is None else timestamp, _WHO
            )
