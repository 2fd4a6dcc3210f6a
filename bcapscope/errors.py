"""The exceptions of bcapscope.

Reading never raises: bytes that make no sense become items that say so. What is raised tells whose
fault it was, so that a caller need not read the message to know what to do next.
"""

from itertools import groupby
from operator import attrgetter
from typing import NamedTuple


class BcapError(Exception):
    """Base of every exception that bcapscope raises on purpose."""


class LocalProtocolError(BcapError):
    """We were asked to send something that b-CAP cannot express; nothing was sent."""


class TooLargeError(LocalProtocolError):
    """A frame would be larger than b-CAP, or the transport, carries."""


class RemoteProtocolError(BcapError):
    """The peer sent what it may not send, such as an answer of another type than the function has.

    Attributes:
        raw: the frame or bytes.
    """

    def __init__(self, message: str, raw: bytes) -> None:
        super().__init__(message)
        self.raw = raw


class ControllerError(BcapError):
    """The controller refused a call.

    Attributes:
        hresult: result code, unsigned.
        name: the vendor's symbol such as `E_HANDLE`, else the code in hex.
        meaning: in words.
    """

    def __init__(self, call: str, hresult: int, name: str, meaning: str) -> None:
        """Tell that `call`, such as `Robot_Execute slvMove`, was answered with `hresult`."""
        super().__init__(f"{call} was refused: {name}, {meaning}")
        self.hresult = hresult
        self.name = name
        self.meaning = meaning


class AttemptEvent(NamedTuple):
    """Something that came for a try and was no answer in time.

    Attributes:
        time: nanoseconds of the clock that the tries have.
        description: name of the result code, or what the system said.
    """

    time: int
    description: str


class Attempt(NamedTuple):
    """One try of a call.

    Attributes:
        serial: of its packet.
        reserved: of its packet.
        sent: nanoseconds of a clock that does not go back.
        events: what came for it, in order.
    """

    serial: int
    reserved: int
    sent: int
    events: tuple[AttemptEvent, ...] = ()

    def describe(self, start: int) -> str:
        """Tell it in words, times counted from `start`; what came again and again is told once."""
        came = ", ".join(
            _repeated_event_text(what, [(arrival.time - start) / 1e6 for arrival in same])
            for what, same in groupby(self.events, attrgetter("description"))
        )
        head = f"serial {self.serial}, reserved {self.reserved}, sent at {(self.sent - start) / 1e6:.3f} ms"
        return f"{head}: {came or 'nothing came'}"


def _repeated_event_text(what: str, times: list[float]) -> str:
    if len(times) == 1:
        return f"{what} at {times[0]:.3f} ms"
    return f"{what} × {len(times)} at {times[0]:.3f} … {times[-1]:.3f} ms"


class CallTimeout(BcapError, TimeoutError):
    """No try of a call was answered in time.

    Attributes:
        attempts: all tries, in order.
    """

    def __init__(self, call: str, attempts: tuple[Attempt, ...]) -> None:
        """Tell that `call`, such as `Robot_Execute slvMove`, had no answer to any of its tries."""
        count = "1 try" if len(attempts) == 1 else f"{len(attempts)} tries"
        tries = "".join(f"\n  {attempt.describe(attempts[0].sent)}" for attempt in attempts)
        super().__init__(f"{call} was not answered in time, {count}:{tries}")
        self.attempts = attempts


class CaptureError(BcapError):
    """A capture cannot be read, or breaks off.

    Attributes:
        offset: byte offset in the (uncompressed) capture at which reading stopped, or None where
            there is no capture to have an offset in.
    """

    def __init__(self, message: str, offset: int | None = None) -> None:
        super().__init__(message)
        self.offset = offset
