"""What clients and controllers write into the reserved field.

DENSO's papers and libraries use different conventions (DENSO Wave 2009, How to use the Slave mode; orin_bcap
C/src/bCAPClient/bcap_client.c and the C# and Java clients; the older C client in start-jsk/denso b-Cap.c).
"""

from __future__ import annotations

from enum import StrEnum


class ReservedConvention(StrEnum):
    """Value that a client writes into the reserved field of its requests."""

    UNKNOWN = "unknown"
    """The client's convention is not known yet. `SEED` and `CHAIN` differ only from the third attempt on."""
    SEED = "seed"
    """0 in the first attempt, then the serial of the first attempt in every retry (DENSO Wave 2009)."""
    OWN = "own"
    """The serial of the first attempt, in every attempt including the first (orin_bcap C, C#, Java)."""
    CHAIN = "chain"
    """0 in the first attempt, then the serial of the previous attempt (the older C client)."""
    TCP0 = "tcp0"
    """Over TCP, where clients do not retry: 0 in every request."""
    TCP1 = "tcp1"
    """Over TCP: 1, the protocol version, in every request (keioku/bcap-python)."""


def client_conventions(datagrams: bool) -> tuple[ReservedConvention, ...]:
    """Return the conventions that clients use over UDP if `datagrams`, else over TCP; most usual first."""
    if datagrams:
        return ReservedConvention.SEED, ReservedConvention.OWN, ReservedConvention.CHAIN
    return ReservedConvention.TCP0, ReservedConvention.TCP1


class ReplyReserved(StrEnum):
    """Value that a controller writes into the reserved field of its replies."""

    UNKNOWN = "unknown"
    """Not known yet. `ZERO` and `ECHOED` differ only if the request's reserved field is not 0."""
    ZERO = "zero"
    """Always 0 (orin_bcap C/src/bCAPServer/bcap_server.c)."""
    ECHOED = "echoed"
    """The value of the request's reserved field (DENSO Wave 2009)."""
