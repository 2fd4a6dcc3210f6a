"""The client of the proxy's control socket. Any program may listen on the proxy's address, so the client
limits the size and the time of a response. Escape the strings in a response before you print them.
"""

from __future__ import annotations

import socket
import time
from typing import Any, TypeVar

from bcapscope.errors import BcapError
from bcapscope.messages import Message
from bcapscope.messages.message import foreign_text
from bcapscope.messages.os_errors import os_reason
from bcapscope.proxy import control_messages as control
from bcapscope.proxy.control_socket import ControlError, connect_control
from bcapscope.transport.descriptors import wait_readable

ANSWERS_WITHIN = 10.0
"""Maximum time in seconds for a whole response."""

LARGEST_LIST = 16 << 20
"""Maximum size, in bytes, of a response that lists held messages: a thousand messages of 8,000 bytes."""

_LONGEST_REASON = 1000

R = TypeVar("R", bound=control.DoneResponse)


class ControlRefused(BcapError):
    """The proxy rejected a request for this reason. `line` is the response in JSON."""

    def __init__(self, reason: Message, line: bytes) -> None:
        text = str(reason)
        is_long = len(text) > _LONGEST_REASON
        super().__init__(foreign_text(f"{text[:_LONGEST_REASON]}…") if is_long else reason)
        self.line = line


class ControlClient:
    """A control connection to a proxy. The first request, and each request after a failure, connects."""

    def __init__(self, address: str) -> None:
        self._address = address
        self._socket: socket.socket | None = None

    def request(self, request: control.ControlRequest, kind: type[R]) -> R:
        """Send a request and return the response. Raise a `ControlError` if no proxy of this version listens
        on the address, or `ControlRefused` if the proxy rejected the request.
        """
        line = self.request_raw(request)
        try:
            return control.decode_response(line, kind)
        except ValueError as error:
            raise self._close_with_error("control.other-version") from error

    def request_raw(self, request: control.ControlRequest) -> bytes:
        """Like `request`, but return the received line of JSON."""
        limit = LARGEST_LIST if isinstance(request, control.ListHeld) else control.LONGEST_LINE
        try:
            line = self._send_and_receive(control.encode_line(request), limit)
            head = control.decode_response(line, control.ErrorResponse)
        except ConnectionError as error:
            # The connection was open before: if it cannot be opened, `connect_control` raises `ControlError`.
            raise self._close_with_error("control.ended") from error
        except OSError as error:
            raise self._close_with_error("control.failed", reason=os_reason(error)) from error
        except ValueError as error:
            raise self._close_with_error("control.not-a-proxy") from error
        if not head.ok:
            raise ControlRefused(head.reason, line)
        return line

    def close(self) -> None:
        if self._socket is not None:
            self._socket.close()
            self._socket = None

    def _send_and_receive(self, line: bytes, limit: int) -> bytes:
        if self._socket is None:
            self._socket = connect_control(self._address)
        until = time.monotonic() + ANSWERS_WITHIN
        self._socket.sendall(line)
        response = bytearray()
        while not response.endswith(b"\n"):
            if not wait_readable(self._socket.fileno(), max(until - time.monotonic(), 0)):
                raise TimeoutError("timed out")
            data = self._socket.recv(1 << 16)
            if not data:
                raise self._close_with_error("control.ended-early")
            response += data
            if len(response) > limit:
                raise self._close_with_error("control.too-long", size=limit >> 20)
        return bytes(response)

    def _close_with_error(self, case: str, **places: Any) -> ControlError:
        self.close()
        return ControlError(Message(case, address=self._address, **places))
