"""What the two ends of a conversation put into the reserved field.

The papers and libraries disagree about it (DENSO Wave 2009, How to use the Slave mode; orin_bcap
C/src/bCAPClient/bcap_client.c and the C# and Java clients; the older C client in start-jsk/denso b-Cap.c).
"""

from __future__ import annotations

from enum import StrEnum


class ReservedConvention(StrEnum):
    """What a client puts into reserved."""

    UNKNOWN = "unknown"
    """Nothing has told yet: a client that starts with 0 and was not seen to try three times may be `SEED` or
    `CHAIN`, since a second try carries the same number in both."""
    SEED = "seed"
    """0 first, then the serial of the first try in every retry (DENSO Wave 2009)."""
    OWN = "own"
    """The packet's own serial first, then that of the first try in every retry (orin_bcap C, C#, Java)."""
    CHAIN = "chain"
    """0 first, then the serial of the try before (the older C client)."""
    TCP0 = "tcp0"
    """TCP, where nothing is sent twice: 0."""
    TCP1 = "tcp1"
    """TCP: 1, a version mark (keioku/bcap-python)."""


class ReplyReserved(StrEnum):
    """What a server puts into reserved."""

    UNKNOWN = "unknown"
    """Only requests with 0 were answered."""
    ZERO = "zero"
    """0 (orin_bcap C/src/bCAPServer/bcap_server.c)."""
    ECHOED = "echoed"
    """What the request carried (DENSO Wave 2009)."""
