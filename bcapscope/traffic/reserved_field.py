"""Find out from frames how a client and a controller use the reserved field."""

from __future__ import annotations

from typing import NamedTuple

from bcapscope.protocol.retry.reserved_convention import ReplyReserved, ReservedConvention

__all__ = ["ReplyReserved", "ReservedConvention", "ReservedFieldUsage"]


class ReservedFieldUsage(NamedTuple):
    """How client and controller use the reserved field, as far as the captured frames show."""

    convention: ReservedConvention = ReservedConvention.UNKNOWN
    reply_reserved: ReplyReserved = ReplyReserved.UNKNOWN

    def after_first_on_tcp(self, serial: int, reserved: int) -> ReservedFieldUsage:
        """Evaluate a request on TCP. Ignore a request with the serial 1 and the value 1 in the reserved
        field, because this value can be the serial or the protocol version.
        """
        if reserved == serial == 1:
            return self
        known = {serial: ReservedConvention.OWN, 0: ReservedConvention.TCP0, 1: ReservedConvention.TCP1}
        return self._replace(convention=known.get(reserved, ReservedConvention.UNKNOWN))

    def after_first_attempt(self, reserved: int) -> ReservedFieldUsage:
        """Evaluate a first attempt on UDP, whose reserved field holds 0 or the attempt's own serial."""
        if reserved:
            return self._replace(convention=ReservedConvention.OWN)
        if self.convention is ReservedConvention.OWN:
            return self._replace(convention=ReservedConvention.UNKNOWN)
        return self

    def after_retry(
        self, origin: int, previous: int, reserved: int, starts_with_zero: bool
    ) -> ReservedFieldUsage:
        """Evaluate a retry. `origin` and `previous` are the serials of the call's first attempt and previous
        attempt. `starts_with_zero`: whether the client's latest first attempt has 0 in the reserved field.
        """
        if origin == previous or reserved not in (origin, previous):
            return self
        if reserved == previous:
            return self._replace(convention=ReservedConvention.CHAIN)
        if self.convention is ReservedConvention.OWN or not starts_with_zero:
            return self
        return self._replace(convention=ReservedConvention.SEED)

    def after_reply(self, request_reserved: int, reply_reserved: int) -> ReservedFieldUsage:
        if request_reserved == 0 or reply_reserved not in (0, request_reserved):
            return self
        return self._replace(reply_reserved=ReplyReserved.ECHOED if reply_reserved else ReplyReserved.ZERO)
