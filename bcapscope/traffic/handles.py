"""What handles stand for, per client, and what was never given back."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass
from enum import StrEnum

from bcapscope.protocol.frame import Frame
from bcapscope.protocol.functions import FUNCTIONS, Function, ObjectClass
from bcapscope.protocol.hresult import is_success
from bcapscope.protocol.variant import EMPTY, VT
from bcapscope.protocol.wording import shortened
from bcapscope.traffic.exchange import Exchange, FrameObservation
from bcapscope.traffic.observation import Conversation
from bcapscope.traffic.question import LONGEST_NAME, MOST_CONVERSATIONS

MOST_OBJECTS = 4096
"""Objects of one client that are known at once; the oldest is forgotten first. The official server allows
1000 (orin_bcap C/src/bCAPServer/bcap_server.c)."""

MOST_SESSIONS = 1024
"""Sessions that are remembered after their end; the oldest is forgotten first."""

_HANDLE_TYPES = (VT.I4, VT.I2, VT.UI4)
_I4_HANDLE = b"\x0a\x00\x00\x00\x03\x00\x01\x00\x00\x00"  # an argument of type VT_I4 up to its value


@dataclass(slots=True, eq=False)
class Thing:
    """An object of the controller that a client has, or had, a handle of.

    Attributes:
        kind: its class.
        handle: the number.
        name: what the client asked for by name, such as `Arm`; "" where it gave none.
        parent: label of the object that it was asked of; "" for controllers and where that is not known.
        created: the call that made it.
        known: the client was told the handle; False for what a call made that was executed more than once, or
            whose reply came too late.
    """

    kind: ObjectClass
    handle: int
    name: str
    parent: str
    created: int
    known: bool

    @property
    def label(self) -> str:
        """Its name for people, `Robot 1` where it has none."""
        return self.name or f"{self.kind} {self.handle}"


class Ending(StrEnum):
    """How a service session ended."""

    STOPPED = "stopped"
    """Service_Stop, as it should."""
    RESTARTED = "restarted"
    """By another Service_Start from the same port, as after a crash."""
    OPEN = "open"
    """Not at all, as far as was seen."""


@dataclass(frozen=True, slots=True)
class Session:
    """What a client did from Service_Start to Service_Stop.

    Attributes:
        conversation: of the client.
        started: the call of Service_Start; None where the traffic began in the middle.
        ended: the call that ended it; None while it is open.
        ending: how it ended.
        left: objects that were not released, in the order in which they were made, first those whose handle
            the client was never told.
    """

    conversation: Conversation
    started: int | None
    ended: int | None
    ending: Ending
    left: tuple[Thing, ...]

    @property
    def is_clean(self) -> bool:
        """Whether it was ended in order, with everything given back."""
        return self.ending is Ending.STOPPED and not self.left


class Handles:
    """Follows the settled calls of all clients and knows what each handle stands for.

    Handles belong to a conversation and are counted apart for each class, so that a controller and a robot
    that both have handle 1 are understood as well as a server that counts them together.
    """

    def __init__(self, most_over: int = MOST_SESSIONS) -> None:
        """Begin.

        Args:
            most_over: sessions that are remembered after their end; the oldest is forgotten first.
        """
        self._clients: dict[Conversation, _Client] = {}
        self._last: _Client | None = None
        self._over: deque[Session] = deque(maxlen=most_over)

    def follow(self, exchange: Exchange) -> Thing | None:
        """Take in the next call; return the object that its handle stands for, None where that is not known.

        Calls of a conversation come in the order in which they started.
        """
        function = FUNCTIONS.get(exchange.question.function_id)
        if function is None:
            return None
        client = self._last
        if client is None or client.conversation is not exchange.conversation:
            client = self._turn_to(exchange.conversation)
        target = client.find(function.owner, handle_of(exchange.request.item))
        if function.creates is ObjectClass.SERVICE:
            if _succeeded(exchange):
                self._start(client, exchange.call)
        elif function.creates is not None:
            parent = "" if target is None else target.label
            client.create(exchange, function.creates, name_asked(exchange, function), parent)
        elif function.releases is not None and (_succeeded(exchange) or exchange.let_go):
            self._release(client, exchange.call, function.releases, target)
        return target

    def sessions(self) -> tuple[Session, ...]:
        """List the sessions that ended, in the order of their end, then those that are open.

        An open session has in `left` what it has not released so far.
        """
        begun = [client for client in self._clients.values() if client.is_begun]
        return (*self._over, *(client.session(None, Ending.OPEN) for client in begun))

    def forget(self, conversation: Conversation) -> None:
        """Forget a client that is gone."""
        client = self._clients.pop(conversation, None)
        if client is not None and client.is_begun:
            self._over.append(client.session(None, Ending.OPEN))
        if client is self._last:
            self._last = None

    def _turn_to(self, conversation: Conversation) -> _Client:
        client = self._clients.pop(conversation, None) or _Client(conversation)
        while len(self._clients) >= MOST_CONVERSATIONS:
            silent = self._clients.pop(next(iter(self._clients)))
            if silent.is_begun:
                self._over.append(silent.session(None, Ending.OPEN))
        self._clients[conversation] = self._last = client
        return client

    def _start(self, client: _Client, call: int) -> None:
        if client.is_begun:
            self._over.append(client.session(call, Ending.RESTARTED))
        client.begin(call)

    def _release(self, client: _Client, call: int, kind: ObjectClass, target: Thing | None) -> None:
        if kind is ObjectClass.SERVICE:
            self._over.append(client.session(call, Ending.STOPPED))
            client.begin(None)
        elif target is not None:
            del client.things[kind, target.handle]


class _Client:
    """The session that a client has open.

    Attributes:
        things: its objects by class and handle, in the order in which they were made; those whose handle the
            client was never told stand in `orphans`.
    """

    __slots__ = ("conversation", "orphans", "started", "things")

    def __init__(self, conversation: Conversation) -> None:
        self.conversation = conversation
        self.begin(None)

    def begin(self, call: int | None) -> None:
        self.started = call
        self.things: dict[tuple[ObjectClass, int | None], Thing] = {}
        self.orphans: deque[Thing] = deque(maxlen=MOST_OBJECTS)

    @property
    def is_begun(self) -> bool:
        return self.started is not None or bool(self.things or self.orphans)

    def session(self, ended: int | None, ending: Ending) -> Session:
        left = (*self.orphans, *self.things.values())
        return Session(self.conversation, self.started, ended, ending, left)

    def find(self, kind: ObjectClass, handle: int | None) -> Thing | None:
        thing = self.things.get((kind, handle))
        if thing is None and self.orphans:
            thing = next((one for one in self.orphans if (one.kind, one.handle) == (kind, handle)), None)
            if thing is not None:  # the client was told after all: what came late for others did not for it
                self.orphans.remove(thing)
                thing.known = True
                self.things[kind, handle] = thing
        return thing

    def create(self, exchange: Exchange, kind: ObjectClass, name: str, parent: str) -> None:
        accepted = _handle_given(exchange.reply)
        for handle in _handles_made(exchange):
            thing = Thing(kind, handle, name, parent, exchange.call, handle == accepted)
            if thing.known:
                self.things.pop((kind, handle), None)
                self.things[kind, handle] = thing
            else:
                self.orphans.append(thing)
        if len(self.things) > MOST_OBJECTS:
            del self.things[next(iter(self.things))]


def handle_of(request: Frame) -> int | None:
    """Read the handle that stands first in a request; None where there is no number."""
    raw = request.raw
    if raw[15:25] == _I4_HANDLE and len(raw) > 29 and request.reserved != 1:
        return int.from_bytes(raw[25:29], "little", signed=True)
    return _first_number(request)


def _first_number(frame: Frame) -> int | None:
    vt, value, _ = frame.arguments[0].variant if frame.arguments else EMPTY
    return value if isinstance(value, int) and vt in _HANDLE_TYPES else None


def name_asked(exchange: Exchange, function: Function) -> str:
    index = next((index for index, param in enumerate(function.params) if param.name == "bstrName"), None)
    arguments = exchange.request.item.arguments
    if index is None or index >= len(arguments):
        return ""
    value = arguments[index].variant.value
    return shortened(value, LONGEST_NAME) if isinstance(value, str) else ""


def _handle_given(reply: FrameObservation | None) -> int | None:
    if reply is None or not is_success(reply.item.code):
        return None
    return _first_number(reply.item)


def _handles_made(exchange: Exchange) -> list[int]:
    """List the handles that the tries of a call brought forth, told to the client or not."""
    replies = (*exchange.lost_replies, *exchange.late_replies, exchange.reply)
    given = [handle for reply in replies if (handle := _handle_given(reply)) is not None]
    accepted = _handle_given(exchange.reply)
    skipped = [] if accepted is None else range(accepted - exchange.skipped_handles, accepted)
    return sorted({*given, *skipped})


def _succeeded(exchange: Exchange) -> bool:
    """Tell whether the server did what was asked, whether the client knows or not."""
    replies = (exchange.reply, *exchange.late_replies, *exchange.lost_replies)
    return any(reply is not None and is_success(reply.item.code) for reply in replies)
