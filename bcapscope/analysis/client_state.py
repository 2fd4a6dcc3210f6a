"""State of each client, deduced from its calls. This state can explain why the controller refuses a call."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterator, Sequence
from typing import NamedTuple

from bcapscope.analysis.call_arguments import (
    gets_robslave,
    is_robslave_name,
    requested_motor_state,
    result_of,
)
from bcapscope.analysis.slave.generation_clues import NO_CLUE, clue_of_call, stronger_clue
from bcapscope.analysis.slave.slave_session import SlaveSession
from bcapscope.protocol.slave_mode.modes import Generation, SlaveMode, slave_mode_by_number
from bcapscope.protocol.tables.function_table import FUNCTIONS, ID, ObjectClass
from bcapscope.protocol.tables.hresult import ends_slave_mode, is_failure
from bcapscope.protocol.tables.variables import SERVO_ON
from bcapscope.traffic.call import Call
from bcapscope.traffic.call_kind import MAX_CONVERSATIONS
from bcapscope.traffic.handle_tracker import TrackedObject, requested_name
from bcapscope.traffic.observation import ConnectionEnd, Conversation, Direction, Transport
from bcapscope.traffic.slave_mode_tracker import SlaveModeChange, SlaveModeEffect

MAX_HANDLES = 1024
"""Maximum number of handles per client. DENSO's C server (bcap_server.c) gives a client at most 1000 handles.
"""

MAX_CLOSED_CLIENTS = 32
"""Maximum number of remembered clients whose conversation has ended. Their slave mode may still be on."""

SLOW_CALL_NS = 50_000_000
"""A call that takes longer than this time (ns) may still be executed during the client's next call."""

# Maximum size in bytes of a set point in `recent_set_points`. A real set point has a few hundred bytes.
_LARGEST_POINT = 8192
# Maximum size in bytes of a call in `latest_calls` or `failed_openings`.
_LARGEST_ATTEMPT = 65_536
RECENT_SET_POINTS = 64

EXECUTES = frozenset(
    (ID["Controller_Execute"], ID["Robot_Execute"], ID["Task_Execute"], ID["Extension_Execute"])
)

_READS_ERROR = frozenset(
    ("getcurerrorcount", "getcurerrorinfo", "geterrordescription", "geterrorlog", "geterrorlogcount")
)

_ERROR_VARIABLES = frozenset(("@error_code", "@error_description"))
_READS_TYPE = frozenset(("@type", "@type_name"))
_ENDS_SESSION = frozenset((ID["Service_Stop"], ID["Controller_Disconnect"]))
_FOLLOWED_COMMANDS = frozenset(("takearm", "givearm", "motor", "clearerror", "slvchangemode"))

MOTION_FUNCTIONS = frozenset(ID[f"Robot_{name}"] for name in ("Drive", "GoHome", "Move", "Rotate"))
MOTION_COMMANDS = frozenset(("approach", "depart", "driveaex", "driveex"))
"""Names, in lower case, of commands that move the robot outside slave mode."""


class OpenedObject(NamedTuple):
    object_class: ObjectClass
    name: str


