"""Conventions by which clients and controllers fill the reserved field.

DENSO's papers and libraries use the field differently (DENSO Wave 2009, How to use the Slave mode; orin_bcap
C/src/bCAPClient/bcap_client.c and the C# and Java clients; the older C client in start-jsk/denso b-Cap.c).
"""

from __future__ import annotations

from enum import StrEnum


class ReservedConvention(StrEnum):
    """Value that a client writes into the reserved field of its requests."""

    UNKNOWN = "unknown"
    """The client's convention is not known yet. The first two attempts are the same in `SEED` and `CHAIN`, so
    only a third attempt shows which convention the client follows."""
    SEED = "seed"
    """0 in the first attempt, then the serial of the first attempt in every retry (DENSO Wave 2009)."""
    OWN = "own"
    """The frame's own serial in the first attempt, then the first attempt's serial in every retry (orin_bcap
    C, C#, Java)."""
    CHAIN = "chain"
    """0 in the first attempt, then the serial of the previous attempt (the older C client)."""
    TCP0 = "tcp0"
    """Over TCP, where clients do not retry: 0 in every request."""
    TCP1 = "tcp1"
    """Over TCP: 1 in every request, which states the protocol version (keioku/bcap-python)."""


def client_conventions(datagrams: bool) -> tuple[ReservedConvention, ...]:
    """Return the conventions that a client may use over UDP (`datagrams`) or TCP, the usual one first."""
    if datagrams:
        return ReservedConvention.SEED, ReservedConvention.OWN, ReservedConvention.CHAIN
    return ReservedConvention.TCP0, ReservedConvention.TCP1


class ReplyReserved(StrEnum):
    """Value that a controller writes into the reserved field of its replies."""

    UNKNOWN = "unknown"
    """The convention is not known yet: all requests answered so far had 0 in the reserved field."""
    ZERO = "zero"
    """Always 0 (orin_bcap C/src/bCAPServer/bcap_server.c)."""
    ECHOED = "echoed"
    """The value of the request's reserved field (DENSO Wave 2009)."""
