"""`python -m bcapscope.capture.sniffer INTERFACE`: capture with scapy, in a separate process.

The licences of scapy and google-re2 do not permit both libraries in one program. scapy is under the GPL,
version 2 only; the wheel of google-re2 contains code under the Apache License 2.0. bcapscope's filters use
google-re2. Therefore scapy runs in a separate process that loads only scapy and Python's standard library.

The scapy process writes records to a pipe at standard output: a `RECORD_HEADER`, then the record's data.
"""

from __future__ import annotations

import os
import signal
import struct
import sys
import time
from collections.abc import Iterator
from enum import IntEnum
from typing import Any, BinaryIO

RECORD_HEADER = struct.Struct("<BqI")
"""Head of a record: kind, number, and size of the data in bytes. The number is the time in ns since 1970 of a
`PACKET`, and the link type of a `READY`.
"""

READ_TIMEOUT = 0.25
"""Maximum time in s that a read waits for a packet. Whenever no packet came in this time, the sniffer writes
an `ALIVE` record, and bcapscope can handle Ctrl-C. If bcapscope has ended, the sniffer cannot write this
record, and ends too.
"""


class SnifferRecordKind(IntEnum):
    READY = 0
    PACKET = 1
    ALIVE = 2
    """No packet came for `READ_TIMEOUT`."""
    FORBIDDEN = 3
    ENDED = 4
    """The capture ended; the record's data is the reason as UTF-8."""


def captured_packets(scapy_socket: Any) -> Iterator[tuple[int, bytes] | None]:
    """Yield time (ns since 1970) and bytes of each packet. Yield None if no packet came in `READ_TIMEOUT`."""
    while True:
        if not scapy_socket.select([scapy_socket], READ_TIMEOUT):
            yield None
            continue
        _, data, seconds = scapy_socket.recv_raw()
        if data is not None:
            yield time.time_ns() if seconds is None else round(seconds * 1_000_000_000), bytes(data)


def main(name: str, out: BinaryIO) -> None:
    """Write captured packets to `out` until its reader closes the pipe."""

    def write(kind: SnifferRecordKind, number: int = 0, data: bytes = b"") -> None:
        out.write(RECORD_HEADER.pack(kind, number, len(data)) + data)
        out.flush()

    try:
        from scapy.all import conf, resolve_iface  # noqa: PLC0415 - takes a second

        scapy_socket = resolve_iface(name).l2listen()(iface=name)
        write(SnifferRecordKind.READY, conf.l2types.layer2num.get(scapy_socket.LL, 1))
        for packet in captured_packets(scapy_socket):
            if packet is None:
                write(SnifferRecordKind.ALIVE)
            else:
                write(SnifferRecordKind.PACKET, *packet)
    except BrokenPipeError:
        # Redirect stdout to os.devnull, because Python flushes stdout at exit and would report an error.
        os.dup2(os.open(os.devnull, os.O_WRONLY), out.fileno())
    except PermissionError:
        write(SnifferRecordKind.FORBIDDEN)
    except Exception as error:  # scapy raises its own exceptions, some of them undocumented
        write(
            SnifferRecordKind.ENDED,
            0,
            f"{getattr(error, 'strerror', None) or error}".encode("utf-8", "replace"),
        )


if __name__ == "__main__":
    # ignore Ctrl-C: the process that reads the pipe decides when this process ends
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    main(sys.argv[1], sys.stdout.buffer)
