"""What a client has done so far: the knowledge that tells why a later call was refused."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterator
from typing import NamedTuple, TypeAlias, TypeVar

from bcapscope.analysis.slave.generation_clues import NO_CLUE, clue_of_call, stronger_clue
from bcapscope.protocol.codec.variant import Value, Variant, integer_value
from bcapscope.protocol.slave_mode.modes import Generation, SlaveMode, slave_mode_by_number
from bcapscope.protocol.tables.function_table import FUNCTIONS, ID, ObjectClass
from bcapscope.protocol.tables.hresult import ends_slave_mode, is_failure
from bcapscope.traffic.call import Call
from bcapscope.traffic.call_kind import MAX_CONVERSATIONS, CallKind
from bcapscope.traffic.handle_tracker import TrackedObject
from bcapscope.traffic.observation import ConnectionEnd, Conversation, Direction

MAX_HANDLES = 1024
"""Handles of a client that are remembered; the official server gives it 1000 (orin_bcap
C/src/bCAPServer/bcap_server.c)."""

MAX_CLOSED_CLIENTS = 32
"""Clients that are known to have gone and are remembered, as they may have left something behind."""

SLOW_CALL_NS = 50_000_000
"""A call that takes longer than this, in nanoseconds, may still run when the next one is sent."""

_LARGEST_POINT = 8192  # bytes of request, retries and reply; real ones have some hundred each
RECENT_SET_POINTS = 64
"""Set points looked at when one was refused: half a second at 8 ms."""

EXECUTES = frozenset(
    (ID["Controller_Execute"], ID["Robot_Execute"], ID["Task_Execute"], ID["Extension_Execute"])
)

_READS_ERROR = frozenset(
    ("getcurerrorcount", "getcurerrorinfo", "geterrordescription", "geterrorlog", "geterrorlogcount")
)
_MOTIONS = frozenset(("approach", "depart", "driveex", "driveaex"))


def argument(call: Call, index: int) -> Variant | None:
    """Return an argument of the request; None where it has none there."""
    arguments = call.request.item.arguments
    return arguments[index].variant if index < len(arguments) else None


def text_argument(call: Call, index: int) -> str:
    """Return a string among the arguments; empty where there is none."""
    variant = argument(call, index)
    return variant.value if variant is not None and isinstance(variant.value, str) else ""


def result_of(call: Call) -> Value:
    """Return what a successful reply carries; None for nothing."""
    if call.reply is None or is_failure(call.reply.item.code) or not call.reply.item.arguments:
        return None
    return call.reply.item.arguments[0].variant.value


def folded_command(call_kind: CallKind) -> str:
    """Return the command without regard to case; empty for functions that take none."""
    return (call_kind.command or "").casefold()


def first_number(variant: Variant | None) -> int | None:
    """Read a number, the first of an array, or a number written as text, as clients send states."""
    value = variant.value if variant is not None else None
    if isinstance(value, tuple):
        first = value[0] if value else None
        value = first.value if isinstance(first, Variant) else first
    if isinstance(value, str):
        return int(value) if value.isascii() and value.isdecimal() and len(value) <= 9 else None
    return int(value) if isinstance(value, int) and not isinstance(value, bool) else None


def gets_robslave(call: Call) -> bool:
    """Tell whether a call asks for the task RobSlave, which the slave mode of an RC7 needs."""
    return call.kind.function_id == ID["Controller_GetTask"] and _is_robslave_name(text_argument(call, 1))


def _is_robslave_name(name: str) -> bool:
    return name.casefold().removesuffix(".pac") == "robslave"


class OpenedObject(NamedTuple):
    """An object that was given to a client.

    Attributes:
        object_class: its class.
        name: that was asked for.
        opened_by: that opened it.
    """

    object_class: ObjectClass
    name: str
    opened_by: Call


class ClientState:
    """One conversation as its calls tell it.

    Attributes:
        conversation: between whom.
        first_call: its first call that was seen.
        last_call: its latest call.
        call_count: how many.
        answered_count: how many of them had a reply.
        longest_pause_ns: nanoseconds between two of them; not of what set points are apart.
        service_start: the accepted Service_Start of this session.
        connect_call: the accepted Controller_Connect.
        session_end: the accepted Service_Stop or Controller_Disconnect since.
        motor_call: the latest accepted Motor.
        motor_on: what it switched to; None where not seen.
        take_arm_call: the accepted TakeArm, until GiveArm.
        robslave_start: the latest accepted start of the task RobSlave.
        robslave_not_found: the first refused Controller_GetTask for the task RobSlave.
        last_motion: the latest accepted motion command outside slave mode.
        mode_value: slave mode, 0 for off; None where nothing told.
        mode_entered_by: the slvChangeMode that entered `mode_value`.
        mode_ended_by: the call that ended slave mode last.
        uncleared_error: the first error of the controller that was not cleared since.
        error_was_read: the client asked for error details since `uncleared_error`.
        type_was_read: the type of the robot was asked for.
        slow_call: the latest call that was not answered, or only after a while; not one that was let go.
        may_be_answered: a reply was seen that belongs to no call, and may belong to one of its calls that
            were let go.
        opened_objects: what each handle was given for last.
        released_by: the calls that released handles lately, by class and handle.
        target_object: what the handle of the call at hand stands for; None where that is not known.
        recent_set_points: the latest set points of this stay.
        known_present: it is known to be still there, however long it has been silent.
        generation_clue: to the controller's generation.
    """

    def __init__(self, first: Call) -> None:
        self.conversation: Conversation = first.conversation
        self.first_call = self.last_call = first
        self.call_count = self.answered_count = self.longest_pause_ns = 0
        self.service_start: Call | None = None
        self.connect_call: Call | None = None
        self.session_end: Call | None = None
        self.motor_call: Call | None = None
        self.motor_on: bool | None = None
        self.take_arm_call: Call | None = None
        self.robslave_start: Call | None = None
        self.robslave_not_found: Call | None = None
        self.last_motion: Call | None = None
        self.mode_value: int | None = None
        self.mode_entered_by: Call | None = None
        self.mode_ended_by: Call | None = None
        self.uncleared_error: Call | None = None
        self.error_was_read = False
        self.type_was_read = self.may_be_answered = self.known_present = False
        self.slow_call: Call | None = None
        self.opened_objects: dict[int, OpenedObject] = {}
        self.released_by: dict[tuple[ObjectClass, int], Call] = {}
        self.target_object: TrackedObject | None = None
        self.recent_set_points: deque[Call] = deque(maxlen=RECENT_SET_POINTS)
        self.generation_clue = NO_CLUE

    @property
    def has_open_session(self) -> bool:
        """Whether it opened something that it has not closed."""
        return (self.service_start is not None or self.connect_call is not None) and self.session_end is None

    @property
    def controller_closing(self) -> ConnectionEnd | None:
        """How the controller ended its connection; None where it did not, or the client did first."""
        closing = self.conversation.connection_end
        return closing if closing is not None and closing.by is Direction.RESPONSE else None

    @property
    def session_start_seen(self) -> bool:
        """Whether its service session began in this capture."""
        return self.service_start is not None

    @property
    def generation(self) -> Generation | None:
        """The controller's generation, as far as what was said tells it."""
        asked = self.robslave_start is not None or self.robslave_not_found is not None
        return Generation.RC7 if asked else self.generation_clue.generation

    @property
    def slave_mode(self) -> SlaveMode | None:
        """The slave mode that it has entered, by the controller's generation; None while it is off."""
        return (
            slave_mode_by_number(self.mode_value, self.generation or Generation.RC8)
            if self.mode_value
            else None
        )

    def on_set_point(self, call: Call) -> None:
        """Take a set point into account that was answered with S_OK."""
        reply = call.reply
        if reply is not None and reply.time - call.request.time > SLOW_CALL_NS:
            self.slow_call = call
        self.call_count += 1
        self.answered_count += 1
        self.last_call = call
        self._remember_set_point(call)

    def _remember_set_point(self, call: Call) -> None:
        if call.memory_bytes <= _LARGEST_POINT:
            self.recent_set_points.append(call)

    def on_call(self, call: Call) -> None:
        """Take a settled call into account, the one that `target_object` is about."""
        self.call_count += 1
        self.longest_pause_ns = max(self.longest_pause_ns, call.request.time - self.last_call.last_activity)
        self.last_call = call
        reply = call.reply
        slow = not call.evicted if reply is None else reply.time - call.request.time > SLOW_CALL_NS
        if slow:
            self.slow_call = call
        is_point = folded_command(call.kind) == "slvmove"
        if reply is None:
            if is_point and self.mode_value:
                self._remember_set_point(call)
            return
        self.answered_count += 1
        code = reply.item.code
        if is_failure(code):
            self._on_failure(call, code)
        elif is_point:
            self._remember_set_point(call)
        else:
            self._on_success(call)

    def _on_success(self, call: Call) -> None:
        function_id, command = call.kind
        if command is not None:
            teach = _BY_COMMAND.get(command.casefold()) if function_id in EXECUTES else None
        else:
            teach = _BY_FUNCTION.get(function_id)
            self._follow_handles(call)
        if teach is not None:
            teach(self, call)

    def _follow_handles(self, call: Call) -> None:
        function = FUNCTIONS.get(call.kind.function_id)
        if function is None or (function.creates is None and function.releases is None):
            return
        handle, thing = result_of(call), self.target_object
        if function.creates is not None and isinstance(handle, int):
            _put_bounded(
                self.opened_objects, handle, OpenedObject(function.creates, _requested_name(call), call)
            )
            self.released_by.pop((function.creates, handle), None)
        elif function.releases is not None and thing is not None:
            _put_bounded(self.released_by, (thing.kind, thing.handle), call)

    def _on_failure(self, call: Call, code: int) -> None:
        if self.robslave_not_found is None and gets_robslave(call):
            self.robslave_not_found = call
        if not ends_slave_mode(code):
            return
        if self.uncleared_error is None:
            self.uncleared_error, self.error_was_read = call, False
        if self.mode_value != 0:
            self.mode_value, self.mode_ended_by = 0, call
        self.recent_set_points.clear()

    def _on_service_start(self, call: Call) -> None:
        self._reset_session()
        self.service_start = call

    def _on_session_end(self, call: Call) -> None:
        self._reset_session()
        self.session_end = call

    def _reset_session(self) -> None:
        self.service_start = self.connect_call = self.session_end = self.take_arm_call = None
        self.mode_value = 0

    def _on_connect(self, call: Call) -> None:
        self.connect_call, self.session_end = call, None
        self.generation_clue = stronger_clue(self.generation_clue, clue_of_call(call))

    def _on_start_task(self, call: Call) -> None:
        thing = self.target_object
        if thing is not None and _is_robslave_name(thing.name):
            self.robslave_start = call

    def _on_get_value(self, call: Call) -> None:
        name = "" if self.target_object is None else self.target_object.name.casefold()
        self.error_was_read = self.error_was_read or name in ("@error_code", "@error_description")
        self.type_was_read = self.type_was_read or name in ("@type", "@type_name")

    def _on_motion(self, call: Call) -> None:
        self.last_motion = call

    def _on_change_mode(self, call: Call) -> None:
        parameter = argument(call, 2)
        value = None if parameter is None else integer_value(parameter)
        if value:
            self.mode_entered_by = call
            self.generation_clue = stronger_clue(self.generation_clue, clue_of_call(call))
        elif self.mode_value:
            self.mode_ended_by = call
        self.mode_value = value
        self.recent_set_points.clear()

    def _on_motor(self, call: Call) -> None:
        state = first_number(argument(call, 2))
        self.motor_call, self.motor_on = call, None if state is None else bool(state)

    def _on_take_arm(self, call: Call) -> None:
        self.take_arm_call = call
        self.generation_clue = stronger_clue(self.generation_clue, clue_of_call(call))

    def _on_give_arm(self, call: Call) -> None:
        self.take_arm_call = None

    def _on_clear_error(self, call: Call) -> None:
        self.uncleared_error, self.error_was_read = None, False

    def _on_read_error(self, call: Call) -> None:
        self.error_was_read = True

    def _on_read_type(self, call: Call) -> None:
        self.type_was_read = True

    def _on_put_auto_mode(self, call: Call) -> None:
        self.generation_clue = stronger_clue(self.generation_clue, clue_of_call(call))


