"""The controller's part of a call: recognise retries, so that no call is executed twice.

A client that gets no reply in time sends its request again with a new serial. The reserved field of the retry
names an earlier attempt (DENSO Wave 2009, How to use the Slave mode, Retry sequence in UDP connection). The
client accepts only a reply with its newest serial.
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
"""Number of stored replies (over UDP, at most 503 bytes each). Clients retry only their latest call, so more
than one reply is needed only for retries that arrive after a newer call.
"""

_SERVICE_START = 1
_SERIAL_COUNT = 0xFFFF

_MAX_ATTEMPTS = 16
"""An attempt counts as delayed only if its serial is lower than the newest serial of its call by less than
this number. Known clients send at most 8 attempts per call, except for one client that retries without end.
"""


_CHAIN_CONVENTIONS = (ReservedConvention.UNKNOWN, ReservedConvention.CHAIN)


class Defect(Flag):
    """Defects of DENSO's C server that a responder can imitate (orin_bcap C/src/bCAPServer/bcap_server.c)."""

    NONE = 0
    FORGETS_FIRST = 1
    """The server stores only its last reply, with the serial of the first attempt that arrived, and does not
    compare the contents of requests. If the first attempt is lost, the server executes the first retry and
    stores the serial of this retry. The reserved field of the second retry holds the serial of the lost
    attempt, so the server executes the second retry as a new call. If a client restarts with the serial of
    its last call, the server sends the old reply.
    """
    SERIAL_ZERO = 2
    """If the first frame of a new client has serial 0, the server answers S_OK without executing the call."""


class RequestKind(Enum):
    NEW = "new"
    """A new call: execute it, then call `Responder.answer_call`."""
    REPEAT = "repeat"
    """A retry of a completed call: send the stored reply again."""
    RUNNING = "running"
    """A retry of the running call. The reply to this call will carry the serial of the retry. A retry of an
    abandoned call is also `RUNNING`, but never gets a reply.
    """
    BUSY = "busy"
    """A new call that arrives while another call is running. `reply_unremembered` may refuse it."""


@dataclass(frozen=True, slots=True)
class RequestDecision:
    """What the controller must do with a request. For `REPEAT`, `reply` is the stored reply to send now."""

    kind: RequestKind
    reply: bytes | None = None


_NEW = RequestDecision(RequestKind.NEW)


class _Call:
    def __init__(self, frame: Frame, content: bytes) -> None:
        self.content = content
        self.first = frame.serial
        self.newest = frame.serial
        self.reserved = frame.reserved
        self.serials = {frame.serial, frame.reserved or frame.serial}
        self.answer = b""

    def keys(self) -> set[int | bytes]:
        return {*self.serials, self.content}

    def add_attempt(self, frame: Frame) -> None:
        self.serials |= {frame.serial, frame.reserved or frame.serial}
        if _is_ahead(frame.serial, self.newest):
            self.newest = frame.serial
            self.reserved = frame.reserved


def _is_ahead(serial: int, other: int) -> bool:
    """Return whether `serial` equals or follows `other`; after 65535, serials continue at 1."""
    return (serial - other) % _SERIAL_COUNT < _SERIAL_COUNT // 2


def _is_chain_unbroken(serial: int, call: _Call, calls: Iterable[_Call]) -> bool:
    """Return whether an attempt with `serial` may belong to `call`. This is impossible if the newest serial
    of a newer call is in the range from `call.newest` to `serial`. `calls` lists the newest call first. Calls
    that are older than `call` do not matter, because an earlier program on the same port may have made them.
    """
    later = takewhile(lambda other: other is not call, calls)
    return not any(
        _is_ahead(other.newest, call.newest) and _is_ahead(serial, other.newest) for other in later
    )


