"""The server's side of retries: tell a new call from one that was asked before, so that none runs twice.

A client that gets no reply in time sends its request again with a new serial; reserved says which packet is
meant (DENSO Wave 2009, How to use the Slave mode, Retry sequence in UDP connection). Only the reply to the
newest serial counts for the client, so an answer that was kept is sent again under the serial of the retry.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from enum import Enum, Flag
from itertools import takewhile

from bcapscope.errors import TooLargeError
from bcapscope.protocol.codec.frame import LARGEST_FRAME, Frame, encode_frame, with_serial_and_reserved
from bcapscope.protocol.codec.variant import Variant
from bcapscope.protocol.retry.reserved_convention import ReplyReserved, ReservedConvention
from bcapscope.protocol.tables.hresult import S_EXECUTING, S_OK

REMEMBERED_ANSWERS = 32
"""Answers kept for each client. One is enough for a network that keeps packets in order, as one call is asked
at a time; the others are for packets that arrive late. A UDP answer has 503 bytes at most."""

_SERVICE_START = 1
_SERIAL_COUNT = 0xFFFF
"""Serials count 1..65535 and begin again at 1."""

_MAX_ATTEMPTS = 16
"""Twice of what any client sends for one call, the one that tries without end left out."""


_CHAIN_CONVENTIONS = (ReservedConvention.UNKNOWN, ReservedConvention.CHAIN)


class Defect(Flag):
    """What DENSO's C server gets wrong (orin_bcap C/src/bCAPServer/bcap_server.c), imitated on demand."""

    NONE = 0
    FORGETS_FIRST = 1
    """Only the last answer is kept, under the serial of the packet that got through, and contents are not
    compared. Where the first packet is lost, the second retry names a serial that was never seen and is
    executed again; a client that starts anew with the serial answered last gets the old answer."""
    SERIAL_ZERO = 2
    """A new client whose first packet has serial 0 is answered S_OK, and nothing is executed."""


class RequestKind(Enum):
    """What a request is."""

    NEW = "new"
    """To be executed; then `Responder.answer_call`."""
    REPEAT = "repeat"
    """Executed before; the kept answer is to be sent again."""
    RUNNING = "running"
    """The call that is being executed, asked again: its answer will carry the serial of this packet. Or one
    that was abandoned, which has none."""
    BUSY = "busy"
    """Another call while one is being executed; `Responder.reply_unremembered` refuses it, if it is to be
    refused.
    """


@dataclass(frozen=True, slots=True)
class RequestDecision:
    """What to do about a request.

    Attributes:
        kind: what it is.
        reply: the frame to send now; None unless the verdict is `REPEAT`.
    """

    kind: RequestKind
    reply: bytes | None = None


_NEW = RequestDecision(RequestKind.NEW)


class _Call:
    """One call and all packets that are known to have asked for it."""

    __slots__ = ("answer", "content", "first", "newest", "reserved", "serials")

    def __init__(self, frame: Frame, content: bytes) -> None:
        self.content = content
        self.first = frame.serial
        self.newest = frame.serial
        self.reserved = frame.reserved
        self.serials = {frame.serial, frame.reserved or frame.serial}
        self.answer = b""

    def add_attempt(self, frame: Frame) -> None:
        """Take `frame` for one more packet of this call."""
        self.serials |= {frame.serial, frame.reserved or frame.serial}
        if _is_ahead(frame.serial, self.newest):
            self.newest = frame.serial
            self.reserved = frame.reserved


def _is_ahead(serial: int, other: int) -> bool:
    """Whether a serial was counted after another one, or is the same."""
    return (serial - other) % _SERIAL_COUNT < _SERIAL_COUNT // 2


def _is_chain_unbroken(serial: int, call: _Call, calls: Iterable[_Call]) -> bool:
    """Whether no call is known that was asked between a call and a later serial.

    Of `calls`, the newest first, only those count that were executed after the call: what was before it is
    of an earlier program if its serials are ahead.
    """
    later = takewhile(lambda other: other is not call, calls)
    return not any(
        _is_ahead(other.newest, call.newest) and _is_ahead(serial, other.newest) for other in later
    )


