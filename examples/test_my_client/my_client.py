"""A small b-CAP client over UDP, with a bug in its retries."""

from __future__ import annotations

import socket
import struct

SERVICE_START, SERVICE_STOP, CONTROLLER_CONNECT, CONTROLLER_DISCONNECT = 1, 2, 3, 4
VT_I4, VT_BSTR = 3, 8
TIMEOUT, ATTEMPTS = 0.1, 8


class MyClient:
    """Calls functions of a controller, and sends a request again if no reply comes."""

    def __init__(self, host: str, port: int) -> None:
        self._socket = socket.socket(type=socket.SOCK_DGRAM)
        self._socket.settimeout(TIMEOUT)
        self._socket.connect((host, port))
        self._serial = 0

    def close(self) -> None:
        self._socket.close()

    def connect(self, name: str) -> int:
        """Start the service and connect; return the handle of the controller."""
        self.call(SERVICE_START, text(""))
        texts = name, "CaoProv.DENSO.VRC", "localhost", ""
        reply = self.call(CONTROLLER_CONNECT, *map(text, texts))
        return int(struct.unpack_from("<i", reply, 25)[0])

    def disconnect(self, handle: int) -> None:
        self.call(CONTROLLER_DISCONNECT, argument(VT_I4, struct.pack("<i", handle)))
        self.call(SERVICE_STOP)

    def call(self, function: int, *arguments: bytes) -> bytes:
        """Make a call and return the frame of its reply."""
        for attempt in range(ATTEMPTS):
            self._serial += 1
            # The bug: the reserved field of a retry must name the serial of the first attempt.
            reserved = attempt
            self._socket.send(frame(self._serial, reserved, function, *arguments))
            try:
                reply = self._receive()
            except TimeoutError:
                continue
            (result,) = struct.unpack_from("<I", reply, 9)
            if result & 0x80000000:
                raise RuntimeError(f"the controller refused function {function}: {result:08X}")
            return reply
        raise TimeoutError(f"no reply to function {function}")

    def _receive(self) -> bytes:
        """Return the reply to the last request; ignore replies to earlier ones."""
        while True:
            reply = self._socket.recv(65535)
            if struct.unpack_from("<H", reply, 5)[0] == self._serial:
                return reply


def frame(serial: int, reserved: int, function: int, *arguments: bytes) -> bytes:
    size = 16 + sum(map(len, arguments))
    head = struct.pack("<BIHHIH", 1, size, serial, reserved, function, len(arguments))
    return head + b"".join(arguments) + b"\x04"


def argument(kind: int, data: bytes) -> bytes:
    return struct.pack("<IHI", 6 + len(data), kind, 1) + data


def text(value: str) -> bytes:
    data = value.encode("utf-16-le")
    return argument(VT_BSTR, struct.pack("<I", len(data)) + data)
