"""Live capture on an interface of this machine.

A packet socket of Linux (packet(7)) reports what scapy hides: nanoseconds, duplicates on the loopback
interface, and lost packets. On other systems, scapy captures through libpcap or BPF in a separate process.
"""

from __future__ import annotations

import errno
import os
import socket
import struct
import subprocess
import sys
from collections.abc import Callable, Iterator
from typing import TypeAlias

from bcapscope.capture.link_layer import LINUX_COOKED
from bcapscope.capture.packet import Interface, Packet
from bcapscope.capture.sniffer import READ_TIMEOUT, RECORD_HEADER, SnifferRecordKind
from bcapscope.errors import CaptureError
from bcapscope.messages import Message
from bcapscope.messages.os_errors import os_reason
from bcapscope.transport.receive_timestamps import ANCILLARY_SIZE, enable_receive_timestamps, kernel_timestamp

ANY_INTERFACE = "any"
"""Name that stands for all interfaces, as in tcpdump (Linux only)."""

_EXIT_TIMEOUT = 5.0
_LARGEST_PACKET = 262144
# in bytes; enough for 50,000 frames that arrive while this process gets no CPU time
_BUFFER_SIZE = 16 * 1024 * 1024
_ETH_P_ALL = 3
_SOL_PACKET, _PACKET_STATISTICS = 263, 6
_SO_RCVBUFFORCE = 33
_COOKED_HEADER = struct.Struct(">HHH8sH")


def open_live_capture(name: str) -> LiveCapture:
    """Start a capture on the interface `name`, such as `eth0` or `ANY_INTERFACE`. Raises CaptureError.

    Iterate over the capture to get packets as they arrive; the iteration raises CaptureError if the capture
    fails. The end of the `with` block ends the capture. `lost` is the number of packets that Linux dropped
    for lack of buffer space. `on_idle` is called when no packet arrived during `READ_TIMEOUT`.
    """
    known = [known for _, known in socket.if_nameindex()]
    if name not in known and (name != ANY_INTERFACE or sys.platform != "linux"):
        raise CaptureError(Message("capture.no-interface", name=name, known=", ".join(known)))
    try:
        return _PacketSocket(name) if hasattr(socket, "AF_PACKET") else _SnifferProcess(name)
    except PermissionError as error:
        raise CaptureError(_permission_help(name)) from error
    except OSError as error:
        raise CaptureError(Message("capture.cannot-capture", name=name, reason=os_reason(error))) from error


def _permission_help(name: str) -> Message:
    if sys.platform != "linux":
        return Message("capture.needs-administrator", name=name)
    python = os.path.realpath(sys.executable)
    return Message("capture.needs-rights", name=name, python=python)


class _PacketSocket:
    """Capture on Linux. The kernel delivers no link header, so this class adds a "cooked" one, as tcpdump
    does.
    """

    def __init__(self, name: str) -> None:
        self.on_idle: Callable[[], None] = lambda: None
        self._name = name
        self._lost = 0
        self._interfaces: dict[str, Interface] = {}
        # protocol 0: the socket receives no packets before `bind`
        everything = socket.htons(_ETH_P_ALL) if name == ANY_INTERFACE else 0
        self._socket = socket.socket(socket.AF_PACKET, socket.SOCK_DGRAM, everything)
        try:
            self._configure()
        except OSError:
            self._socket.close()
            raise

    def _configure(self) -> None:
        try:
            self._socket.setsockopt(socket.SOL_SOCKET, _SO_RCVBUFFORCE, _BUFFER_SIZE)
        except PermissionError:
            self._socket.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, _BUFFER_SIZE)
        enable_receive_timestamps(self._socket)
        self._socket.settimeout(READ_TIMEOUT)
        if self._name != ANY_INTERFACE:
            self._socket.bind((self._name, _ETH_P_ALL))

    @property
    def lost(self) -> int:
        _, lost = struct.unpack("II", self._socket.getsockopt(_SOL_PACKET, _PACKET_STATISTICS, 8))
        self._lost += lost  # the kernel resets its counter of dropped packets at each query
        return self._lost

    def __enter__(self) -> _PacketSocket:
        return self

    def __exit__(self, *_: object) -> None:
        self._socket.close()

    def __iter__(self) -> Iterator[Packet]:
        while True:
            try:
                data, ancillary, _, address = self._socket.recvmsg(_LARGEST_PACKET, ANCILLARY_SIZE)
            except TimeoutError:
                self.on_idle()
                continue
            except OSError as error:
                raise CaptureError(
                    Message("capture.ended", name=self._name, reason=os_reason(error))
                ) from error
            name, protocol, kind, hardware, mac = address
            if kind == socket.PACKET_OUTGOING and name == "lo":
                continue  # The loopback interface delivers each packet a second time, as an incoming packet.
            interface = self._interfaces.setdefault(name, Interface(LINUX_COOKED, name))
            header = _COOKED_HEADER.pack(kind, hardware, len(mac), mac[:8], protocol)
            yield kernel_timestamp(ancillary, 0), header + data, len(header) + len(data), interface, ()


class _SnifferProcess:
    """Capture with scapy in a separate process (see `capture.sniffer`)."""

    lost = 0

    def __init__(self, name: str) -> None:
        self.on_idle: Callable[[], None] = lambda: None
        self._name = name
        self._process = subprocess.Popen(
            [sys.executable, "-m", "bcapscope.capture.sniffer", name],
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL,
        )
        try:
            self._interface = Interface(self._wait_until_ready(), name)
        except BaseException:
            self.__exit__()
            raise

    def _wait_until_ready(self) -> int:
        """Return the link type; raise PermissionError or CaptureError if the process cannot capture."""
        kind, linktype, data = self._read_record()
        if kind == SnifferRecordKind.FORBIDDEN:
            raise PermissionError(errno.EPERM, os.strerror(errno.EPERM))
        if kind != SnifferRecordKind.READY:
            reason = data.decode("utf-8", "replace")
            raise CaptureError(Message("capture.cannot-capture", name=self._name, reason=reason))
        return linktype

    def _read_record(self) -> tuple[int, int, bytes]:
        assert self._process.stdout is not None
        head = self._process.stdout.read(RECORD_HEADER.size)
        if len(head) < RECORD_HEADER.size:
            return SnifferRecordKind.ENDED, 0, b"the capturing process has ended"
        kind, number, length = RECORD_HEADER.unpack(head)
        return kind, number, self._process.stdout.read(length)

    def __enter__(self) -> _SnifferProcess:
        return self

    def __exit__(self, *_: object) -> None:
        if self._process.stdout is not None:
            self._process.stdout.close()
        try:
            self._process.wait(_EXIT_TIMEOUT)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()

    def __iter__(self) -> Iterator[Packet]:
        while True:
            kind, when, data = self._read_record()
            if kind == SnifferRecordKind.PACKET:
                yield when, data, len(data), self._interface, ()
            elif kind == SnifferRecordKind.ALIVE:
                self.on_idle()
            else:
                reason = data.decode("utf-8", "replace")
                raise CaptureError(Message("capture.ended", name=self._name, reason=reason))


LiveCapture: TypeAlias = _PacketSocket | _SnifferProcess
