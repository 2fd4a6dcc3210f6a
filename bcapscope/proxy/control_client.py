"""The client of the control socket: sends requests to the proxy and reads its answers.

Any program may listen on the address. The size and time of an answer are bounded before it is read. Its
values are strings from the wire: escape them before you print them.
"""

from __future__ import annotations

import socket
import time
from collections.abc import Mapping

import msgspec
import orjson

from bcapscope.errors import BcapError
from bcapscope.proxy.control_answers import ControlAnswer, HeldStatus
from bcapscope.proxy.control_api import LONGEST_LINE
from bcapscope.proxy.control_socket import ControlError, connect_control

ANSWERS_WITHIN = 10.0
"""Seconds that a whole answer may take."""

LARGEST_LIST = 16 << 20
"""Bytes of a list of held messages: a thousand of 8,000 bytes each fit. Other answers have `LONGEST_LINE`."""

_LONGEST_REASON = 1000


class _Envelope(msgspec.Struct, frozen=True):
    """The fields of every answer."""

    ok: bool
    error: str = "the proxy refused"


class _HeldList(msgspec.Struct, frozen=True):
    held: list[HeldStatus]


class ControlRefused(BcapError):
    """The proxy refused a request; the text is its reason.

    Attributes:
        line: The answer as received, JSON.
    """

    def __init__(self, reason: str, line: bytes) -> None:
        cut = reason if len(reason) <= _LONGEST_REASON else f"{reason[:_LONGEST_REASON]}…"
        super().__init__(cut)
        self.line = line


class ControlClient:
    """A connection to a proxy. It opens with the first request, and again after it broke."""

    def __init__(self, address: str) -> None:
        """Use the address that the proxy got with ``--control``."""
        self._address = address
        self._socket: socket.socket | None = None

    def request(self, command: Mapping[str, object]) -> ControlAnswer:
        """Send a request and return the answer. Takes at most `ANSWERS_WITHIN` seconds.

        Raises:
            ControlError: No program listens there, or it does not answer as a proxy does.
            ControlRefused: The proxy refused the request.
        """
        line = self.request_raw(command)
        try:
            answer: ControlAnswer = orjson.loads(line)
        except orjson.JSONDecodeError as error:
            self.close()
            raise ControlError(f"the program on {self._address} is not a bcapscope proxy") from error
        return answer

    def list_held(self) -> list[HeldStatus]:
        """Return the held messages.

        Raises:
            ControlError, ControlRefused: as `request`.
        """
        line = self.request_raw({"do": "held"})
        try:
            return msgspec.json.decode(line, type=_HeldList).held
        except msgspec.DecodeError as error:
            self.close()
            raise ControlError(
                f"the program on {self._address} is not a bcapscope proxy of this version"
            ) from error

    def request_raw(self, command: Mapping[str, object]) -> bytes:
        """Send a request and return the answer as received, one line of JSON.

        Raises:
            ControlError, ControlRefused: as `request`.
        """
        limit = LARGEST_LIST if command.get("do") == "held" else LONGEST_LINE
        try:
            line = self._exchange(orjson.dumps(command) + b"\n", limit)
            envelope = msgspec.json.decode(line, type=_Envelope)
        except ConnectionError as error:  # during the request; a failure to connect is a ControlError
            self.close()
            raise ControlError(f"the proxy on {self._address} has ended") from error
        except OSError as error:
            self.close()
            raise ControlError(f"{self._address}: {(error.strerror or str(error)).lower()}") from error
        except (msgspec.DecodeError, RecursionError) as error:
            self.close()
            raise ControlError(f"the program on {self._address} is not a bcapscope proxy") from error
        if not envelope.ok:
            raise ControlRefused(envelope.error, line)
        return line

    def close(self) -> None:
        """Close the connection."""
        if self._socket is not None:
            self._socket.close()
            self._socket = None

    def _exchange(self, line: bytes, limit: int) -> bytes:
        if self._socket is None:
            self._socket = connect_control(self._address)
        until = time.monotonic() + ANSWERS_WITHIN
        self._socket.settimeout(ANSWERS_WITHIN)
        self._socket.sendall(line)
        answer = bytearray()
        while not answer.endswith(b"\n"):
            left = until - time.monotonic()
            if left <= 0:
                raise TimeoutError("timed out")
            self._socket.settimeout(left)
            data = self._socket.recv(1 << 16)
            if not data:
                self.close()
                raise ControlError(f"the proxy on {self._address} ended before it answered")
            answer += data
            if len(answer) > limit:
                self.close()
                raise ControlError(f"the answer of the program on {self._address} exceeds {limit >> 20} MB")
        return bytes(answer)
