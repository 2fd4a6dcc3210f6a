"""The controller's side of retries: recognise a retry, so that no call is executed twice.

A client that gets no reply in time sends its request again with a new serial. The reserved field of the retry
names an earlier attempt (DENSO Wave 2009, How to use the Slave mode, Retry sequence in UDP connection). The
client accepts only a reply to its newest serial. A stored reply is therefore sent again under the serial of
the retry.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from enum import Enum, Flag
from itertools import takewhile

from bcapscope.errors import TooLargeError
from bcapscope.messages import Message
from bcapscope.protocol.codec.frame import LARGEST_FRAME, Frame, encode_frame, with_serial_and_reserved
from bcapscope.protocol.codec.variant import Variant
from bcapscope.protocol.retry.reserved_convention import ReplyReserved, ReservedConvention
from bcapscope.protocol.tables.hresult import S_EXECUTING, S_OK

REMEMBERED_ANSWERS = 32
"""Replies stored for each client. One is enough if the network keeps packets in order, since a client makes
one call at a time. The others cover packets that arrive late. A UDP reply has at most 503 bytes."""

_SERVICE_START = 1
_SERIAL_COUNT = 0xFFFF
"""Serials count from 1 to 65535, then start again at 1."""

_MAX_ATTEMPTS = 16
"""Twice the attempts that any known client sends for one call, except the client that retries without end."""


_CHAIN_CONVENTIONS = (ReservedConvention.UNKNOWN, ReservedConvention.CHAIN)


class Defect(Flag):
    """Faults of DENSO's C server (orin_bcap C/src/bCAPServer/bcap_server.c), for imitation."""

    NONE = 0
    FORGETS_FIRST = 1
    """The server stores only the last reply, under the serial of the attempt that arrived, and ignores the
    contents. If the first attempt is lost, the second retry names a serial that the server never saw, and it
    executes the call again. A client that restarts with the serial answered last gets the old reply."""
    SERIAL_ZERO = 2
    """The server answers S_OK to a new client whose first frame has serial 0, and executes nothing."""


class RequestKind(Enum):
    """How the responder classifies a request."""

    NEW = "new"
    """A new call: execute it, then call `Responder.answer_call`."""
    REPEAT = "repeat"
    """A retry of a call that was executed: send the stored reply again."""
    RUNNING = "running"
    """A retry of the call that is being executed: the reply will carry the serial of this retry. Also a retry
    of an abandoned call, which never gets a reply."""
    BUSY = "busy"
    """A different call while one is being executed. The caller may refuse it with
    `Responder.reply_unremembered`."""


@dataclass(frozen=True, slots=True)
class RequestDecision:
    """What to do about a request.

    Attributes:
        kind: Class of the request.
        reply: Frame to send now; None unless `kind` is `REPEAT`.
    """

    kind: RequestKind
    reply: bytes | None = None


_NEW = RequestDecision(RequestKind.NEW)


class _Call:
    """One call and all attempts that are known to belong to it."""

    __slots__ = ("answer", "content", "first", "newest", "reserved", "serials")

    def __init__(self, frame: Frame, content: bytes) -> None:
        self.content = content
        self.first = frame.serial
        self.newest = frame.serial
        self.reserved = frame.reserved
        self.serials = {frame.serial, frame.reserved or frame.serial}
        self.answer = b""

    def add_attempt(self, frame: Frame) -> None:
        self.serials |= {frame.serial, frame.reserved or frame.serial}
        if _is_ahead(frame.serial, self.newest):
            self.newest = frame.serial
            self.reserved = frame.reserved


def _is_ahead(serial: int, other: int) -> bool:
    """Return whether `serial` is the same as `other` or was counted after it."""
    return (serial - other) % _SERIAL_COUNT < _SERIAL_COUNT // 2


def _is_chain_unbroken(serial: int, call: _Call, calls: Iterable[_Call]) -> bool:
    """Return whether no known call lies between `call` and a later serial.

    `calls` lists the newest call first. Only calls executed after `call` are examined. If an earlier call has
    a later serial, an earlier program made it.
    """
    later = takewhile(lambda other: other is not call, calls)
    return not any(
        _is_ahead(other.newest, call.newest) and _is_ahead(serial, other.newest) for other in later
    )


