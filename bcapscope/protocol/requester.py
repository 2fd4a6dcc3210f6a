"""The client's side of a call: serials, reserved, tries, and which reply counts.

No socket and no clock: each method is told what time it is, in nanoseconds of any clock that does not go
back, and three questions are answered afterwards: what to send (`data_to_send`), when to call `wake` (`due`),
and what happened (`events`). The rules are those of DENSO Wave 2009, How to use the Slave mode (Retry
sequence in UDP connection), and of orin_bcap C/src/bCAPClient/bcap_client.c.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import chain
from typing import NamedTuple, TypeAlias

from bcapscope.errors import Arrival, Attempt, LocalProtocolError, TooLargeError
from bcapscope.protocol.content import EOT
from bcapscope.protocol.convention import Convention
from bcapscope.protocol.frame import LARGEST_UDP_FRAME, Frame, Malformed, encode, renumbered
from bcapscope.protocol.functions import function_name
from bcapscope.protocol.hresult import S_EXECUTING, hresult_name, is_failure
from bcapscope.protocol.variant import Variant

_FORMER = 32
"""Tries of earlier calls that are remembered, to tell late replies from strange ones."""

_LAST_SERIAL = 0xFFFF
_ON_UDP = (Convention.SEED, Convention.OWN, Convention.CHAIN)


class Pace(NamedTuple):
    """How long to wait for a reply and how often to ask again.

    Attributes:
        timeout: of each try, nanoseconds.
        retries: after the first try; on TCP there are none.
    """

    timeout: int
    retries: int


def _is_whole(frame: Frame) -> bool:
    """Tell whether no part of a datagram is missing; what is odd inside of a frame the caller may judge."""
    return frame.length == len(frame.raw) and frame.raw[-1] == EOT


def _took(attempts: tuple[Attempt, ...]) -> int:
    return attempts[-1].came[-1].time - attempts[0].sent


@dataclass(frozen=True, slots=True)
class Answered:
    """The call succeeded: `reply` carries a code that is no failure, S_OK or another."""

    reply: Frame
    attempts: tuple[Attempt, ...]

    @property
    def took(self) -> int:
        """Nanoseconds from the first try to the reply."""
        return _took(self.attempts)


@dataclass(frozen=True, slots=True)
class Refused:
    """The call failed: the server answered with a failure code."""

    reply: Frame
    attempts: tuple[Attempt, ...]

    @property
    def took(self) -> int:
        """Nanoseconds from the first try to the reply."""
        return _took(self.attempts)


@dataclass(frozen=True, slots=True)
class TimedOut:
    """The call failed: no try was answered in time."""

    attempts: tuple[Attempt, ...]


@dataclass(frozen=True, slots=True)
class Executing:
    """The server is still at work (S_EXECUTING); the wait began again."""

    notice: Frame


@dataclass(frozen=True, slots=True)
class Late:
    """A reply that no longer counts: to an earlier try, or to a call that is over. It was discarded.

    Attributes:
        reply: as it came.
        time: when it came.
        sent: when the try that it answers was sent.
    """

    reply: Frame
    time: int
    sent: int


@dataclass(frozen=True, slots=True)
class Stray:
    """A reply with a serial that was not asked for lately, or bytes that are no frame. It was discarded."""

    item: Frame | Malformed
    time: int


Settled: TypeAlias = Answered | Refused | TimedOut
Event: TypeAlias = Settled | Executing | Late | Stray


class _Try:
    """One packet that was sent, and what came for it."""

    __slots__ = ("came", "reserved", "sent", "serial")

    def __init__(self, serial: int, reserved: int, sent: int) -> None:
        self.serial = serial
        self.reserved = reserved
        self.sent = sent
        self.came: list[Arrival] = []

    def attempt(self) -> Attempt:
        """Return what there is to tell of it."""
        return Attempt(self.serial, self.reserved, self.sent, tuple(self.came))


class Requester:
    """Makes calls, one at a time, as servers of b-CAP handle them strictly one after another.

    Every call ends in exactly one of `Answered`, `Refused` and `TimedOut`, unless it is given up by
    `abandon`.
    """

    def __init__(self, convention: Convention, first_serial: int = 1) -> None:
        """Begin a conversation.

        Args:
            convention: what goes into reserved; it also tells UDP, with retries and a limit of size, from
                TCP.
            first_serial: 1..65535. The C server takes 0 of a new client for a retry.
        """
        if convention is Convention.UNKNOWN or not 1 <= first_serial <= _LAST_SERIAL:
            raise ValueError(f"convention {convention}, first serial {first_serial}")
        self.convention = convention
        self.datagrams = convention in _ON_UDP
        self._serial = first_serial
        self._raw = b""
        self._pace = Pace(0, 0)
        self._tries: list[_Try] = []
        self._former: deque[_Try] = deque(maxlen=_FORMER)
        self._deadline: int | None = None
        self._outgoing: list[bytes] = []
        self._events: list[Event] = []

    @property
    def calling(self) -> bool:
        """Whether a call is under way."""
        return self._deadline is not None

    @property
    def due(self) -> int | None:
        """When `wake` is to be called; None while nothing is awaited."""
        return self._deadline

    def call(self, function_id: int, arguments: Sequence[Variant], pace: Pace, now: int) -> None:
        """Begin a call.

        Raises:
            TooLargeError: the packet is too large for UDP.
            LocalProtocolError: a call is under way, or the arguments cannot be packed. Nothing is sent then.
        """
        if self.calling:
            raise LocalProtocolError("a call is under way, and b-CAP takes one after the other")
        raw = encode(0, 0, function_id, arguments)
        if self.datagrams and len(raw) > LARGEST_UDP_FRAME:
            raise TooLargeError(
                f"{function_name(function_id)} would be a packet of {len(raw)} bytes, and UDP carries "
                f"{LARGEST_UDP_FRAME}: connect over TCP, or send less"
            )
        self._raw = raw
        self._pace = pace if self.datagrams else pace._replace(retries=0)
        self._former.extendleft(self._tries)
        self._tries = []
        self._send(now)

    def receive(self, item: Frame | Malformed, now: int) -> None:
        """Take what came from the server."""
        asked = self._asked(item.serial) if isinstance(item, Frame) and _is_whole(item) else None
        if not isinstance(item, Frame) or asked is None:
            self._events.append(Stray(item, now))
            return
        asked.came.append(Arrival(now, hresult_name(item.code)))
        if not self.calling or asked is not self._tries[-1]:
            self._events.append(Late(item, now, asked.sent))
        elif item.code == S_EXECUTING:
            self._deadline = now + self._pace.timeout
            self._events.append(Executing(item))
        else:
            self._deadline = None
            self._events.append((Refused if is_failure(item.code) else Answered)(item, self._attempts()))

    def trouble(self, text: str, now: int) -> None:
        """Note what the system told of the last packet, such as that the port is closed; tries go on."""
        if self.calling:
            self._tries[-1].came.append(Arrival(now, text))

    def wake(self, now: int) -> None:
        """Try again, or give up, if the time for the last try is over."""
        if self._deadline is None or now < self._deadline:
            return
        if len(self._tries) <= self._pace.retries:
            self._send(now)
        else:
            self._deadline = None
            self._events.append(TimedOut(self._attempts()))

    def abandon(self) -> tuple[Attempt, ...]:
        """Give up the call under way; a reply that still comes is late. Return the tries that were made."""
        self._deadline = None
        return self._attempts()

    def data_to_send(self) -> list[bytes]:
        """Return the packets that are to be sent now, each once."""
        outgoing, self._outgoing = self._outgoing, []
        return outgoing

    def events(self) -> list[Event]:
        """Return what happened since the last time, in order."""
        events, self._events = self._events, []
        return events

    def _send(self, now: int) -> None:
        serial = self._serial
        self._serial = serial + 1 if serial < _LAST_SERIAL else 1
        this = _Try(serial, self._reserved(serial), now)
        self._tries.append(this)
        self._deadline = now + self._pace.timeout
        self._outgoing.append(renumbered(self._raw, serial, this.reserved))

    def _reserved(self, serial: int) -> int:
        if not self.datagrams:
            return 1 if self.convention is Convention.TCP1 else 0
        if not self._tries:
            return serial if self.convention is Convention.OWN else 0
        return self._tries[-1 if self.convention is Convention.CHAIN else 0].serial

    def _asked(self, serial: int) -> _Try | None:
        known = chain(reversed(self._tries), self._former)
        return next((one for one in known if one.serial == serial), None)

    def _attempts(self) -> tuple[Attempt, ...]:
        return tuple(one.attempt() for one in self._tries)
