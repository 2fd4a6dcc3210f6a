"""The armed calls of a player, taken from its messages for the action log."""

from __future__ import annotations

from bcapscope.client.armed_calls import ArmedCalls
from bcapscope.player.messages import Ended, Message, Packet, Peer


class ArmedMessages:
    """Logs what a player sends to a real controller; nothing of what it sends to our simulator."""

    def __init__(self, calls: ArmedCalls) -> None:
        """Log into `calls`."""
        self._calls = calls
        self._simulator = False

    def add(self, message: Message) -> None:
        """Take a message of the player."""
        if isinstance(message, Peer):
            self._simulator = message.simulator
        elif self._simulator:
            return
        elif isinstance(message, Packet):
            self._calls.add_frame(message.sent, message.raw, message.time)
        elif isinstance(message, Ended):
            self._calls.add_set_points(message.counts.sent)
            self._calls.end_set_points()
