"""When datagrams, or pieces of a stream, came, as the system says: however late one looks."""

from __future__ import annotations

import socket
import struct
import sys
import time
from collections.abc import Callable
from contextlib import suppress
from functools import partial
from typing import Any, TypeAlias

AncillaryData: TypeAlias = list[tuple[int, int, bytes]]
"""What the system says of what is read: when it came, as far as we asked."""

ReceiveFunction: TypeAlias = Callable[[int, int], tuple[bytes, AncillaryData, int, Any]]
"""Like `socket.recvmsg`."""

ANCILLARY_SIZE = 64
"""Bytes for what the system says of what is read."""

_SO_TIMESTAMPNS = 35  # asm-generic/socket.h of Linux
_TIMESPEC = struct.Struct("@ll")


def enable_receive_timestamps(sock: socket.socket) -> None:
    """Have the system say when something comes; what it does not give is done without."""
    if sys.platform == "linux":
        with suppress(OSError):
            sock.setsockopt(socket.SOL_SOCKET, _SO_TIMESTAMPNS, 1)


def receive_function(sock: socket.socket) -> ReceiveFunction:
    """Return `recvmsg`, or what does the same where there is none."""
    return getattr(sock, "recvmsg", None) or partial(_receive_without_ancillary, sock)


def _receive_without_ancillary(
    sock: socket.socket, most: int, _: int
) -> tuple[bytes, AncillaryData, int, Any]:
    data, address = sock.recvfrom(most)
    return data, [], 0, address


def kernel_timestamp(ancillary: AncillaryData, now: int) -> int:
    """Return when it came, ns since 1970; `now`, or what the clock says, where nobody else does."""
    if not ancillary or len(ancillary[0][2]) != _TIMESPEC.size:
        return now or time.time_ns()
    seconds, nanoseconds = _TIMESPEC.unpack(ancillary[0][2])
    return int(seconds * 1_000_000_000 + nanoseconds)
