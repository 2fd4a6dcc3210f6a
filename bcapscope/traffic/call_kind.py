"""What a request asks, and which question a reply answers."""

from __future__ import annotations

from typing import NamedTuple

from bcapscope.protocol.codec.frame import Frame, Malformed
from bcapscope.protocol.codec.variant import VT
from bcapscope.protocol.tables.function_table import FUNCTIONS
from bcapscope.protocol.text_format import shortened
from bcapscope.traffic.observation import Conversation, Direction, Observation

MAX_KINDS = 4096
"""Different beginnings of requests that are remembered, each with its question; when more are met, all are
forgotten and learnt again. A session has some dozens: a pair of handle and command each."""

MAX_SERIALS = 1024
"""Of one conversation at least this many latest requests are known to `RecentRequests`, at most twice as
many. A client waits for each reply before it asks again, so even one that sends a set point every millisecond
and never waits meets replies a second late."""

MAX_CONVERSATIONS = 256
"""Conversations known to `RecentRequests`; the one that was silent longest is forgotten first. The official
server takes 20 clients on either transport (orin_bcap C/src/bCAPServer/bcap_server.c)."""

LONGEST_NAME = 256
"""Characters of a command's or an object's name that are kept; the others are cut off, with … in their place.
No name of a controller is nearly as long."""

COMMAND_FUNCTIONS = frozenset(
    function.id
    for function in FUNCTIONS.values()
    if len(function.params) > 1 and function.params[1].name == "bstrCommand"
)
"""The ..._Execute functions that take the name of a command as their second argument."""

_REQUEST = Direction.REQUEST
_FUNCTION_ID = 9
_BSTR_START = 29
_BSTR_DATA = 33


class CallKind(NamedTuple):
    """What a request asks, without its parameters; equal ones are usually the same object.

    Attributes:
        function_id: number of the function, known or not.
        command: as it was sent, but not more than `LONGEST_NAME` of it, for the ..._Execute functions; None
            for all others, and where the bytes hold no string in its place.
    """

    function_id: int
    command: str | None


_BY_ID: dict[int, CallKind] = {function_id: CallKind(function_id, None) for function_id in FUNCTIONS}
_BY_PREFIX: dict[bytes, CallKind] = {}
_KNOWN: dict[CallKind, CallKind] = {}


def call_kind_of(request: Frame) -> CallKind:
    """Tell what a request asks."""
    code = request.code
    if code not in COMMAND_FUNCTIONS:
        return _BY_ID.get(code) or CallKind(code, None)
    raw = request.raw
    if request.reserved == 1 or len(raw) <= _BSTR_START:
        return _read_kind(request)
    # In nearly all requests a VT_I4 handle of 14 bytes stands first, then the command with its length in
    # bytes: everything that decides about the command, and no parameter. Where the string is longer than one
    # byte of length can say, or where the handle is of another type, the slice is not kept. It takes in the
    # byte behind the string, without which the frame breaks off in it.
    beginning = raw[_FUNCTION_ID : _BSTR_DATA + raw[_BSTR_START] + 1]
    return _BY_PREFIX.get(beginning) or _learn_kind(request, beginning)


def _learn_kind(request: Frame, prefix: bytes) -> CallKind:
    question = _read_kind(request)
    arguments = request.arguments
    if (
        len(arguments) > 1
        and arguments[1].start == _BSTR_START
        and arguments[1].stop + 1 == _FUNCTION_ID + len(prefix)
        and arguments[1].variant.vt == VT.BSTR
    ):
        if len(_BY_PREFIX) >= MAX_KINDS:
            _BY_PREFIX.clear()
            _KNOWN.clear()
        question = _BY_PREFIX[prefix] = _KNOWN.setdefault(question, question)
    return question


def _read_kind(request: Frame) -> CallKind:
    arguments = request.arguments
    value = arguments[1].variant.value if len(arguments) > 1 else None
    return CallKind(request.code, shortened(value, LONGEST_NAME) if isinstance(value, str) else None)


class RecentRequests:
    """Remembers what was asked lately, so that a reply can be shown with what it answers.

    Of two requests with the same serial the later one is meant, as the official server answers it.
    """

    def __init__(self) -> None:
        self._conversations: dict[Conversation, _KindsBySerial] = {}
        self._current_conversation: Conversation | None = None
        self._current = _KindsBySerial()

    def kind_of(self, observation: Observation) -> CallKind | None:
        """Tell what a frame is about: what a request asks, or what a reply answers.

        None for bytes that are no frame, and for a reply whose request was not seen or is long ago.
        """
        frame, flow = observation.item, observation.flow
        if isinstance(frame, Malformed):
            return None
        if flow.conversation is not self._current_conversation:
            self._select_conversation(flow.conversation)
        asked = self._current
        if flow.direction is not _REQUEST:
            return asked.latest.get(frame.serial) or asked.earlier.get(frame.serial)
        question = call_kind_of(frame)
        asked.latest[frame.serial] = question
        if len(asked.latest) >= MAX_SERIALS:
            asked.earlier, asked.latest = asked.latest, {}
        return question

    def close_conversation(self, conversation: Conversation) -> None:
        """Forget a conversation that is over."""
        self._conversations.pop(conversation, None)
        if self._current_conversation is conversation:
            self._current_conversation, self._current = None, _KindsBySerial()

    def _select_conversation(self, conversation: Conversation) -> None:
        asked = self._conversations.pop(conversation, None) or _KindsBySerial()
        while len(self._conversations) >= MAX_CONVERSATIONS:
            del self._conversations[next(iter(self._conversations))]
        self._conversations[conversation] = asked
        self._current_conversation, self._current = conversation, asked


class _KindsBySerial:
    """The requests of one conversation by serial, in two generations, so that old ones go without search."""

    __slots__ = ("earlier", "latest")

    def __init__(self) -> None:
        self.latest: dict[int, CallKind] = {}
        self.earlier: dict[int, CallKind] = {}
