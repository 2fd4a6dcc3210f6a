"""The exceptions of bcapscope.

Decoding raises none of these exceptions: bytes that cannot be decoded become items with a list of problems.
The class of an exception says who caused the error, so your code need not parse the message.
"""

from __future__ import annotations

from itertools import groupby
from operator import attrgetter
from typing import TYPE_CHECKING, NamedTuple

from bcapscope.messages import Message
from bcapscope.messages.message import foreign_text

if TYPE_CHECKING:
    from pathlib import Path  # importing pathlib takes a tenth of the run time of `bcapscope --help`


class BcapError(Exception):
    """Base class of every exception that bcapscope raises on purpose.

    Attributes:
        message: Message that says what failed. ``str()`` of the exception returns this message in English.
    """

    def __init__(self, message: Message) -> None:
        super().__init__(message)
        self.message = message

    def __str__(self) -> str:
        return str(self.message)


def message_of(error: Exception) -> Message:
    """Return the message of an exception. The text of an exception from another library is not translated."""
    if isinstance(error, UnicodeDecodeError):
        byte = f"0x{error.object[error.start]:02x}"
        return Message(
            "text.not-decoded",
            encoding=error.encoding,
            byte=byte,
            position=error.start,
            reason=error.reason,
        )
    return error.message if isinstance(error, BcapError) else foreign_text(str(error))


class InputError(BcapError, ValueError):
    """Text that a user typed, or wrote in a file, is invalid."""


class LocalProtocolError(BcapError):
    """Your program tried to send something that b-CAP cannot express. Nothing was sent."""


class TooLargeError(LocalProtocolError):
    """The frame to send is too large for b-CAP or for the transport. Nothing was sent."""


class RemoteProtocolError(BcapError):
    """The peer violated the protocol. For example, the value in a reply has the wrong type for the function.

    Attributes:
        raw: The frame or bytes that the peer sent.
    """

    def __init__(self, message: Message, raw: bytes) -> None:
        super().__init__(message)
        self.raw = raw


class ControllerError(BcapError):
    """The controller refused a call.

    Attributes:
        hresult: Result code, unsigned.
        name: DENSO's name of the result code, such as `E_HANDLE`, or the code in hex if it has no name.
        meaning: Meaning of the result code as text.
    """

    def __init__(self, call: str, hresult: int, name: str, meaning: Message) -> None:
        super().__init__(Message("call.refused", call=call, name=name, meaning=meaning))
        self.hresult = hresult
        self.name = name
        self.meaning = meaning


class AttemptEvent(NamedTuple):
    """A reply to an attempt, or an error in sending the attempt. The reply can be in time or late.

    Attributes:
        time: Time of the event in ns, on the same clock as `Attempt.sent`.
        description: Name of the reply's result code, or text of the operating system's error.
    """

    time: int
    description: str | Message


class Attempt(NamedTuple):
    """One attempt of a call.

    Attributes:
        serial: Serial of the attempt's frame.
        reserved: Reserved field of the attempt's frame.
        sent: Time of sending in ns, on a monotonic clock.
        events: Replies to this attempt, and errors in sending it, in chronological order.
    """

    serial: int
    reserved: int
    sent: int
    events: tuple[AttemptEvent, ...] = ()

    def describe(self, start: int) -> Message:
        """Describe the attempt in one line of text. This text combines consecutive events that are equal.

        Args:
            start: Time in ns that the text shows as 0 ms, on the same clock as `sent`.
        """
        from bcapscope.messages.places import Enumeration  # noqa: PLC0415 - keeps `bcapscope --help` fast

        came = tuple(
            _repeated_event(what, [f"{(arrival.time - start) / 1e6:.3f}" for arrival in same])
            for what, same in groupby(self.events, attrgetter("description"))
        )
        return Message(
            "call.attempt",
            serial=self.serial,
            reserved=self.reserved,
            sent=f"{(self.sent - start) / 1e6:.3f}",
            events=Enumeration(came or (Message("call.attempt.nothing"),)),
        )


def _repeated_event(what: str | Message, times: list[str]) -> Message:
    if len(times) == 1:
        return Message("call.attempt.event", what=what, time=times[0])
    count = len(times)
    return Message("call.attempt.events", what=what, count=count, first=times[0], last=times[-1])


class CallTimeout(BcapError, TimeoutError):
    """The controller answered no attempt of a call in time.

    Attributes:
        attempts: All attempts of the call, in the order of sending.
    """

    def __init__(self, call: str, attempts: tuple[Attempt, ...]) -> None:
        from bcapscope.messages.places import Count, IndentedLines  # noqa: PLC0415 - keeps `bcapscope --help` fast

        log = IndentedLines(tuple(attempt.describe(attempts[0].sent) for attempt in attempts))
        super().__init__(
            Message("call.unanswered", call=call, attempts=Count(len(attempts), "attempt"), log=log)
        )
        self.attempts = attempts


class CaptureError(BcapError):
    """A capture cannot be read, or ends early.

    Attributes:
        offset: Offset in the uncompressed capture, in bytes, at which reading stopped; None if the error has
            no position.
    """

    def __init__(self, message: Message, offset: int | None = None) -> None:
        super().__init__(message)
        self.offset = offset


class FileWriteError(BcapError):
    """A file or another output cannot be written.

    Attributes:
        path: Path as your code gave it, or a description of the output if it has no path. Escape `path`
            before you print it.
        reason: Message that says why writing failed, beginning in lower case.
    """

    def __init__(self, path: Path | Message, reason: Message) -> None:
        shown = path if isinstance(path, Message) else str(path)
        super().__init__(Message("file.not-written", path=shown, reason=reason))
        self.path = path
        self.reason = reason


class MissingExtraError(BcapError, ImportError):
    """A package for an optional part of bcapscope is not installed."""

    def __init__(self, package: str, extra: str) -> None:
        super().__init__(Message("extra.not-installed", package=package, extra=extra))
