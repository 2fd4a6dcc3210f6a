"""The other end of the control socket: asks the proxy and takes its answers."""

from __future__ import annotations

import socket
from collections.abc import Mapping
from typing import Any, TypeAlias

import orjson

from bcapscope.errors import BcapError
from bcapscope.proxy.control_socket import ControlError, reach_control

Answer: TypeAlias = Mapping[str, Any]

_LARGEST_ANSWER = 64 << 20


class ControlRefused(BcapError):
    """The proxy did not do what was asked of it; the text is its reason.

    Attributes:
        answer: as it came.
    """

    def __init__(self, answer: Answer) -> None:
        super().__init__(str(answer.get("error", "the proxy refused")))
        self.answer = answer


class ControlClient:
    """A connection to a proxy, made when the first question is asked, and anew after it broke."""

    def __init__(self, address: str) -> None:
        """Take the address that the proxy was given by ``--control``."""
        self._address = address
        self._socket: socket.socket | None = None

    def ask(self, question: Mapping[str, object]) -> Answer:
        """Ask, and return the answer; waits seconds at most.

        Raises:
            ControlError: nobody listens there, or it does not answer.
            ControlRefused: the proxy did not do it.
        """
        try:
            answer: Answer = orjson.loads(self._exchange(orjson.dumps(question) + b"\n"))
        except ConnectionError as error:  # while it was asked; one that cannot be made is a ControlError
            self.close()
            raise ControlError(f"the proxy on {self._address} has ended") from error
        except OSError as error:
            self.close()
            raise ControlError(f"{self._address}: {(error.strerror or str(error)).lower()}") from error
        except orjson.JSONDecodeError as error:
            self.close()
            raise ControlError(f"what listens on {self._address} is no proxy") from error
        if not answer.get("ok"):
            raise ControlRefused(answer)
        return answer

    def close(self) -> None:
        """Close the connection."""
        if self._socket is not None:
            self._socket.close()
            self._socket = None

    def _exchange(self, line: bytes) -> bytes:
        if self._socket is None:
            self._socket = reach_control(self._address)
        self._socket.sendall(line)
        answer = bytearray()
        while not answer.endswith(b"\n"):
            data = self._socket.recv(1 << 16)
            if not data or len(answer) > _LARGEST_ANSWER:
                self.close()
                raise ControlError(f"the proxy on {self._address} ended before it answered")
            answer += data
        return bytes(answer[:-1])