_StateUpdate: TypeAlias = Callable[[ClientState, Call], None]

_BY_FUNCTION: dict[int, _StateUpdate] = {
    ID["Service_Start"]: ClientState._on_service_start,
    ID["Service_Stop"]: ClientState._on_session_end,
    ID["Controller_Connect"]: ClientState._on_connect,
    ID["Controller_Disconnect"]: ClientState._on_session_end,
    ID["Task_Start"]: ClientState._on_start_task,
    ID["Variable_GetValue"]: ClientState._on_get_value,
    ID["Robot_Move"]: ClientState._on_motion,
    ID["Robot_Drive"]: ClientState._on_motion,
    ID["Robot_GoHome"]: ClientState._on_motion,
    ID["Robot_Rotate"]: ClientState._on_motion,
}

_BY_COMMAND: dict[str, _StateUpdate] = {
    **dict.fromkeys(_READS_ERROR, ClientState._on_read_error),
    **dict.fromkeys(_MOTIONS, ClientState._on_motion),
    "slvchangemode": ClientState._on_change_mode,
    "motor": ClientState._on_motor,
    "takearm": ClientState._on_take_arm,
    "givearm": ClientState._on_give_arm,
    "clearerror": ClientState._on_clear_error,
    "getrobottypename": ClientState._on_read_type,
    "putautomode": ClientState._on_put_auto_mode,
}


