"""The client's part of a call: give each attempt a serial, retry, and decide which reply to accept.

This module uses no socket and no clock. The program passes the current time to each method, in ns of any
monotonic clock. After using a method, the program reads what to send (`data_to_send`), when to use
`handle_timeout` (`deadline`), and what happened (`drain_events`). Sources for retries: DENSO Wave 2009, How
to use the Slave mode (Retry sequence in UDP connection); orin_bcap C/src/bCAPClient/bcap_client.c.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass, field
from itertools import chain
from typing import NamedTuple, TypeAlias

from bcapscope.errors import Attempt, AttemptEvent, LocalProtocolError, TooLargeError
from bcapscope.messages import Message
from bcapscope.protocol.codec.frame import (
    LARGEST_UDP_FRAME,
    Frame,
    Malformed,
    encode_frame,
    with_serial_and_reserved,
)
from bcapscope.protocol.codec.frame_content import EOT
from bcapscope.protocol.codec.variant import Variant
from bcapscope.protocol.retry.reserved_convention import ReservedConvention, client_conventions
from bcapscope.protocol.tables.function_table import function_name
from bcapscope.protocol.tables.hresult import S_EXECUTING, hresult_name, is_failure

REMEMBERED_ATTEMPTS = 32
"""Number of remembered attempts of earlier calls, to distinguish late replies from stray replies."""

_LAST_SERIAL = 0xFFFF


class RetryPolicy(NamedTuple):
    """How long a client waits for the reply to an attempt (ns), and how often it retries over UDP."""

    timeout: int
    retries: int


def _is_complete(frame: Frame) -> bool:
    """Return whether the frame has all its bytes. A complete frame may still contain wrong bytes."""
    return frame.length == len(frame.raw) and frame.raw[-1] == EOT


@dataclass(frozen=True, slots=True)
class _CallReplied:
    reply: Frame
    attempts: tuple[Attempt, ...]

    @property
    def elapsed(self) -> int:
        """Time in ns from sending the first attempt to receiving the accepted reply."""
        return self.attempts[-1].events[-1].time - self.attempts[0].sent


class CallAnswered(_CallReplied):
    """The call succeeded: `reply` carries S_OK or another success code."""


class CallRefused(_CallReplied):
    """The call failed: the controller replied with a failure code."""


@dataclass(frozen=True, slots=True)
class CallTimedOut:
    """The call failed: no accepted reply arrived before the last attempt timed out."""

    attempts: tuple[Attempt, ...]


@dataclass(frozen=True, slots=True)
class CallExecuting:
    """The controller sent a notice (S_EXECUTING), which restarts the timeout of the call."""

    notice: Frame


@dataclass(frozen=True, slots=True)
class LateReply:
    """A reply to an earlier attempt or call. The client discards this reply. The attempt was sent at `sent`,
    and the reply arrived at `time` (ns).
    """

    reply: Frame
    time: int
    sent: int


RequesterOutcome: TypeAlias = CallAnswered | CallRefused | CallTimedOut
RequesterEvent: TypeAlias = RequesterOutcome | CallExecuting | LateReply


@dataclass(eq=False)
class _OpenAttempt:
    serial: int
    reserved: int
    sent: int
    events: list[AttemptEvent] = field(default_factory=list)

    def snapshot(self) -> Attempt:
        return Attempt(self.serial, self.reserved, self.sent, tuple(self.events))


class Requester:
    """Makes one call at a time, because a controller executes the calls of a client one after another.

    Every call that the program does not `abandon` ends in `CallAnswered`, `CallRefused` or `CallTimedOut`.
    While a call is in progress, the program calls `handle_timeout` at the time `deadline`, in ns.
    """

    def __init__(self, convention: ReservedConvention, first_serial: int = 1) -> None:
        """Start a conversation with the controller, over UDP or TCP as `convention` requires.

        The C server mistakes a new client's first request with serial 0 for a retry.

        Raises:
            ValueError: `convention` is `UNKNOWN`, or `first_serial` is not in 1..65535.
        """
        if convention is ReservedConvention.UNKNOWN or not 1 <= first_serial <= _LAST_SERIAL:
            raise ValueError(f"convention {convention}, first serial {first_serial}")
        self.convention = convention
        self.datagrams = convention in client_conventions(datagrams=True)
        self._serial = first_serial
        self._request_bytes = b""
        self._policy: RetryPolicy
        self._open_attempts: list[_OpenAttempt] = []
        self._earlier_attempts: deque[_OpenAttempt] = deque(maxlen=REMEMBERED_ATTEMPTS)
        self.deadline: int | None = None
        self._outgoing: list[bytes] = []
        self._events: list[RequesterEvent] = []

    @property
    def call_in_progress(self) -> bool:
        return self.deadline is not None

    def start_call(
        self, function_id: int, arguments: Sequence[Variant], policy: RetryPolicy, now: int
    ) -> None:
        """Start a call at the time `now`, in ns.

        Raises:
            TooLargeError: The frame is too large for UDP.
            LocalProtocolError: A call is in progress, or the arguments cannot be encoded. Nothing is sent.
        """
        if self.call_in_progress:
            raise LocalProtocolError(Message("call.one-at-a-time"))
        raw = encode_frame(0, 0, function_id, arguments)
        if self.datagrams and len(raw) > LARGEST_UDP_FRAME:
            raise TooLargeError(
                Message(
                    "call.too-large-for-udp",
                    call=function_name(function_id),
                    size=len(raw),
                    limit=LARGEST_UDP_FRAME,
                )
            )
        self._request_bytes = raw
        self._policy = policy
        self._earlier_attempts.extendleft(self._open_attempts)
        self._open_attempts = []
        self._send_attempt(now)

    def receive_item(self, item: Frame | Malformed, now: int) -> None:
        """Process a frame from the controller. Ignore stray replies, incomplete frames, and other bytes."""
        if not isinstance(item, Frame) or not _is_complete(item):
            return
        attempt = self._attempt_with_serial(item.serial)
        if attempt is None:
            return
        attempt.events.append(AttemptEvent(now, hresult_name(item.code)))
        if not self.call_in_progress or attempt is not self._open_attempts[-1]:
            self._events.append(LateReply(item, now, attempt.sent))
        elif item.code == S_EXECUTING:
            self.deadline = now + self._policy.timeout
            self._events.append(CallExecuting(item))
        else:
            self.deadline = None
            self._events.append(
                (CallRefused if is_failure(item.code) else CallAnswered)(item, self._attempt_snapshots())
            )

    def record_send_error(self, reason: Message, now: int) -> None:
        """Record an error of the operating system, such as a closed port. Retries continue."""
        if self.call_in_progress:
            self._open_attempts[-1].events.append(AttemptEvent(now, reason))

    def handle_timeout(self, now: int) -> None:
        """Send a retry, or end the call, if the deadline of the newest attempt has passed."""
        if self.deadline is None or now < self.deadline:
            return
        if self.datagrams and len(self._open_attempts) <= self._policy.retries:
            self._send_attempt(now)
        else:
            self.deadline = None
            self._events.append(CallTimedOut(self._attempt_snapshots()))

    def abandon(self) -> tuple[Attempt, ...]:
        """Give up the call in progress and return its attempts. A reply to this call is now a late reply."""
        self.deadline = None
        return self._attempt_snapshots()

    def data_to_send(self) -> list[bytes]:
        outgoing, self._outgoing = self._outgoing, []
        return outgoing

    def drain_events(self) -> list[RequesterEvent]:
        """Return the events added since the previous `drain_events` call, in order."""
        events, self._events = self._events, []
        return events

    def _send_attempt(self, now: int) -> None:
        serial = self._serial
        self._serial = serial + 1 if serial < _LAST_SERIAL else 1
        attempt = _OpenAttempt(serial, self._reserved_for(serial), now)
        self._open_attempts.append(attempt)
        self.deadline = now + self._policy.timeout
        self._outgoing.append(with_serial_and_reserved(self._request_bytes, serial, attempt.reserved))

    def _reserved_for(self, serial: int) -> int:
        if not self.datagrams:
            return 1 if self.convention is ReservedConvention.TCP1 else 0
        if not self._open_attempts:
            return serial if self.convention is ReservedConvention.OWN else 0
        return self._open_attempts[-1 if self.convention is ReservedConvention.CHAIN else 0].serial

    def _attempt_with_serial(self, serial: int) -> _OpenAttempt | None:
        known = chain(reversed(self._open_attempts), self._earlier_attempts)
        return next((each for each in known if each.serial == serial), None)

    def _attempt_snapshots(self) -> tuple[Attempt, ...]:
        return tuple(each.snapshot() for each in self._open_attempts)
