"""Log of the armed calls that a player reports in its messages."""

from __future__ import annotations

from bcapscope.client.armed_call_logger import ArmedCallLogger
from bcapscope.player.player_messages import ControllerInfo, FrameMessage, PlayEnded, PlayerMessage


class ArmedMessageLogger:
    """Logs the armed calls of a player to a real controller; ignores calls to bcapscope's simulator."""

    def __init__(self, logger: ArmedCallLogger) -> None:
        """Write to `logger`."""
        self._logger = logger
        self._is_simulator = False

    def on_message(self, message: PlayerMessage) -> None:
        if isinstance(message, ControllerInfo):
            self._is_simulator = message.simulator
        elif self._is_simulator:
            return
        elif isinstance(message, FrameMessage):
            self._logger.add_frame(message.sent, message.raw, message.time)
        elif isinstance(message, PlayEnded):
            self._logger.add_set_points(message.counts.sent)
            self._logger.end_set_points()
