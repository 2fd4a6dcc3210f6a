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
from bcapscope.protocol.convention import Convention, ReplyReserved
from bcapscope.protocol.frame import LARGEST_FRAME, Frame, encode, renumbered
from bcapscope.protocol.hresult import S_EXECUTING, S_OK
from bcapscope.protocol.variant import Variant

REMEMBERED = 32
"""Answers kept for each client. One is enough for a network that keeps packets in order, as one call is asked
at a time; the others are for packets that arrive late. A UDP answer has 503 bytes at most."""

_SERVICE_START = 1
_RING = 0xFFFF
"""Serials count 1..65535 and begin again at 1."""

_MOST_TRIES = 16
"""Twice of what any client sends for one call, the one that tries without end left out."""


_CHAINS = (Convention.UNKNOWN, Convention.CHAIN)


class Defect(Flag):
    """What DENSO's C server gets wrong (orin_bcap C/src/bCAPServer/bcap_server.c), imitated on demand."""

    NONE = 0
    FORGETS_FIRST = 1
    """Only the last answer is kept, under the serial of the packet that got through, and contents are not
    compared. Where the first packet is lost, the second retry names a serial that was never seen and is
    executed again; a client that starts anew with the serial answered last gets the old answer."""
    SERIAL_ZERO = 2
    """A new client whose first packet has serial 0 is answered S_OK, and nothing is executed."""


class Verdict(Enum):
    """What a request is."""

    NEW = "new"
    """To be executed; then `Responder.answer`."""
    REPEAT = "repeat"
    """Executed before; the kept answer is to be sent again."""
    RUNNING = "running"
    """The call that is being executed, asked again: its answer will carry the serial of this packet. Or one
    that was abandoned, which has none."""
    BUSY = "busy"
    """Another call while one is being executed; `Responder.reply` refuses it, if it is to be refused."""


@dataclass(frozen=True, slots=True)
class Decision:
    """What to do about a request.

    Attributes:
        verdict: what it is.
        reply: the frame to send now; None unless the verdict is `REPEAT`.
    """

    verdict: Verdict
    reply: bytes | None = None


_NEW = Decision(Verdict.NEW)


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

    def asked_by(self, frame: Frame) -> None:
        """Take `frame` for one more packet of this call."""
        self.serials |= {frame.serial, frame.reserved or frame.serial}
        if _is_ahead(frame.serial, self.newest):
            self.newest = frame.serial
            self.reserved = frame.reserved


def _is_ahead(serial: int, other: int) -> bool:
    """Whether a serial was counted after another one, or is the same."""
    return (serial - other) % _RING < _RING // 2