class Responder:
    """Decides for one client (on UDP one address and port, on TCP one connection) what each request is.

    It never executes anything itself: `receive_request` says what a request is, and `answer_call` ends the
    call that
    `receive_request` called new. Requests of a client are executed strictly one after another.

    The first packet has reserved 0 or its own serial. Any other value names a packet of the same call, the
    first or the one before. A packet that names one of a remembered call and has the same contents (function
    and arguments) belongs to it, and what it names and its own serial are learnt as further names of the
    call. A known serial with other contents is a client that has started anew.

    Two cases cannot be decided by the bytes. A client of the old C library (`ReservedConvention.CHAIN`) names
    the try before, and where that try was lost its retry looks like the retry of a new, equal call. And a
    program that starts anew on the port of another one counts from the same serial again, so that a call
    which is equal to one of its predecessor's, at the same serial or shortly before it, looks like a packet
    of that one which was on the way for long. Both are held to be asked before, unless the client is known to
    have another convention: nothing ever runs twice. The price is that such a call is not executed and its
    client gets the earlier answer, an old value or the success of a motion that was made once and not twice.
    With the first call of the new program that differs from what was asked under its serial, all that its
    predecessor asked is forgotten; at the latest when `remembered` further calls have been made.
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
        """Begin with a client of which nothing is known.

        Args:
            expects_retries: whether requests may come again: True on UDP; on TCP every request is a new one.
            reply_reserved: what replies carry in reserved; `UNKNOWN` is the same as `ZERO`.
            convention: of the client, where that is known beforehand; else it is learnt.
            remembered: answers that are kept.
            largest_answer: bytes that an answer may have.
            defects: of DENSO's C server that are to be imitated.
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
        """Whether a call is being executed."""
        return self._running is not None

    def receive_request(self, frame: Frame) -> RequestDecision:
        """Say what a request is. After `NEW` the call is running until `answer_call`."""
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
        """End the running call: keep its answer and make the frame to send, for the newest of its packets.

        Args:
            code: HRESULT.
            arguments: of the reply.

        Raises:
            TooLargeError: the answer is longer than `largest_answer`; the call is still running.
            LocalProtocolError: the arguments cannot be packed; the call is still running.
        """
        call = self._running
        assert call is not None, "no call is being executed"
        raw = encode_frame(call.newest, call.reserved if self._echoes_reserved else 0, code, arguments)
        if len(raw) > self._largest:
            raise TooLargeError(f"an answer of {len(raw)} bytes, {self._largest} is the most")
        call.answer = raw
        self._running = None
        if self._retries:
            self._calls.appendleft(call)
        return raw

    def abandon_call(self) -> None:
        """End the running call without an answer: who asks for it again hears nothing, either."""
        call = self._running
        assert call is not None, "no call is being executed"
        self._running = None
        if self._retries:
            self._calls.appendleft(call)

    def executing_notice(self) -> bytes:
        """Make the frame that tells the client of the running call to wait on: S_EXECUTING, no arguments."""
        call = self._running
        assert call is not None, "no call is being executed"
        return encode_frame(call.newest, call.reserved if self._echoes_reserved else 0, S_EXECUTING)

    def reply_unremembered(self, frame: Frame, code: int, arguments: Sequence[Variant] = ()) -> bytes:
        """Make a reply to `frame` that is not kept, such as the refusal of what came while busy."""
        return encode_frame(frame.serial, frame.reserved if self._echoes_reserved else 0, code, arguments)

    def reset(self) -> None:
        """Forget the client: what comes next comes from a new one. The running call gets no answer."""
        self._calls.clear()
        self._known_keys.clear()
        self._running = None
        self._has_received = False

    def _remember_keys(self, call: _Call) -> None:
        """Keep what a call has left; now and then, let go of what forgotten calls have."""
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
            )  # a program begins, and not always the one that was on this port
        if frame.reserved and self.convention is ReservedConvention.UNKNOWN:
            self._detect_convention(frame)
        # Every request of every client passes here: one look at what the calls left, and none at each.
        if frame.serial not in self._known_keys and content not in self._known_keys:
            return None
        return self._find_among_known(frame, content)

    def _known_calls(self) -> Sequence[_Call]:
        """Return the calls that are known, the newest first."""
        return [self._running, *self._calls] if self._running else self._calls

    def _find_among_known(self, frame: Frame, content: bytes) -> _Call | None:
        """Find a call among those that have this serial or these contents."""
        calls = self._known_calls()
        serial, named = frame.serial, frame.reserved or frame.serial
        alike = [call for call in calls if serial in call.serials or call.content == content]
        # The old client's serials may pass through 0 while it retries, and the next try then names 0.
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
        # A retry may bear a serial that a program before this one on the same port has used.
        chained = self._find_in_chain(frame, calls, equal) if equal and (is_retry or not is_known) else None
        if chained is None and is_known:
            self._forget_earlier_program(serial)
        return chained

    def _forget_earlier_program(self, serial: int) -> None:
        """Forget the program whose call had a serial that another one has now.

        Calls that were executed after that one and have smaller serials are of the program that asks now:
        their packets may still come again.
        """
        later = list(takewhile(lambda call: serial not in call.serials, self._calls))
        self._calls.clear()
        self._calls.extend(call for call in later if not _is_ahead(call.newest, serial))

    def _find_in_chain(self, frame: Frame, calls: Iterable[_Call], equal: list[_Call]) -> _Call | None:
        """Find the call of a chain of which the packets between were lost or come later."""
        if self.convention not in _CHAIN_CONVENTIONS:
            return None
        serial, is_retry = frame.serial, frame.reserved not in (0, frame.serial)
        for call in equal:
            overtook = (call.newest - serial) % _SERIAL_COUNT < _MAX_ATTEMPTS
            if overtook or (is_retry and _is_chain_unbroken(serial, call, calls)):
                return call
        return None

    def _detect_convention(self, frame: Frame) -> None:
        """Learn the convention from a packet: only in a chain does each retry name the try before it."""
        if frame.reserved == frame.serial:
            self.convention = ReservedConvention.OWN
        elif (frame.serial - frame.reserved) % _SERIAL_COUNT > 1:
            self.convention = ReservedConvention.SEED