_Key = TypeVar("_Key")
_Value = TypeVar("_Value")


def _put_bounded(table: dict[_Key, _Value], key: _Key, value: _Value) -> None:
    if len(table) >= MAX_HANDLES:
        del table[next(iter(table))]
    table[key] = value


def _requested_name(call: Call) -> str:
    return text_argument(call, 0 if call.kind.function_id == ID["Controller_Connect"] else 1)


class ClientRegistry:
    """All clients that were seen lately, by conversation."""

    def __init__(self, on_drop: Callable[[ClientState], None]) -> None:
        """Tell `on_drop` about each client that is dropped to bound the memory."""
        self._on_drop = on_drop
        self._by_conversation: dict[Conversation, ClientState] = {}
        self._closed: deque[Conversation] = deque()
        self.clients_seen = 0

    def __iter__(self) -> Iterator[ClientState]:
        return iter(self._by_conversation.values())

    def client_of(self, call: Call) -> ClientState:
        """Return the client of a call, new if this is its first."""
        client = self._by_conversation.get(call.conversation)
        if client is None:
            self.clients_seen += 1
            if len(self._by_conversation) >= MAX_CONVERSATIONS:
                silent = min(self._by_conversation.values(), key=lambda each: each.last_call.last_activity)
                del self._by_conversation[silent.conversation]
                self._on_drop(silent)
            client = self._by_conversation[call.conversation] = ClientState(call)
        return client

    def on_conversation_closed(self, conversation: Conversation) -> None:
        """Take notice that a client is gone for good; the latest few are remembered, for the others' sake."""
        client = self._by_conversation.get(conversation)
        if client is None:
            return
        client.recent_set_points.clear()
        self._closed.append(conversation)
        if len(self._closed) > MAX_CLOSED_CLIENTS:
            forgotten = self._by_conversation.pop(self._closed.popleft(), None)
            if forgotten is not None:
                self._on_drop(forgotten)

    def find(self, conversation: Conversation) -> ClientState | None:
        """Return a client that has called; None for one that has not, or is forgotten."""
        return self._by_conversation.get(conversation)

    def other_clients(self, client: ClientState) -> list[ClientState]:
        """Return the other clients of the same controller."""
        host = client.conversation.server.host
        return [each for each in self if each is not client and each.conversation.server.host == host]
