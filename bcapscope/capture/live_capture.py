"""Live capture on an interface of this machine.

On Linux from a packet socket (packet(7)), which shows what scapy hides: time stamps to the nanosecond, which
packets of the loopback interface are seen a second time, and how many were lost. Elsewhere scapy captures
through libpcap or BPF, in a process of its own.
"""

from __future__ import annotations

import errno
import os
import socket
import struct
import subprocess
import sys
from collections.abc import Iterator
from typing import Protocol

from bcapscope.capture.link_layer import LINUX_COOKED
from bcapscope.capture.packet import Interface, Packet
from bcapscope.capture.sniffer import READ_TIMEOUT, RECORD_HEADER, SnifferRecordKind
from bcapscope.errors import CaptureError
from bcapscope.transport.receive_timestamps import ANCILLARY_SIZE, enable_receive_timestamps, kernel_timestamp

ANY_INTERFACE = "any"
"""All interfaces at once, as tcpdump calls it (Linux)."""

_EXIT_TIMEOUT = 5.0
_LARGEST_PACKET = 262144
_BUFFER_SIZE = 16 * 1024 * 1024  # some 50,000 frames, in case this process is not given the CPU for a while
_ETH_P_ALL = 3
_SOL_PACKET, _PACKET_STATISTICS = 263, 6
_SO_RCVBUFFORCE = 33
_COOKED_HEADER = struct.Struct(">HHH8sH")


class LiveCapture(Protocol):
    """An endless capture; also a context manager that ends it.

    Attributes:
        lost: packets that the system had no room for, as far as it tells.
    """

    @property
    def lost(self) -> int: ...

    def __enter__(self) -> LiveCapture: ...

    def __exit__(self, *_: object) -> None: ...

    def __iter__(self) -> Iterator[Packet]:
        """Yield packets as they pass, until interrupted.

        Raises:
            CaptureError: the interface went away.
        """
        ...


def open_live_capture(name: str) -> LiveCapture:
    """Begin to capture on an interface; packets from now on are kept until they are read.

    Args:
        name: of the interface, as the system has it, such as `eth0` or `lo`, or `ANY_INTERFACE`.

    Raises:
        CaptureError: there is no such interface, or the right to capture is missing.
    """
    known = [known for _, known in socket.if_nameindex()]
    if name not in known and (name != ANY_INTERFACE or sys.platform != "linux"):
        raise CaptureError(f"there is no interface {name}; there are: {', '.join(known)}")
    try:
        return _PacketSocket(name) if hasattr(socket, "AF_PACKET") else _SnifferProcess(name)
    except PermissionError as error:
        raise CaptureError(_permission_help(name)) from error
    except OSError as error:
        raise CaptureError(f"cannot capture on {name}: {error.strerror}") from error


def _permission_help(name: str) -> str:
    if sys.platform != "linux":
        return f"capturing on {name} needs administrator rights"
    python = os.path.realpath(sys.executable)
    return f"capturing on {name} needs rights: run as root, or once: sudo setcap cap_net_raw=ep {python}"


class _PacketSocket:
    """Linux: packets come without their link header and get that of a cooked capture, as tcpdump does."""

    def __init__(self, name: str) -> None:
        self._name = name
        self._lost = 0
        self._interfaces: dict[str, Interface] = {}
        everything = socket.htons(_ETH_P_ALL) if name == ANY_INTERFACE else 0  # 0: nothing before it is bound
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
        """Packets for which the socket's buffer had no room."""
        _, lost = struct.unpack("II", self._socket.getsockopt(_SOL_PACKET, _PACKET_STATISTICS, 8))
        self._lost += lost  # the kernel counts from the last time it was asked
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
                continue
            except OSError as error:
                raise CaptureError(f"capturing on {self._name} ended: {error.strerror}") from error
            name, protocol, kind, hardware, mac = address
            if kind == socket.PACKET_OUTGOING and name == "lo":
                continue  # the same packet is about to come in
            interface = self._interfaces.setdefault(name, Interface(LINUX_COOKED, name))
            header = _COOKED_HEADER.pack(kind, hardware, len(mac), mac[:8], protocol)
            yield kernel_timestamp(ancillary, 0), header + data, len(header) + len(data), interface, ()


class _SnifferProcess:
    """Captures with scapy on other systems, in a process of its own; see `capture.sniffer`."""

    lost = 0

    def __init__(self, name: str) -> None:
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
        """Wait until the process captures; return the link type."""
        kind, linktype, data = self._read_record()
        if kind == SnifferRecordKind.FORBIDDEN:
            raise PermissionError(errno.EPERM, os.strerror(errno.EPERM))
        if kind != SnifferRecordKind.READY:
            raise CaptureError(f"cannot capture on {self._name}: {data.decode('utf-8', 'replace')}")
        return linktype

    def _read_record(self) -> tuple[int, int, bytes]:
        """Read a record; if the process has ended, return a record that reports it."""
        assert self._process.stdout is not None
        head = self._process.stdout.read(RECORD_HEADER.size)
        if len(head) < RECORD_HEADER.size:
            return SnifferRecordKind.ENDED, 0, b"the capturing process has ended"
        kind, number, length = RECORD_HEADER.unpack(head)
        return kind, number, self._process.stdout.read(length)

    def __enter__(self) -> _SnifferProcess:
        return self

    def __exit__(self, *_: object) -> None:
        """Close the pipe, which ends the process; kill it if it does not end."""
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
            elif kind != SnifferRecordKind.ALIVE:
                reason = data.decode("utf-8", "replace")
                raise CaptureError(f"capturing on {self._name} ended: {reason}")