class ClientState:
    """State of one client, deduced from its completed calls.

    Attributes:
        longest_pause_ns: Longest pause in ns before a call; pauses in a series of set points do not count.
        service_start: The Service_Start call of the current session; None if this call was not captured.
        failed_start: Service_Start call that the controller refused, or probably ignored because of serial 0;
            None while a session is open.
        session_end: The Service_Stop or Controller_Disconnect call that ended, or may have ended, the
            session; None while the session is open.
        latest_calls: Latest call of this session, successful or not, for each `equivalent_command` in
            `_FOLLOWED_COMMANDS` and for `robslave`.
        failed_openings: For each class of objects, the latest call of this session that should have opened an
            object, but got no successful reply; no entry after a later call opened an object of this class.
        give_arm_call: The GiveArm call that gave back the arm; None if the client holds the arm.
        robslave_not_found: The first refused Controller_GetTask call for the task RobSlave.
        mode_value: Number of the slave mode, as in slvChangeMode; 0 while slave mode is off, None if unknown.
        uncleared_error: The first call that reported a controller error after the client last cleared errors.
        latest_error: The latest call that reported a controller error, even if the error was cleared.
        error_was_read: Whether the client has read the details of an error after the call `uncleared_error`.
        slow_call: Latest call, not evicted, that got no reply or took longer than `SLOW_CALL_NS`.
        may_be_answered: Whether a captured stray reply may answer one of the client's evicted calls.
        opened_objects: For each handle, the object for which the controller last gave this handle.
        released_by: The latest call that released each handle.
        target_object: Object to which the handle of the current call refers; None if unknown.
        recent_set_points: Latest set points of the current slave-mode session.
        silent_session: Latest slave-mode session that ended because the client stopped sending set points.
    """

    def __init__(self, first: Call, registry: ClientRegistry) -> None:
        self._registry = registry
        self.conversation: Conversation = first.conversation
        self.first_call = self.last_call = first
        self.call_count = self.answered_count = self.longest_pause_ns = 0
        self.service_start: Call | None = None
        self.failed_start: Call | None = None
        self.connect_call: Call | None = None
        self.session_end: Call | None = None
        self.motor_call: Call | None = None
        self.motor_on: bool | None = None
        self.latest_calls: dict[str, Call] = {}
        self.failed_openings: dict[ObjectClass, Call] = {}
        self.take_arm_call: Call | None = None
        self.give_arm_call: Call | None = None
        self.robslave_start: Call | None = None
        self.robslave_not_found: Call | None = None
        self.last_motion: Call | None = None
        self.mode_value: int | None = None
        self.mode_entered_by: Call | None = None
        self.mode_ended_by: Call | None = None
        self.uncleared_error: Call | None = None
        self.latest_error: Call | None = None
        self.clear_call: Call | None = None
        self.error_was_read = False
        self.type_was_read = self.may_be_answered = False
        self.slow_call: Call | None = None
        self.opened_objects: dict[int, OpenedObject] = {}
        self.released_by: dict[tuple[ObjectClass, int], Call] = {}
        self.target_object: TrackedObject | None = None
        self.recent_set_points: deque[Call] = deque(maxlen=RECENT_SET_POINTS)
        self.silent_session: SlaveSession | None = None
        self.generation_clue = NO_CLUE

    @property
    def has_open_session(self) -> bool:
        return (self.service_start is not None or self.connect_call is not None) and self.session_end is None

    @property
    def controller_closing(self) -> ConnectionEnd | None:
        """How the controller closed the connection; None if it is open, or if the client closed it first."""
        leg = self.conversation.controller_leg or self.conversation
        closing = leg.connection_end
        return closing if closing is not None and closing.by is Direction.RESPONSE else None

    @property
    def session_start_seen(self) -> bool:
        return self.service_start is not None

    @property
    def generation(self) -> Generation | None:
        uses_robslave = self.robslave_start is not None or self.robslave_not_found is not None
        return Generation.RC7 if uses_robslave else self.generation_clue.generation

    @property
    def slave_mode(self) -> SlaveMode | None:
        """Slave mode; None if slave mode is off or unknown. An unknown generation counts as RC8."""
        generation = self.generation or Generation.RC8
        return slave_mode_by_number(self.mode_value, generation) if self.mode_value else None

    def other_clients(self) -> list[ClientState]:
        host = self.conversation.server.host
        return [each for each in self._registry if each is not self and each.conversation.server.host == host]

    def cleared_by_other(self, error: Call, before: int) -> bool:
        """Return whether another client called ClearError in the time from the call `error` to `before` (ns
        since 1970). Only the latest ClearError of each client is known.
        """
        clears = (other.clear_call for other in self.other_clients())
        times = (clear.request.time for clear in clears if clear is not None)
        return any(error.request.time <= time <= before for time in times)

    def on_set_points(self, calls: Sequence[Call]) -> None:
        for call in calls:
            if call.last_activity - call.request.time > SLOW_CALL_NS:
                self.slow_call = call
        self.call_count += len(calls)
        self.answered_count += len(calls)
        self.last_call = calls[-1]
        self.recent_set_points.extend(calls)

    def _remember_set_point(self, call: Call) -> None:
        if call.memory_bytes <= _LARGEST_POINT:
            self.recent_set_points.append(call)

    def on_call(self, call: Call) -> None:
        """Update the state with a completed call. `target_object` must be the object of this call."""
        self.call_count += 1
        self.longest_pause_ns = max(self.longest_pause_ns, call.request.time - self.last_call.last_activity)
        self.last_call = call
        reply = call.reply
        unanswered = not (call.evicted or call.reply_not_captured)
        slow = unanswered if reply is None else reply.time - call.request.time > SLOW_CALL_NS
        if slow:
            self.slow_call = call
        command = self.equivalent_command(call)
        self._follow_attempt(call, command)
        is_point = call.kind.folded_command == "slvmove"
        if reply is None:
            if is_point and self.mode_value:
                self._remember_set_point(call)
            elif call.reply_not_captured:
                self._on_success(call, command)  # the reply that was not captured may have reported success
            return
        self.answered_count += 1
        code = reply.item.code
        if is_failure(code):
            self._on_failure(call, code)
        elif is_point:
            self._remember_set_point(call)
        else:
            self._on_success(call, command)

    def _follow_attempt(self, call: Call, command: str) -> None:
        """Record that the client made this call, so that no rule says that the call is missing."""
        function_id = call.kind.function_id
        is_small = call.memory_bytes <= _LARGEST_ATTEMPT
        if is_small and (command in _FOLLOWED_COMMANDS or command == "robslave"):
            self.latest_calls[command] = call
        elif command == "getrobottypename" or self._variable_read(call) in _READS_TYPE:
            self.type_was_read = True
        if call.reply is None and function_id in _ENDS_SESSION:
            self.session_end = call
        function = FUNCTIONS.get(function_id)
        creates = None if function is None else function.creates
        if is_small and creates is not None and not _may_have_succeeded(call):
            self.failed_openings[creates] = call

    def equivalent_command(self, call: Call) -> str:
        """Return the command of a call in lower case; "" if there is none. A write to @SERVO_ON counts as the
        command `motor`, and a Task_Start of RobSlave as the command `robslave`.
        """
        function_id, command = call.kind
        if command is not None:
            return call.kind.folded_command if function_id in EXECUTES else ""
        name = "" if self.target_object is None else self.target_object.name
        if function_id == ID["Task_Start"]:
            return "robslave" if is_robslave_name(name) else ""
        switches_motor = function_id == ID["Variable_PutValue"] and name.casefold() == SERVO_ON.casefold()
        return "motor" if switches_motor else ""

    def _variable_read(self, call: Call) -> str:
        if call.kind.function_id != ID["Variable_GetValue"] or self.target_object is None:
            return ""
        return self.target_object.name.casefold()

    def on_slave_mode(self, change: SlaveModeChange) -> None:
        """Update the slave mode, after `on_call` has received the call that changed it."""
        call = change.call
        if change.effect is SlaveModeEffect.MODE_CHANGED:
            self.recent_set_points.clear()
            if change.mode:
                self.mode_entered_by = call
                self._learn_generation(call)
            elif self.mode_value:
                self.mode_ended_by = call
        elif change.effect is not SlaveModeEffect.SESSION_BOUNDARY:
            self.mode_ended_by = call
        self.mode_value = change.mode

    def _on_success(self, call: Call, command: str) -> None:
        function_id = call.kind.function_id
        if call.kind.command is None:
            self._follow_handles(call)
        if function_id == ID["Variable_GetValue"]:
            self.error_was_read = self.error_was_read or self._variable_read(call) in _ERROR_VARIABLES
        elif function_id == ID["Task_Start"]:
            self.robslave_start = call if command == "robslave" else self.robslave_start
        elif function_id == ID["Service_Start"]:
            self._on_service_start(call)
        elif function_id in _ENDS_SESSION:
            self._reset_session()
            self.session_end = call
        elif function_id == ID["Controller_Connect"]:
            self.connect_call, self.session_end, self.failed_start = call, None, None
            self._learn_generation(call)
        elif function_id in MOTION_FUNCTIONS or command in MOTION_COMMANDS:
            self.last_motion = call
        else:
            self._on_preparation(call, command)

    def _on_service_start(self, call: Call) -> None:
        self._reset_session()
        self.service_start = call
        is_udp = call.conversation.transport is Transport.UDP
        if is_udp and self.call_count == 1 and call.request.item.serial == 0:
            self.failed_start = call

    def _on_preparation(self, call: Call, command: str) -> None:
        if command == "motor":
            self.motor_call, self.motor_on = call, requested_motor_state(call)
        elif command == "takearm":
            self.take_arm_call, self.give_arm_call = call, None
            self._learn_generation(call)
        elif command == "givearm":
            self.take_arm_call, self.give_arm_call = None, call
        elif command == "putautomode":
            self._learn_generation(call)
        elif command == "clearerror":
            self.clear_call = call
            self.uncleared_error, self.error_was_read = None, False
        elif command in _READS_ERROR:
            self.error_was_read = True

    def _follow_handles(self, call: Call) -> None:
        function = FUNCTIONS.get(call.kind.function_id)
        if function is None or (function.creates is None and function.releases is None):
            return
        handle, target = result_of(call), self.target_object
        if function.creates is not None and isinstance(handle, int):
            opened = OpenedObject(function.creates, requested_name(call, function))
            if len(self.opened_objects) >= MAX_HANDLES:
                del self.opened_objects[next(iter(self.opened_objects))]
            self.opened_objects[handle] = opened
            self.released_by.pop((function.creates, handle), None)
            self.failed_openings.pop(function.creates, None)
        elif function.releases is not None and target is not None:
            if len(self.released_by) >= MAX_HANDLES:
                del self.released_by[next(iter(self.released_by))]
            self.released_by[target.kind, target.handle] = call

    def _on_failure(self, call: Call, code: int) -> None:
        if self.robslave_not_found is None and gets_robslave(call):
            self.robslave_not_found = call
        if call.kind.function_id == ID["Service_Start"]:
            self.failed_start = call
        if not ends_slave_mode(code):
            return
        self.latest_error = call
        if self.uncleared_error is None:
            self.uncleared_error, self.error_was_read = call, False
        self.recent_set_points.clear()

    def _reset_session(self) -> None:
        self.service_start = self.connect_call = self.session_end = self.failed_start = None
        self.take_arm_call = self.give_arm_call = None
        self.latest_calls.clear()
        self.failed_openings.clear()

    def _learn_generation(self, call: Call) -> None:
        self.generation_clue = stronger_clue(self.generation_clue, clue_of_call(call))


