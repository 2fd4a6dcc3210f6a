"""Find the function and command of a request, or of the request that a reply answers."""

from __future__ import annotations

from typing import NamedTuple

from bcapscope.protocol.codec.frame import Frame, Malformed
from bcapscope.protocol.codec.variant import VT
from bcapscope.protocol.tables.command_catalogue import COMMAND_FUNCTIONS, command_name
from bcapscope.protocol.tables.function_table import FUNCTIONS, signed_function_id
from bcapscope.protocol.text_format import shortened
from bcapscope.traffic.observation import Conversation, Direction, Observation
from bcapscope.traffic.recent_serials import RecentSerials

MAX_KINDS = 4096
"""Maximum number of pairs of handle and command that `CallKinds` remembers. A client normally uses only a
few dozen different pairs.
"""

MAX_CONVERSATIONS = 256
"""Maximum number of conversations that `RecentRequests` or `Tracker` remembers. When one more conversation
begins, each of these classes drops the conversation with the longest silence. DENSO's C server accepts 20
clients on each transport (orin_bcap C/src/bCAPServer/bcap_server.c).
"""

LONGEST_NAME = 256

_REQUEST = Direction.REQUEST
_FUNCTION_ID = 9
_BSTR_START = 29
_BSTR_DATA = 33


class CallKind(NamedTuple):
    """Function and command of a request, without its parameters.

    Equal call kinds are usually the same Python object.

    Attributes:
        function_id: Number of the function, signed, even if the function is unknown.
        command: Command of an ..._Execute function as sent, shortened to `LONGEST_NAME` characters; None for
            all other functions, or if the second argument is no string.
    """

    function_id: int
    command: str | None

    @property
    def folded_command(self) -> str:
        """The command in lower case, because controllers ignore case; "" if there is no command."""
        return (self.command or "").casefold()


_BY_ID: dict[int, CallKind] = {function_id: CallKind(function_id, None) for function_id in FUNCTIONS}


def call_kind_of(request: Frame) -> CallKind:
    """Return the function and command of a request."""
    if request.code not in COMMAND_FUNCTIONS:
        return _BY_ID.get(request.code) or CallKind(signed_function_id(request.code), None)
    command = command_name(request.code, request.variants)
    return CallKind(request.code, None if command is None else shortened(command, LONGEST_NAME))


class CallKinds:
    """Finds the call kinds of many requests fast, by their first bytes."""

    def __init__(self) -> None:
        self._by_prefix: dict[bytes, CallKind] = {}
        self._known: dict[CallKind, CallKind] = {}

    def kind_of(self, request: Frame) -> CallKind:
        """Return what `call_kind_of` returns."""
        raw = request.raw
        if request.code not in COMMAND_FUNCTIONS or request.reserved == 1 or len(raw) <= _BSTR_START:
            return call_kind_of(request)
        # In nearly all requests, the first argument is a VT_I4 handle of 14 bytes. The second argument is the
        # command, and begins with the argument's length in bytes. The prefix contains all bytes that
        # determine the command, but no value of a parameter. `_learn` stores the prefix only if the handle
        # takes 14 bytes and the command argument is shorter than 256 bytes. The prefix also includes the byte
        # after the command argument. If a frame was cut before this byte, its prefix is too short to equal a
        # stored prefix.
        prefix = raw[_FUNCTION_ID : _BSTR_DATA + raw[_BSTR_START] + 1]
        return self._by_prefix.get(prefix) or self._learn(request, prefix)

    def _learn(self, request: Frame, prefix: bytes) -> CallKind:
        kind = call_kind_of(request)
        arguments = request.arguments
        if (
            len(arguments) > 1
            and arguments[1].start == _BSTR_START
            and arguments[1].stop + 1 == _FUNCTION_ID + len(prefix)
            and arguments[1].variant.vt == VT.BSTR
        ):
            if len(self._by_prefix) >= MAX_KINDS:
                self._by_prefix.clear()
                self._known.clear()
            kind = self._by_prefix[prefix] = self._known.setdefault(kind, kind)
        return kind


class RecentRequests:
    """Remembers recent requests, so that a reply can be shown with the function of its request."""

    def __init__(self) -> None:
        self._kind_of = CallKinds().kind_of
        self._conversations: dict[Conversation, RecentSerials[CallKind]] = {}
        self._current_conversation: Conversation | None = None
        self._current: RecentSerials[CallKind] = RecentSerials()

    def kind_of(self, observation: Observation) -> CallKind | None:
        """Return the kind of a request. For a reply, return the kind of the latest request with its serial.
        Return None for bytes that are no frame, and for a reply to an old or uncaptured request.
        """
        frame, flow = observation.item, observation.flow
        if isinstance(frame, Malformed):
            return None
        if flow.conversation is not self._current_conversation:
            self._select_conversation(flow.conversation)
        if flow.direction is not _REQUEST:
            return self._current.get(frame.serial)
        kind = self._kind_of(frame)
        self._current.put(frame.serial, kind)
        return kind

    def close_conversation(self, conversation: Conversation) -> None:
        self._conversations.pop(conversation, None)
        if self._current_conversation is conversation:
            self._current_conversation, self._current = None, RecentSerials()

    def _select_conversation(self, conversation: Conversation) -> None:
        asked = self._conversations.pop(conversation, None) or RecentSerials()
        while len(self._conversations) >= MAX_CONVERSATIONS:
            del self._conversations[next(iter(self._conversations))]
        self._conversations[conversation] = asked
        self._current_conversation, self._current = conversation, asked
