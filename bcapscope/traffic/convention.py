"""How the two ends of a conversation use the reserved field, told from what they send."""

from __future__ import annotations

from typing import NamedTuple

from bcapscope.protocol.convention import Convention, ReplyReserved

__all__ = ["Convention", "Habits", "ReplyReserved"]


class Habits(NamedTuple):
    """What is known about both ends so far.

    Attributes:
        convention: of the client.
        replies: of the server.
    """

    convention: Convention = Convention.UNKNOWN
    replies: ReplyReserved = ReplyReserved.UNKNOWN

    def after_first_on_tcp(self, serial: int, reserved: int) -> Habits:
        """Learn from a request on TCP. Serial 1 with reserved 1 may be a version mark or the own serial."""
        if reserved == serial == 1:
            return self
        if reserved in (0, 1):
            return self._replace(convention=Convention.TCP1 if reserved else Convention.TCP0)
        return self._replace(convention=Convention.OWN if reserved == serial else Convention.UNKNOWN)

    def after_first(self, reserved: int) -> Habits:
        """Learn from a first packet on UDP, whose reserved is 0 or its own serial."""
        if reserved:
            return self._replace(convention=Convention.OWN)
        return self._replace(convention=Convention.UNKNOWN) if self.convention is Convention.OWN else self

    def after_retry(self, origin: int, previous: int, reserved: int, starts_with_zero: bool) -> Habits:
        """Learn from a retry.

        Args:
            origin: serial of the first try, as seen or as its retries name it.
            previous: serial of the try before this one.
            reserved: of this retry.
            starts_with_zero: a first packet of this client was seen, with reserved 0.
        """
        if origin == previous or reserved not in (origin, previous):
            return self
        if reserved == previous:
            return self._replace(convention=Convention.CHAIN)
        if self.convention is Convention.OWN or not starts_with_zero:
            return self
        return self._replace(convention=Convention.SEED)

    def after_reply(self, asked: int, answered: int) -> Habits:
        """Learn from a reply to a request whose reserved was `asked`."""
        if asked == 0 or answered not in (0, asked):
            return self
        return self._replace(replies=ReplyReserved.ECHOED if answered else ReplyReserved.ZERO)
