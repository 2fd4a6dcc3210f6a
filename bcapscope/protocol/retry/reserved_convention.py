"""Conventions for the reserved field, at both ends of a conversation.

Papers and libraries disagree about the field (DENSO Wave 2009, How to use the Slave mode; orin_bcap
C/src/bCAPClient/bcap_client.c and the C# and Java clients; the older C client in start-jsk/denso b-Cap.c).
"""

from __future__ import annotations

from enum import StrEnum


class ReservedConvention(StrEnum):
    """What a client writes into the reserved field of its requests."""

    UNKNOWN = "unknown"
    """Not determined yet. A first attempt with 0 fits both `SEED` and `CHAIN`. The second attempt carries the
    same number in both, so only a third attempt distinguishes them."""
    SEED = "seed"
    """0 in the first attempt, then the serial of the first attempt in every retry (DENSO Wave 2009)."""
    OWN = "own"
    """The frame's own serial in the first attempt, then the first attempt's serial in every retry (orin_bcap
    C, C#, Java)."""
    CHAIN = "chain"
    """0 in the first attempt, then the serial of the previous attempt (the older C client)."""
    TCP0 = "tcp0"
    """0 in every request, over TCP, where clients do not retry."""
    TCP1 = "tcp1"
    """1 in every request, over TCP: a version mark (keioku/bcap-python)."""


def client_conventions(datagrams: bool) -> tuple[ReservedConvention, ...]:
    """Return the conventions that a client may use over UDP (`datagrams`) or TCP, the usual one first."""
    if datagrams:
        return ReservedConvention.SEED, ReservedConvention.OWN, ReservedConvention.CHAIN
    return ReservedConvention.TCP0, ReservedConvention.TCP1


class ReplyReserved(StrEnum):
    """What a controller writes into the reserved field of its replies."""

    UNKNOWN = "unknown"
    """Not determined yet: all requests answered so far had 0."""
    ZERO = "zero"
    """Always 0 (orin_bcap C/src/bCAPServer/bcap_server.c)."""
    ECHOED = "echoed"
    """The value of the request (DENSO Wave 2009)."""