def _may_have_succeeded(call: Call) -> bool:
    return call.evicted if call.reply is None else not is_failure(call.reply.item.code)


class ClientRegistry:
    """Holds the `ClientState` of each remembered client."""

    def __init__(self, on_drop: Callable[[ClientState], None]) -> None:
        """Create an empty registry. `on_drop` receives each client that is dropped when memory is full."""
        self._on_drop = on_drop
        self._by_conversation: dict[Conversation, ClientState] = {}
        self._closed: deque[Conversation] = deque()
        self.clients_seen = 0

    def __iter__(self) -> Iterator[ClientState]:
        return iter(self._by_conversation.values())

    def client_of(self, call: Call) -> ClientState:
        client = self._by_conversation.get(call.conversation)
        if client is None:
            self.clients_seen += 1
            if len(self._by_conversation) >= MAX_CONVERSATIONS:
                silent = min(self._by_conversation.values(), key=lambda each: each.last_call.last_activity)
                del self._by_conversation[silent.conversation]
                self._on_drop(silent)
            client = self._by_conversation[call.conversation] = ClientState(call, self)
        return client

    def on_conversation_closed(self, conversation: Conversation) -> None:
        """Keep the state of the conversation's client, because this state can explain failures of other
        clients. If more than `MAX_CLOSED_CLIENTS` states of closed conversations are kept, drop the oldest
        one.
        """
        client = self._by_conversation.get(conversation)
        if client is None:
            return
        client.recent_set_points.clear()
        self._closed.append(conversation)
        if len(self._closed) > MAX_CLOSED_CLIENTS:
            dropped = self._by_conversation.pop(self._closed.popleft(), None)
            if dropped is not None:
                self._on_drop(dropped)

    def find(self, conversation: Conversation) -> ClientState | None:
        return self._by_conversation.get(conversation)