class Responder:
    """Decides for one client (UDP: one address and port; TCP: one connection) what each request is.

    The responder executes nothing. `receive_request` classifies a request, and `answer_call` ends the call
    that `receive_request` classified as new. Requests of one client are executed strictly one after another.

    A first attempt has reserved 0 or its own serial. Any other value names an attempt of the same call, the
    first or the previous one. A request belongs to a remembered call if it names one of its attempts and has
    the same contents (function and arguments). The responder then adds the serial and the named serial to
    that call. A known serial with other contents means that the client restarted.

    The bytes leave two cases undecided:

    * A client of the old C library (`ReservedConvention.CHAIN`) names the previous attempt. If that attempt
      was lost, the retry looks like a retry of a new, equal call.
    * A program that restarts on the port of another one counts from the same serial again. Its call may equal
      one of its predecessor, at the same serial or shortly before it. It then looks like a delayed attempt of
      that call.

    The responder treats both as retries, so no call ever runs twice. If neither the serial nor the named
    serial belongs to the equal call, it does so only while the convention is `CHAIN` or unknown. The price is
    that such a new call is not executed: its client gets the earlier reply. That may be an old value, or the
    success of a motion that ran once and not twice.

    The responder forgets the calls of the predecessor when the new program reuses one of their serials for a
    different call. At the latest it has forgotten them after `remembered` further calls.
    """

    def __init__(
        self,
        *,
        expects_retries: bool = True,
        reply_reserved: ReplyReserved = ReplyReserved.ZERO,
        convention: ReservedConvention = ReservedConvention.UNKNOWN,
        remembered: int = REMEMBERED_ANSWERS,
        largest_answer: int = LARGEST_FRAME,
        defects: Defect = Defect.NONE,
    ) -> None:
        """Start with a client about which nothing is known.

        Args:
            expects_retries: True on UDP. On TCP every request is a new call.
            reply_reserved: `UNKNOWN` acts as `ZERO`.
            convention: Convention of the client if known beforehand; otherwise it is detected.
            remembered: Number of replies to store.
            largest_answer: Largest reply, bytes.
            defects: Faults of DENSO's C server to imitate.
        """
        self.convention = self._given_convention = convention
        self._retries = expects_retries
        self._echoes_reserved = reply_reserved is ReplyReserved.ECHOED
        self._largest = largest_answer
        self._defects = defects
        self._forgets_first = Defect.FORGETS_FIRST in defects
        self._calls: deque[_Call] = deque(maxlen=1 if self._forgets_first else remembered)
        self._known_keys: set[int | bytes] = (
            set()
        )  # serials and contents of all known calls, and of some others
        self._known_keys_limit = 8 * remembered
        self._running: _Call | None = None
        self._has_received = False

    @property
    def is_call_running(self) -> bool:
        return self._running is not None

    def receive_request(self, frame: Frame) -> RequestDecision:
        """Classify a request. After `NEW` the call is running until `answer_call` or `abandon_call`."""
        heard, self._has_received = self._has_received, True
        content = frame.raw[9:]
        call = self._find_call(frame, content) if self._retries else None
        if call is None:
            if self._running is not None:
                return RequestDecision(RequestKind.BUSY)
            if not heard and self._retries and frame.serial == 0 and Defect.SERIAL_ZERO in self._defects:
                return RequestDecision(RequestKind.REPEAT, self.reply_unremembered(frame, S_OK))
            self._running = call = _Call(frame, content)
            if self._retries:
                self._remember_keys(call)
            return _NEW
        call.add_attempt(frame)
        self._remember_keys(call)
        if call is self._running or not call.answer:
            return RequestDecision(RequestKind.RUNNING)
        again = with_serial_and_reserved(
            call.answer, frame.serial, frame.reserved if self._echoes_reserved else 0
        )
        return RequestDecision(RequestKind.REPEAT, again)

    def answer_call(self, code: int, arguments: Sequence[Variant] = ()) -> bytes:
        """End the running call, store its reply and return it, with the serial of the newest attempt.

        Raises:
            TooLargeError: The reply is longer than `largest_answer`; the call is still running.
            LocalProtocolError: The arguments cannot be encoded; the call is still running.
        """
        call = self._running
        assert call is not None, "no call is being executed"
        raw = encode_frame(call.newest, call.reserved if self._echoes_reserved else 0, code, arguments)
        if len(raw) > self._largest:
            raise TooLargeError(Message("reply.too-large", size=len(raw), limit=self._largest))
        call.answer = raw
        self._running = None
        if self._retries:
            self._calls.appendleft(call)
        return raw

    def abandon_call(self) -> None:
        """End the running call without a reply; its retries get no reply either."""
        call = self._running
        assert call is not None, "no call is being executed"
        self._running = None
        if self._retries:
            self._calls.appendleft(call)

    def executing_notice(self) -> bytes:
        """Return a notice for the running call (S_EXECUTING, no arguments): the client keeps waiting."""
        call = self._running
        assert call is not None, "no call is being executed"
        return encode_frame(call.newest, call.reserved if self._echoes_reserved else 0, S_EXECUTING)

    def reply_unremembered(self, frame: Frame, code: int, arguments: Sequence[Variant] = ()) -> bytes:
        """Return a reply to `frame` that is not stored, such as a refusal while another call runs."""
        return encode_frame(frame.serial, frame.reserved if self._echoes_reserved else 0, code, arguments)

    def reset(self) -> None:
        """Forget the client: the next request counts as a new client's. The running call gets no reply."""
        self._calls.clear()
        self._known_keys.clear()
        self._running = None
        self._has_received = False

    def _remember_keys(self, call: _Call) -> None:
        """Remember serials and contents of a call; if the set is too large, drop those of forgotten calls."""
        traces = self._known_keys
        if len(traces) > self._known_keys_limit:
            traces.clear()
            for each in self._known_calls():
                traces |= each.serials
                traces.add(each.content)
        traces |= call.serials
        traces.add(call.content)

    def _find_call(self, frame: Frame, content: bytes) -> _Call | None:
        if self._forgets_first:
            named = frame.reserved or frame.serial
            return next((call for call in self._known_calls() if call.first == named), None)
        if frame.code == _SERVICE_START:
            self.convention = (
                self._given_convention
            )  # a program starts; another program may have used this port before
        if frame.reserved and self.convention is ReservedConvention.UNKNOWN:
            self._detect_convention(frame)
        # Every request of every client takes this path: one set look-up instead of a scan of all calls.
        if frame.serial not in self._known_keys and content not in self._known_keys:
            return None
        return self._find_among_known(frame, content)

    def _known_calls(self) -> Sequence[_Call]:
        """Return the known calls, newest first."""
        return [self._running, *self._calls] if self._running else self._calls

    def _find_among_known(self, frame: Frame, content: bytes) -> _Call | None:
        """Return the call of a request whose serial or contents are known; None for a new call."""
        calls = self._known_calls()
        serial, named = frame.serial, frame.reserved or frame.serial
        alike = [call for call in calls if serial in call.serials or call.content == content]
        # The old client's serial may wrap through 0 during its retries; the next attempt then names 0.
        after_zero = serial == 1 and frame.reserved == 0
        equal, is_known = [], False
        for call in alike:
            serials = call.serials
            if call.content == content:
                if serial in serials or named in serials or (after_zero and 0 in serials):
                    return call
                equal.append(call)
            elif serial in serials:
                is_known = True
        is_retry = frame.reserved not in (0, serial)
        # A retry may carry a serial that an earlier program on the same port used.
        chained = self._find_in_chain(frame, calls, equal) if equal and (is_retry or not is_known) else None
        if chained is None and is_known:
            self._forget_earlier_program(serial)
        return chained

    def _forget_earlier_program(self, serial: int) -> None:
        """Forget the calls of an earlier program, one of which had the serial that a different call has now.

        Calls that were executed after that one and have smaller serials belong to the present program. They
        stay, because their attempts may still arrive again.
        """
        later = list(takewhile(lambda call: serial not in call.serials, self._calls))
        self._calls.clear()
        self._calls.extend(call for call in later if not _is_ahead(call.newest, serial))

    def _find_in_chain(self, frame: Frame, calls: Iterable[_Call], equal: list[_Call]) -> _Call | None:
        """Return the call of a `CHAIN` retry whose preceding attempts were lost or come later; else None."""
        if self.convention not in _CHAIN_CONVENTIONS:
            return None
        serial, is_retry = frame.serial, frame.reserved not in (0, frame.serial)
        for call in equal:
            overtook = (call.newest - serial) % _SERIAL_COUNT < _MAX_ATTEMPTS
            if overtook or (is_retry and _is_chain_unbroken(serial, call, calls)):
                return call
        return None

    def _detect_convention(self, frame: Frame) -> None:
        """Derive the convention from a retry: only in `CHAIN` does each retry name the previous attempt."""
        if frame.reserved == frame.serial:
            self.convention = ReservedConvention.OWN
        elif (frame.serial - frame.reserved) % _SERIAL_COUNT > 1:
            self.convention = ReservedConvention.SEED