class Responder:
    """Decides for one client whether each request is a new call or a retry; executes nothing.

    Over UDP, each address and port counts as a client. Over TCP, each connection counts as a client. A
    controller executes the calls of a client one after another.

    In a first attempt, the reserved field holds 0 or the frame's own serial. In a retry, the reserved field
    holds the serial of the first or the previous attempt. A request belongs to a remembered call if function
    and arguments are the same, and its reserved field holds the serial of an attempt of this call. The
    responder adds the serial and the reserved field of a retry to the serials of the call. If a request with
    a known serial has other contents, the client has restarted, and the responder forgets the calls from
    before the restart.

    In two cases, a request does not show whether it is a new call or a retry:

    * A retry from a client of the old C library (`ReservedConvention.CHAIN`) holds the serial of the previous
      attempt in its reserved field. If the previous attempt was lost, the retry may belong to a known call,
      or to a new call with the same contents.
    * A new program on the port of an earlier program may start with the same serial. If an earlier call with
      the same contents has an equal or slightly higher serial, the new call looks like a delayed attempt of
      the earlier call.

    If a request may be a new call or a retry, the responder assumes a retry, so that no call is executed
    twice. If the responder mistakes a new call for a retry, the controller does not execute the call, and the
    client gets the earlier reply. The earlier reply may hold an old value, or report a motion that the robot
    made for the earlier call.
    """

    def __init__(
        self,
        *,
        expects_retries: bool = True,
        reply_reserved: ReplyReserved = ReplyReserved.ZERO,
        remembered: int = REMEMBERED_ANSWERS,
        largest_answer: int = LARGEST_FRAME,
        defects: Defect = Defect.NONE,
    ) -> None:
        """Create a responder for a client that has sent no request yet. `expects_retries` is False for TCP,
        where every request is a new call. The responder stores the latest `remembered` replies. A reply has
        at most `largest_answer` bytes.
        """
        self.convention = ReservedConvention.UNKNOWN
        self._retries = expects_retries
        self._echoes_reserved = reply_reserved is ReplyReserved.ECHOED
        self._largest = largest_answer
        self._defects = defects
        self._forgets_first = Defect.FORGETS_FIRST in defects
        self._calls: deque[_Call] = deque(maxlen=1 if self._forgets_first else remembered)
        # Serials and contents of all known calls. The set keeps the keys of forgotten calls until the set is
        # full.
        self._known_keys: set[int | bytes] = set()
        self._known_keys_limit = 8 * remembered
        self._running: _Call | None = None
        self._has_received = False

    @property
    def is_call_running(self) -> bool:
        return self._running is not None

    def receive_request(self, frame: Frame) -> RequestDecision:
        """Classify a request. A `NEW` call runs until `answer_call` or `abandon_call` ends it."""
        had_received, self._has_received = self._has_received, True
        content = frame.raw[9:]
        call = self._find_call(frame, content) if self._retries else None
        if call is None:
            if self._running is not None:
                return RequestDecision(RequestKind.BUSY)
            is_ignored = frame.serial == 0 and Defect.SERIAL_ZERO in self._defects
            if is_ignored and self._retries and not had_received:
                return RequestDecision(RequestKind.REPEAT, self.reply_unremembered(frame, S_OK))
            self._running = call = _Call(frame, content)
            if self._retries:
                self._remember_keys(call)
            return _NEW
        call.add_attempt(frame)
        self._remember_keys(call)
        if call is self._running or not call.answer:
            return RequestDecision(RequestKind.RUNNING)
        again = with_serial_and_reserved(call.answer, frame.serial, self._reply_reserved(frame.reserved))
        return RequestDecision(RequestKind.REPEAT, again)

    def answer_call(self, code: int, arguments: Sequence[Variant] = ()) -> bytes:
        """End the running call, store its reply, and return the reply with the serial of the newest attempt.

        Raises:
            TooLargeError: The reply is longer than `largest_answer`. The call continues to run.
            LocalProtocolError: The arguments cannot be encoded. The call continues to run.
        """
        call = self._running
        assert call is not None, "no call is being executed"
        raw = encode_frame(call.newest, self._reply_reserved(call.reserved), code, arguments)
        if len(raw) > self._largest:
            raise TooLargeError(Message("reply.too-large", size=len(raw), limit=self._largest))
        call.answer = raw
        self._running = None
        if self._retries:
            self._calls.appendleft(call)
        return raw

    def abandon_call(self) -> None:
        """End the running call without a reply. If the client retries this call, `receive_request` returns
        `RUNNING`, so the retry gets no reply either.
        """
        call = self._running
        assert call is not None, "no call is being executed"
        self._running = None
        if self._retries:
            self._calls.appendleft(call)

    def executing_notice(self) -> bytes:
        """Return a notice (S_EXECUTING) for the running call, so that the client keeps waiting."""
        call = self._running
        assert call is not None, "no call is being executed"
        return encode_frame(call.newest, self._reply_reserved(call.reserved), S_EXECUTING)

    def reply_unremembered(self, frame: Frame, code: int) -> bytes:
        return encode_frame(frame.serial, self._reply_reserved(frame.reserved), code)

    def _reply_reserved(self, reserved: int) -> int:
        return reserved if self._echoes_reserved else 0

    def reset(self) -> None:
        """Forget all calls of the client. A call that is still running gets no reply."""
        self._calls.clear()
        self._running = None
        self._has_received = False

    def _remember_keys(self, call: _Call) -> None:
        """Add a call's serials and contents to `_known_keys`. If `_known_keys` is full, first remove the keys
        of forgotten calls.
        """
        if len(self._known_keys) > self._known_keys_limit:
            self._known_keys = set().union(*(each.keys() for each in self._known_calls()))
        self._known_keys |= call.keys()

    def _find_call(self, frame: Frame, content: bytes) -> _Call | None:
        if self._forgets_first:
            named = frame.reserved or frame.serial
            return next((call for call in self._known_calls() if call.first == named), None)
        if frame.code == _SERVICE_START:
            # Service_Start is a program's first call; another program may have used this port before.
            self.convention = ReservedConvention.UNKNOWN
        if frame.reserved and self.convention is ReservedConvention.UNKNOWN:
            self._detect_convention(frame)
        # For most requests, two look-ups in a set are enough; a scan of all calls would be slow.
        if frame.serial not in self._known_keys and content not in self._known_keys:
            return None
        return self._find_among_known(frame, content)

    def _known_calls(self) -> Sequence[_Call]:
        """Return the known calls, newest first."""
        return [self._running, *self._calls] if self._running else self._calls

    def _find_among_known(self, frame: Frame, content: bytes) -> _Call | None:
        """Return the known call to which a request belongs; None for a new call."""
        calls = self._known_calls()
        serial, named = frame.serial, frame.reserved or frame.serial
        alike = [call for call in calls if serial in call.serials or call.content == content]
        # After serial 65535, a retry of the old C client may have serial 0. In this case, the next attempt
        # has serial 1 and, as the serial of the previous attempt, 0 in its reserved field.
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
        # A retry may carry a serial that an earlier program on the same port also used.
        chained = self._find_in_chain(frame, calls, equal) if equal and (is_retry or not is_known) else None
        if chained is None and is_known:
            self._forget_earlier_program(serial)
        return chained

    def _forget_earlier_program(self, serial: int) -> None:
        """Forget the calls of an earlier program on the client's port. Two different calls have used
        `serial`, so the second call comes from a new program. Keep the calls that are newer than the first of
        the two and have serials lower than `serial`: the new program made these calls, and may retry them.
        """
        later = list(takewhile(lambda call: serial not in call.serials, self._calls))
        self._calls.clear()
        self._calls.extend(call for call in later if not _is_ahead(call.newest, serial))

    def _find_in_chain(self, frame: Frame, calls: Iterable[_Call], equal: list[_Call]) -> _Call | None:
        """Return the call to which an attempt belongs under the convention `CHAIN`. The previous attempt may
        be lost, or a later attempt may have arrived first.
        """
        if self.convention not in _CHAIN_CONVENTIONS:
            return None
        serial, is_retry = frame.serial, frame.reserved not in (0, frame.serial)
        for call in equal:
            overtook = (call.newest - serial) % _SERIAL_COUNT < _MAX_ATTEMPTS
            if overtook or (is_retry and _is_chain_unbroken(serial, call, calls)):
                return call
        return None

    def _detect_convention(self, frame: Frame) -> None:
        """Find out from a reserved field that is not 0 which `ReservedConvention` the client uses."""
        if frame.reserved == frame.serial:
            self.convention = ReservedConvention.OWN
        elif (frame.serial - frame.reserved) % _SERIAL_COUNT > 1:
            self.convention = ReservedConvention.SEED
