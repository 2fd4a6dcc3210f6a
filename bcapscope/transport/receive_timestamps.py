"""Receive times that the kernel measures. Delays in this process do not change these times."""

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
"""Ancillary data of a received message, with the receive time if the kernel reports it."""

ReceiveFunction: TypeAlias = Callable[[int, int], tuple[bytes, AncillaryData, int, Any]]
"""The signature of `socket.recvmsg`."""

ANCILLARY_SIZE = 64
"""Size of the buffer for ancillary data, bytes."""

_SO_TIMESTAMPNS = 35  # asm-generic/socket.h of Linux
_TIMESPEC = struct.Struct("@ll")


def enable_receive_timestamps(sock: socket.socket) -> None:
    """Ask the kernel to report receive times; do nothing on systems other than Linux."""
    if sys.platform == "linux":
        with suppress(OSError):
            sock.setsockopt(socket.SOL_SOCKET, _SO_TIMESTAMPNS, 1)


def receive_function(sock: socket.socket) -> ReceiveFunction:
    """Return the socket's `recvmsg`, or a replacement that returns no ancillary data."""
    return getattr(sock, "recvmsg", None) or partial(_receive_without_ancillary, sock)


def _receive_without_ancillary(
    sock: socket.socket, most: int, _: int
) -> tuple[bytes, AncillaryData, int, Any]:
    data, address = sock.recvfrom(most)
    return data, [], 0, address


def kernel_timestamp(ancillary: AncillaryData, now: int) -> int:
    """Return the kernel's receive time, else a nonzero `now`, else the current time; all in ns since 1970."""
    if not ancillary or len(ancillary[0][2]) != _TIMESPEC.size:
        return now or time.time_ns()
    seconds, nanoseconds = _TIMESPEC.unpack(ancillary[0][2])
    return int(seconds * 1_000_000_000 + nanoseconds)
