"""Detect which end of a conversation is the server.

No field of a frame names the server, but ports and content usually show which end is the server.
"""

from __future__ import annotations

from collections.abc import Collection

from bcapscope.protocol.codec.frame import EOT, LARGEST_FRAME, SMALLEST_FRAME, SOH, Frame, Malformed
from bcapscope.protocol.codec.stream_splitter import MAX_RESYNC_ARGUMENTS
from bcapscope.protocol.codec.variant import VT
from bcapscope.protocol.tables.function_table import FUNCTIONS
from bcapscope.protocol.tables.hresult import S_EXECUTING, S_FALSE, S_OK
from bcapscope.traffic.observation import Direction, ServerEvidence, ServerEvidenceKind

BCAP_PORTS = frozenset({5007})
"""Ports on which controllers listen, UDP and TCP (orin_bcap C/include/bcap_common.h)."""

SENT_TYPES: dict[str, tuple[int, ...]] = {
    "VT_I4": (VT.I4, VT.UI4, VT.I2),
    "VT_R4": (VT.R4, VT.R8),
    "VT_BSTR": (VT.BSTR,),
}
"""For each argument type in the function table, the VARIANT types that clients send. An argument declared as
VARIANT may have any type.
"""


def server_index_by_port(ports: Collection[int], first: int, second: int) -> int | None:
    """Return the index, 0 or 1, of the port that is in `ports`; None if both ports are in `ports`, or neither
    is.
    """
    known = (first in ports, second in ports)
    return known.index(True) if sum(known) == 1 else None


def direction_evidence(item: Frame | Malformed) -> tuple[Direction, ServerEvidence] | None:
    """Return the direction that the content proves, and the evidence; None if the content proves nothing.

    A code of 0 or 0x900, and a code with the top bit set, can only be a result code. The code 1 with one
    string as argument is Service_Start, not S_FALSE. Any other function id proves that a frame is a request
    only if the arguments fit the function.
    """
    if isinstance(item, Malformed) or item.problems:
        return None
    if item.code in (S_OK, S_EXECUTING) or item.code & 0x80000000:
        return Direction.RESPONSE, ServerEvidence(ServerEvidenceKind.RESULT, item.code)
    if item.code in FUNCTIONS and _arguments_fit(item):
        return Direction.REQUEST, ServerEvidence(ServerEvidenceKind.CALL, item.code)
    return None


def _arguments_fit(frame: Frame) -> bool:
    """Return whether a frame must be a request: its arguments fit its function, and rule out a reply with
    S_FALSE."""
    params = FUNCTIONS[frame.code].params
    arguments = frame.arguments
    if len(arguments) != len(params) or (frame.code == S_FALSE and not arguments):
        return False
    return all(
        param.type == "VARIANT" or argument.variant.vt in SENT_TYPES[param.type]
        for param, argument in zip(params, arguments, strict=True)
    )


def may_begin_frame(data: bytes) -> bool:
    """Return whether `data` could be the first bytes of a b-CAP frame in a stream."""
    if data[:1] != bytes((SOH,)):
        return False
    length = int.from_bytes(data[1:5], "little")
    if len(data) >= 5 and not SMALLEST_FRAME <= length <= LARGEST_FRAME:
        return False
    if len(data) >= 15 and int.from_bytes(data[13:15], "little") > MAX_RESYNC_ARGUMENTS:
        return False
    return len(data) < length or len(data) < 5 or data[length - 1] == EOT


def is_whole_frames(data: bytes) -> bool:
    start = 0
    while start < len(data):
        stop = start + int.from_bytes(data[start + 1 : start + 5], "little")
        if data[start] != SOH or not start + SMALLEST_FRAME <= stop <= len(data) or data[stop - 1] != EOT:
            return False
        start = stop
    return bool(data)