def _is_next(serial: int, call: _Call, calls: Iterable[_Call]) -> bool:
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

    It never executes anything itself: `receive` says what a request is, and `answer` ends the call that
    `receive` called new. Requests of a client are executed strictly one after another.

    The first packet has reserved 0 or its own serial. Any other value names a packet of the same call, the
    first or the one before. A packet that names one of a remembered call and has the same contents (function
    and arguments) belongs to it, and what it names and its own serial are learnt as further names of the
    call. A known serial with other contents is a client that has started anew.

    Two cases cannot be decided by the bytes. A client of the old C library (`Convention.CHAIN`) names the try
    before, and where that try was lost its retry looks like the retry of a new, equal call. And a program
    that starts anew on the port of another one counts from the same serial again, so that a call which is
    equal to one of its predecessor's, at the same serial or shortly before it, looks like a packet of that
    one which was on the way for long. Both are held to be asked before, unless the client is known to have
    another convention: nothing ever runs twice. The price is that such a call is not executed and its client
    gets the earlier answer, an old value or the success of a motion that was made once and not twice. With
    the first call of the new program that differs from what was asked under its serial, all that its
    predecessor asked is forgotten; at the latest when `remembered` further calls have been made.
    """

    def __init__(
        self,
        *,
        retries: bool = True,
        replies: ReplyReserved = ReplyReserved.ZERO,
        convention: Convention = Convention.UNKNOWN,
        remembered: int = REMEMBERED,
        largest: int = LARGEST_FRAME,
        defects: Defect = Defect.NONE,
    ) -> None:
        """Begin with a client of which nothing is known.

        Args:
            retries: whether requests may come again: True on UDP; on TCP every request is a new one.
            replies: what replies carry in reserved; `UNKNOWN` is the same as `ZERO`.
            convention: of the client, where that is known beforehand; else it is learnt.
            remembered: answers that are kept.
            largest: bytes that an answer may have.
            defects: of DENSO's C server that are to be imitated.
        """
        self.convention = self._told = convention
        self._retries = retries
        self._echo = replies is ReplyReserved.ECHOED
        self._largest = largest
        self._defects = defects
        self._forgets_first = Defect.FORGETS_FIRST in defects
        self._calls: deque[_Call] = deque(maxlen=1 if self._forgets_first else remembered)
        self._traces: set[int | bytes] = set()  # serials and contents of all known calls, and of some others
        self._most_traces = 8 * remembered
        self._running: _Call | None = None
        self._heard = False

    @property
    def running(self) -> bool:
        """Whether a call is being executed."""
        return self._running is not None

    def receive(self, frame: Frame) -> Decision:
        """Say what a request is. After `NEW` the call is running until `answer`."""
        heard, self._heard = self._heard, True
        content = frame.raw[9:]
        call = self._find(frame, content) if self._retries else None
        if call is None:
            if self._running is not None:
                return Decision(Verdict.BUSY)
            if not heard and self._retries and frame.serial == 0 and Defect.SERIAL_ZERO in self._defects:
                return Decision(Verdict.REPEAT, self.reply(frame, S_OK))
            self._running = call = _Call(frame, content)
            if self._retries:
                self._note(call)
            return _NEW
        call.asked_by(frame)
        self._note(call)
        if call is self._running or not call.answer:
            return Decision(Verdict.RUNNING)
        again = renumbered(call.answer, frame.serial, frame.reserved if self._echo else 0)
        return Decision(Verdict.REPEAT, again)

    def answer(self, code: int, arguments: Sequence[Variant] = ()) -> bytes:
        """End the running call: keep its answer and make the frame to send, for the newest of its packets.

        Args:
            code: HRESULT.
            arguments: of the reply.

        Raises:
            TooLargeError: the answer is longer than `largest`; the call is still running.
            LocalProtocolError: the arguments cannot be packed; the call is still running.
        """
        call = self._running
        assert call is not None, "no call is being executed"
        raw = encode(call.newest, call.reserved if self._echo else 0, code, arguments)
        if len(raw) > self._largest:
            raise TooLargeError(f"an answer of {len(raw)} bytes, {self._largest} is the most")
        call.answer = raw
        self._running = None
        if self._retries:
            self._calls.appendleft(call)
        return raw

    def abandon(self) -> None:
        """End the running call without an answer: who asks for it again hears nothing, either."""
        call = self._running
        assert call is not None, "no call is being executed"
        self._running = None
        if self._retries:
            self._calls.appendleft(call)

    def notice(self) -> bytes:
        """Make the frame that tells the client of the running call to wait on: S_EXECUTING, no arguments."""
        call = self._running
        assert call is not None, "no call is being executed"
        return encode(call.newest, call.reserved if self._echo else 0, S_EXECUTING)

    def reply(self, frame: Frame, code: int, arguments: Sequence[Variant] = ()) -> bytes:
        """Make a reply to `frame` that is not kept, such as the refusal of what came while busy."""
        return encode(frame.serial, frame.reserved if self._echo else 0, code, arguments)

    def forget(self) -> None:
        """Forget the client: what comes next comes from a new one. The running call gets no answer."""
        self._calls.clear()
        self._traces.clear()
        self._running = None
        self._heard = False

    def _note(self, call: _Call) -> None:
        """Keep what a call has left; now and then, let go of what forgotten calls have."""
        traces = self._traces
        if len(traces) > self._most_traces:
            traces.clear()
            for each in self._known():
                traces |= each.serials
                traces.add(each.content)
        traces |= call.serials
        traces.add(call.content)

    def _find(self, frame: Frame, content: bytes) -> _Call | None:
        if self._forgets_first:
            named = frame.reserved or frame.serial
            return next((call for call in self._known() if call.first == named), None)
        if frame.code == _SERVICE_START:
            self.convention = self._told  # a program begins, and not always the one that was on this port
        if frame.reserved and self.convention is Convention.UNKNOWN:
            self._learn(frame)
        # Every request of every client passes here: one look at what the calls left, and none at each.
        if frame.serial not in self._traces and content not in self._traces:
            return None
        return self._find_alike(frame, content)

    def _known(self) -> Sequence[_Call]:
        """Return the calls that are known, the newest first."""
        return [self._running, *self._calls] if self._running else self._calls

    def _find_alike(self, frame: Frame, content: bytes) -> _Call | None:
        """Find a call among those that have this serial or these contents."""
        calls = self._known()
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
        chained = self._chained(frame, calls, equal) if equal and (is_retry or not is_known) else None
        if chained is None and is_known:
            self._forget_before(serial)
        return chained

    def _forget_before(self, serial: int) -> None:
        """Forget the program whose call had a serial that another one has now.

        Calls that were executed after that one and have smaller serials are of the program that asks now:
        their packets may still come again.
        """
        later = list(takewhile(lambda call: serial not in call.serials, self._calls))
        self._calls.clear()
        self._calls.extend(call for call in later if not _is_ahead(call.newest, serial))

    def _chained(self, frame: Frame, calls: Iterable[_Call], equal: list[_Call]) -> _Call | None:
        """Find the call of a chain of which the packets between were lost or come later."""
        if self.convention not in _CHAINS:
            return None
        serial, is_retry = frame.serial, frame.reserved not in (0, frame.serial)
        for call in equal:
            overtook = (call.newest - serial) % _RING < _MOST_TRIES
            if overtook or (is_retry and _is_next(serial, call, calls)):
                return call
        return None

    def _learn(self, frame: Frame) -> None:
        """Learn the convention from a packet: only in a chain does each retry name the try before it."""
        if frame.reserved == frame.serial:
            self.convention = Convention.OWN
        elif (frame.serial - frame.reserved) % _RING > 1:
            self.convention = Convention.SEED
