"""Track the object that each handle of a client refers to, and the objects that the client never released."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass
from enum import StrEnum

from bcapscope.protocol.codec.frame import Frame
from bcapscope.protocol.codec.variant import EMPTY, VT
from bcapscope.protocol.tables.function_table import FUNCTIONS, Function, ObjectClass
from bcapscope.protocol.tables.hresult import is_success
from bcapscope.protocol.text_format import shortened
from bcapscope.traffic.call import Call, FrameObservation
from bcapscope.traffic.call_kind import LONGEST_NAME, MAX_CONVERSATIONS
from bcapscope.traffic.observation import Conversation

MAX_OBJECTS = 4096
"""Maximum number of remembered objects per client. Beyond the limit, the oldest object is dropped. DENSO's C
server allows 1000 objects (orin_bcap C/src/bCAPServer/bcap_server.c).
"""

MAX_SESSIONS = 1024
"""Maximum number of remembered ended sessions. Beyond the limit, the oldest session is dropped."""

_HANDLE_TYPES = (VT.I4, VT.I2, VT.UI4)
# number of bytes in a VT_I4 argument before its value
_I4_HANDLE = b"\x0a\x00\x00\x00\x03\x00\x01\x00\x00\x00"


@dataclass(slots=True, eq=False)
class TrackedObject:
    """An object of the controller for which a client has, or had, a handle.

    Attributes:
        name: Name that the call gave when it opened the object, such as `Arm`; may be "".
        parent: Label of the object through which this object was opened; "" for a controller or if unknown.
        known_to_client: Whether the client received the handle. False if the reply was late, or if a repeated
            execution of the call created the object.
    """

    kind: ObjectClass
    handle: int
    name: str
    parent: str
    created_by_call: int
    known_to_client: bool

    @property
    def label(self) -> str:
        return self.name or f"{self.kind} {self.handle}"


class SessionEnding(StrEnum):
    STOPPED = "stopped"
    """The client ended the session properly, with Service_Stop."""
    RESTARTED = "restarted"
    """The client called Service_Start again from the same port, as a client does after a crash."""
    OPEN = "open"
    """No end was captured."""


@dataclass(frozen=True, slots=True)
class ServiceSession:
    """A client's session from Service_Start to Service_Stop.

    Attributes:
        started_by_call: Number of the Service_Start call; None if this call was not captured.
        unreleased: Objects that the client did not release: first the objects whose handles the client never
            received, then the other objects in creation order.
    """

    conversation: Conversation
    started_by_call: int | None
    ending: SessionEnding
    unreleased: tuple[TrackedObject, ...]

    @property
    def is_clean(self) -> bool:
        """Whether the client ended the session with Service_Stop and had released every object."""
        return self.ending is SessionEnding.STOPPED and not self.unreleased


class HandleTracker:
    """Tracks which object each handle means. A controller may use one handle for objects of two classes."""

    def __init__(self, max_ended: int = MAX_SESSIONS) -> None:
        """Remember only the latest `max_ended` ended sessions."""
        self._clients: dict[Conversation, _ClientObjects] = {}
        self._current_client: _ClientObjects | None = None
        self._ended_sessions: deque[ServiceSession] = deque(maxlen=max_ended)

    def on_call(self, call: Call) -> TrackedObject | None:
        """Process the next call, in starting order. Return the object of the call's handle, if known."""
        function = FUNCTIONS.get(call.kind.function_id)
        if function is None:
            return None
        client = self._current_client
        if client is None or client.conversation is not call.conversation:
            client = self._select_client(call.conversation)
        target = client.find(function.owner, handle_of(call.request.item))
        if function.creates is ObjectClass.SERVICE:
            if _succeeded(call):
                self._end_session(client, SessionEnding.RESTARTED)
                client.start_session(call.number)
        elif function.creates is not None:
            parent = "" if target is None else target.label
            client.add_created(call, function.creates, requested_name(call, function), parent)
        elif function.releases is not None and (_succeeded(call) or call.evicted):
            if function.releases is ObjectClass.SERVICE:
                self._ended_sessions.append(client.to_session(SessionEnding.STOPPED))
                client.start_session(None)
            elif target is not None:
                del client.objects[function.releases, target.handle]
        return target

    def sessions(self) -> tuple[ServiceSession, ...]:
        """Return the ended sessions in the order in which they ended, then the open sessions."""
        begun = [client for client in self._clients.values() if client.has_session]
        return (*self._ended_sessions, *(client.to_session(SessionEnding.OPEN) for client in begun))

    def close_conversation(self, conversation: Conversation) -> None:
        """Drop a client that has disconnected. If the client has not ended its session, add the session to
        the ended sessions, with the ending `OPEN`.
        """
        client = self._clients.pop(conversation, None)
        if client is not None:
            self._end_session(client, SessionEnding.OPEN)
        if client is self._current_client:
            self._current_client = None

    def _select_client(self, conversation: Conversation) -> _ClientObjects:
        client = self._clients.pop(conversation, None) or _ClientObjects(conversation)
        while len(self._clients) >= MAX_CONVERSATIONS:
            silent = self._clients.pop(next(iter(self._clients)))
            self._end_session(silent, SessionEnding.OPEN)
        self._clients[conversation] = self._current_client = client
        return client

    def _end_session(self, client: _ClientObjects, ending: SessionEnding) -> None:
        if client.has_session:
            self._ended_sessions.append(client.to_session(ending))


