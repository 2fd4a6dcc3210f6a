"""How the two ends of a conversation use the reserved field, told from what they send."""

from __future__ import annotations

from typing import NamedTuple

from bcapscope.protocol.retry.reserved_convention import ReplyReserved, ReservedConvention

__all__ = ["ReplyReserved", "ReservedConvention", "ReservedFieldUsage"]


class ReservedFieldUsage(NamedTuple):
    """What is known about both ends so far.

    Attributes:
        convention: of the client.
        reply_reserved: of the server.
    """

    convention: ReservedConvention = ReservedConvention.UNKNOWN
    reply_reserved: ReplyReserved = ReplyReserved.UNKNOWN

    def after_first_on_tcp(self, serial: int, reserved: int) -> ReservedFieldUsage:
        """Learn from a request on TCP. Serial 1 with reserved 1 may be a version mark or the own serial."""
        if reserved == serial == 1:
            return self
        if reserved in (0, 1):
            return self._replace(convention=ReservedConvention.TCP1 if reserved else ReservedConvention.TCP0)
        return self._replace(
            convention=ReservedConvention.OWN if reserved == serial else ReservedConvention.UNKNOWN
        )

    def after_first_attempt(self, reserved: int) -> ReservedFieldUsage:
        """Learn from a first packet on UDP, whose reserved is 0 or its own serial."""
        if reserved:
            return self._replace(convention=ReservedConvention.OWN)
        return (
            self._replace(convention=ReservedConvention.UNKNOWN)
            if self.convention is ReservedConvention.OWN
            else self
        )

    def after_retry(
        self, origin: int, previous: int, reserved: int, starts_with_zero: bool
    ) -> ReservedFieldUsage:
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
            return self._replace(convention=ReservedConvention.CHAIN)
        if self.convention is ReservedConvention.OWN or not starts_with_zero:
            return self
        return self._replace(convention=ReservedConvention.SEED)

    def after_reply(self, request_reserved: int, reply_reserved: int) -> ReservedFieldUsage:
        """Learn from a reply to a request whose reserved was `request_reserved`."""
        if request_reserved == 0 or reply_reserved not in (0, request_reserved):
            return self
        return self._replace(reply_reserved=ReplyReserved.ECHOED if reply_reserved else ReplyReserved.ZERO)