class _ClientObjects:
    def __init__(self, conversation: Conversation) -> None:
        self.conversation = conversation
        self.start_session(None)

    def start_session(self, call_number: int | None) -> None:
        self.started_by_call = call_number
        self.objects: dict[tuple[ObjectClass, int | None], TrackedObject] = {}
        self.orphans: deque[TrackedObject] = deque(maxlen=MAX_OBJECTS)

    @property
    def has_session(self) -> bool:
        return self.started_by_call is not None or bool(self.objects or self.orphans)

    def to_session(self, ending: SessionEnding) -> ServiceSession:
        left = (*self.orphans, *self.objects.values())
        return ServiceSession(self.conversation, self.started_by_call, ending, left)

    def find(self, kind: ObjectClass, handle: int | None) -> TrackedObject | None:
        thing = self.objects.get((kind, handle))
        if thing is None and self.orphans:
            thing = next((one for one in self.orphans if (one.kind, one.handle) == (kind, handle)), None)
            if thing is not None:  # the client uses the handle, so it received the reply with this handle
                self.orphans.remove(thing)
                thing.known_to_client = True
                self.objects[kind, handle] = thing
        return thing

    def add_created(self, call: Call, kind: ObjectClass, name: str, parent: str) -> None:
        accepted = handle_in_reply(call.reply)
        for handle in _handles_made(call):
            thing = TrackedObject(kind, handle, name, parent, call.number, handle == accepted)
            if thing.known_to_client:
                self.objects.pop((kind, handle), None)
                self.objects[kind, handle] = thing
            else:
                self.orphans.append(thing)
        if len(self.objects) > MAX_OBJECTS:
            del self.objects[next(iter(self.objects))]


def handle_of(request: Frame) -> int | None:
    """Return the handle in the first argument of a request; None if this argument is no integer."""
    raw = request.raw
    # 60 times as fast as `_first_number`. No zlib stream of a compressed frame has these bytes at this place.
    if raw.startswith(_I4_HANDLE, 15) and len(raw) > 29:
        return int.from_bytes(raw[25:29], "little", signed=True)
    return _first_number(request)


def _first_number(frame: Frame) -> int | None:
    vt, value, _ = frame.arguments[0].variant if frame.arguments else EMPTY
    return value if isinstance(value, int) and vt in _HANDLE_TYPES else None


def requested_name(call: Call, function: Function) -> str:
    index = next((index for index, param in enumerate(function.params) if param.name == "bstrName"), None)
    arguments = call.request.item.arguments
    if index is None or index >= len(arguments):
        return ""
    value = arguments[index].variant.value
    return shortened(value, LONGEST_NAME) if isinstance(value, str) else ""


def handle_in_reply(reply: FrameObservation | None) -> int | None:
    """Return the handle in a reply to a function that creates an object; None if there is none."""
    if reply is None or not is_success(reply.item.code):
        return None
    return _first_number(reply.item)


def _handles_made(call: Call) -> list[int]:
    """Return all handles that the attempts of a call created, even if the client did not receive them."""
    replies = (*call.lost_replies, *call.late_replies, call.reply)
    given = [handle for reply in replies if (handle := handle_in_reply(reply)) is not None]
    accepted = handle_in_reply(call.reply)
    skipped = [] if accepted is None else range(accepted - call.skipped_handles, accepted)
    return sorted({*given, *skipped})


def _succeeded(call: Call) -> bool:
    replies = (call.reply, *call.late_replies, *call.lost_replies)
    if call.reply_not_captured:
        return True
    return any(reply is not None and is_success(reply.item.code) for reply in replies)
