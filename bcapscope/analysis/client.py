"""What a client has done so far: the knowledge that tells why a later call was refused."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterator
from typing import NamedTuple, TypeAlias, TypeVar

from bcapscope.analysis.generation import NO_CLUE, better, clue_of_call
from bcapscope.protocol.functions import FUNCTIONS, ID, ObjectClass
from bcapscope.protocol.hresult import ends_slave_mode, is_failure
from bcapscope.protocol.slavemode import Generation, SlaveMode, mode_value, slave_mode
from bcapscope.protocol.variant import Value, Variant
from bcapscope.traffic.exchange import Exchange
from bcapscope.traffic.handles import Thing
from bcapscope.traffic.observation import Closing, Conversation, Direction
from bcapscope.traffic.question import MOST_CONVERSATIONS, Question

MOST_HANDLES = 1024
"""Handles of a client that are remembered; the official server gives it 1000 (orin_bcap
C/src/bCAPServer/bcap_server.c)."""

MOST_DEPARTED = 32
"""Clients that are known to have gone and are remembered, as they may have left something behind."""

A_WHILE = 50_000_000
"""A call that takes longer than this, in nanoseconds, may still run when the next one is sent."""

RECENT_POINTS = 64
"""Set points looked at when one was refused: half a second at 8 ms."""

EXECUTES = frozenset(
    (ID["Controller_Execute"], ID["Robot_Execute"], ID["Task_Execute"], ID["Extension_Execute"])
)

_READS_ERROR = frozenset(
    ("getcurerrorcount", "getcurerrorinfo", "geterrordescription", "geterrorlog", "geterrorlogcount")
)
_MOTIONS = frozenset(("approach", "depart", "driveex", "driveaex"))


def argument(call: Exchange, index: int) -> Variant | None:
    """Return an argument of the request; None where it has none there."""
    arguments = call.request.item.arguments
    return arguments[index].variant if index < len(arguments) else None


def text_argument(call: Exchange, index: int) -> str:
    """Return a string among the arguments; empty where there is none."""
    variant = argument(call, index)
    return variant.value if variant is not None and isinstance(variant.value, str) else ""


def result_of(call: Exchange) -> Value:
    """Return what a successful reply carries; None for nothing."""
    if call.reply is None or is_failure(call.reply.item.code) or not call.reply.item.arguments:
        return None
    return call.reply.item.arguments[0].variant.value


def command_of(question: Question) -> str:
    """Return the command without regard to case; empty for functions that take none."""
    return (question.command or "").casefold()


def first_number(variant: Variant | None) -> int | None:
    """Read a number, the first of an array, or a number written as text, as clients send states."""
    value = variant.value if variant is not None else None
    if isinstance(value, tuple):
        first = value[0] if value else None
        value = first.value if isinstance(first, Variant) else first
    if isinstance(value, str):
        return int(value) if value.isascii() and value.isdecimal() and len(value) <= 9 else None
    return int(value) if isinstance(value, int) and not isinstance(value, bool) else None


def gets_robslave(call: Exchange) -> bool:
    """Tell whether a call asks for the task RobSlave, which the slave mode of an RC7 needs."""
    return call.question.function_id == ID["Controller_GetTask"] and _is_robslave(text_argument(call, 1))


def _is_robslave(name: str) -> bool:
    return name.casefold().removesuffix(".pac") == "robslave"


class Opened(NamedTuple):
    """An object that was given to a client.

    Attributes:
        kind: its class.
        name: that was asked for.
        call: that opened it.
    """

    kind: ObjectClass
    name: str
    call: Exchange


class Client:
    """One conversation as its calls tell it.

    Attributes:
        conversation: between whom.
        first: its first call that was seen.
        last: its latest call.
        calls: how many.
        answered: how many of them had a reply.
        longest_pause: nanoseconds between two of them; not of what set points are apart.
        service: the accepted Service_Start of this session.
        connected: the accepted Controller_Connect.
        closed: the accepted Service_Stop or Controller_Disconnect since.
        motor: the latest accepted Motor.
        motor_on: what it switched to; None where not seen.
        arm: the accepted TakeArm, until GiveArm.
        robslave: the latest accepted start of the task RobSlave.
        robslave_missing: the first refused Controller_GetTask for the task RobSlave.
        motion: the latest accepted motion command outside slave mode.
        mode: slave mode, 0 for off; None where nothing told.
        mode_call: the slvChangeMode that entered `mode`.
        mode_end: the call that ended slave mode last.
        failure: the first error of the controller that was not cleared since.
        error_read: the client asked for error details since `failure`.
        type_read: the type of the robot was asked for.
        unanswered: the latest call that was not answered, or only after a while; not one that was let go.
        heard: a reply was seen that belongs to no call, and may belong to one of its calls that were let go.
        opened: what each handle was given for last.
        released: the calls that released handles lately, by class and handle.
        thing: what the handle of the call at hand stands for; None where that is not known.
        points: the latest set points of this stay.
        present: it is known to be still there, however long it has been silent.
        clue: to the controller's generation.
    """

    def __init__(self, first: Exchange) -> None:
        self.conversation: Conversation = first.conversation
        self.first = self.last = first
        self.calls = self.answered = self.longest_pause = 0
        self.service: Exchange | None = None
        self.connected: Exchange | None = None
        self.closed: Exchange | None = None
        self.motor: Exchange | None = None
        self.motor_on: bool | None = None
        self.arm: Exchange | None = None
        self.robslave: Exchange | None = None
        self.robslave_missing: Exchange | None = None
        self.motion: Exchange | None = None
        self.mode: int | None = None
        self.mode_call: Exchange | None = None
        self.mode_end: Exchange | None = None
        self.failure: Exchange | None = None
        self.error_read = False
        self.type_read = self.heard = self.present = False
        self.unanswered: Exchange | None = None
        self.opened: dict[int, Opened] = {}
        self.released: dict[tuple[ObjectClass, int], Exchange] = {}
        self.thing: Thing | None = None
        self.points: deque[Exchange] = deque(maxlen=RECENT_POINTS)
        self.clue = NO_CLUE

    @property
    def open_session(self) -> bool:
        """Whether it opened something that it has not closed."""
        return (self.service is not None or self.connected is not None) and self.closed is None

    @property
    def hung_up(self) -> Closing | None:
        """How the controller ended its connection; None where it did not, or the client did first."""
        closing = self.conversation.closing
        return closing if closing is not None and closing.by is Direction.RESPONSE else None

    @property
    def seen_from_start(self) -> bool:
        """Whether its service session began in this capture."""
        return self.service is not None

    @property
    def generation(self) -> Generation | None:
        """The controller's generation, as far as what was said tells it."""
        asked = self.robslave is not None or self.robslave_missing is not None
        return Generation.RC7 if asked else self.clue.generation

    @property
    def slave_mode(self) -> SlaveMode | None:
        """The slave mode that it has entered, by the controller's generation; None while it is off."""
        return slave_mode(self.mode, self.generation or Generation.RC8) if self.mode else None

    def take_point(self, call: Exchange) -> None:
        """Take a set point into account that was answered with S_OK."""
        reply = call.reply
        if reply is not None and reply.time - call.request.time > A_WHILE:
            self.unanswered = call
        self.calls += 1
        self.answered += 1
        self.last = call
        self.points.append(call)

    def learn(self, call: Exchange) -> None:
        """Take a settled call into account, the one that `thing` is about."""
        self.calls += 1
        self.longest_pause = max(self.longest_pause, call.request.time - self.last.activity)
        self.last = call
        reply = call.reply
        slow = not call.let_go if reply is None else reply.time - call.request.time > A_WHILE
        if slow:
            self.unanswered = call
        is_point = command_of(call.question) == "slvmove"
        if reply is None:
            if is_point and self.mode:
                self.points.append(call)
            return
        self.answered += 1
        code = reply.item.code
        if is_failure(code):
            self._learn_failure(call, code)
        elif is_point:
            self.points.append(call)
        else:
            self._learn_success(call)

    def _learn_success(self, call: Exchange) -> None:
        function_id, command = call.question
        if command is not None:
            teach = _BY_COMMAND.get(command.casefold()) if function_id in EXECUTES else None
        else:
            teach = _BY_FUNCTION.get(function_id)
            self._follow_objects(call)
        if teach is not None:
            teach(self, call)

    def _follow_objects(self, call: Exchange) -> None:
        function = FUNCTIONS.get(call.question.function_id)
        if function is None or (function.creates is None and function.releases is None):
            return
        handle, thing = result_of(call), self.thing
        if function.creates is not None and isinstance(handle, int):
            _put(self.opened, handle, Opened(function.creates, _name_asked(call), call))
            self.released.pop((function.creates, handle), None)
        elif function.releases is not None and thing is not None:
            _put(self.released, (thing.kind, thing.handle), call)

    def _learn_failure(self, call: Exchange, code: int) -> None:
        if self.robslave_missing is None and gets_robslave(call):
            self.robslave_missing = call
        if not ends_slave_mode(code):
            return
        if self.failure is None:
            self.failure, self.error_read = call, False
        if self.mode != 0:
            self.mode, self.mode_end = 0, call
        self.points.clear()

    def _start(self, call: Exchange) -> None:
        self._forget_session()
        self.service = call

    def _stop(self, call: Exchange) -> None:
        self._forget_session()
        self.closed = call

    def _forget_session(self) -> None:
        self.service = self.connected = self.closed = self.arm = None
        self.mode = 0

    def _connect(self, call: Exchange) -> None:
        self.connected, self.closed = call, None
        self.clue = better(self.clue, clue_of_call(call))

    def _start_task(self, call: Exchange) -> None:
        thing = self.thing
        if thing is not None and _is_robslave(thing.name):
            self.robslave = call

    def _get_value(self, call: Exchange) -> None:
        name = "" if self.thing is None else self.thing.name.casefold()
        self.error_read = self.error_read or name in ("@error_code", "@error_description")
        self.type_read = self.type_read or name in ("@type", "@type_name")

    def _move(self, call: Exchange) -> None:
        self.motion = call

    def _change_mode(self, call: Exchange) -> None:
        parameter = argument(call, 2)
        value = None if parameter is None else mode_value(parameter)
        if value:
            self.mode_call = call
            self.clue = better(self.clue, clue_of_call(call))
        elif self.mode:
            self.mode_end = call
        self.mode = value
        self.points.clear()

    def _switch_motor(self, call: Exchange) -> None:
        state = first_number(argument(call, 2))
        self.motor, self.motor_on = call, None if state is None else bool(state)

    def _take_arm(self, call: Exchange) -> None:
        self.arm = call
        self.clue = better(self.clue, clue_of_call(call))

    def _give_arm(self, call: Exchange) -> None:
        self.arm = None

    def _clear_error(self, call: Exchange) -> None:
        self.failure, self.error_read = None, False

    def _read_error(self, call: Exchange) -> None:
        self.error_read = True

    def _read_type(self, call: Exchange) -> None:
        self.type_read = True

    def _put_auto_mode(self, call: Exchange) -> None:
        self.clue = better(self.clue, clue_of_call(call))


_Teach: TypeAlias = Callable[[Client, Exchange], None]

_BY_FUNCTION: dict[int, _Teach] = {
    ID["Service_Start"]: Client._start,
    ID["Service_Stop"]: Client._stop,
    ID["Controller_Connect"]: Client._connect,
    ID["Controller_Disconnect"]: Client._stop,
    ID["Task_Start"]: Client._start_task,
    ID["Variable_GetValue"]: Client._get_value,
    ID["Robot_Move"]: Client._move,
    ID["Robot_Drive"]: Client._move,
    ID["Robot_GoHome"]: Client._move,
    ID["Robot_Rotate"]: Client._move,
}

_BY_COMMAND: dict[str, _Teach] = {
    **dict.fromkeys(_READS_ERROR, Client._read_error),
    **dict.fromkeys(_MOTIONS, Client._move),
    "slvchangemode": Client._change_mode,
    "motor": Client._switch_motor,
    "takearm": Client._take_arm,
    "givearm": Client._give_arm,
    "clearerror": Client._clear_error,
    "getrobottypename": Client._read_type,
    "putautomode": Client._put_auto_mode,
}


_Key = TypeVar("_Key")
_Value = TypeVar("_Value")


def _put(table: dict[_Key, _Value], key: _Key, value: _Value) -> None:
    if len(table) >= MOST_HANDLES:
        del table[next(iter(table))]
    table[key] = value


def _name_asked(call: Exchange) -> str:
    return text_argument(call, 0 if call.question.function_id == ID["Controller_Connect"] else 1)


class Clients:
    """All clients that were seen lately, by conversation."""

    def __init__(self, gone: Callable[[Client], None]) -> None:
        """Tell `gone` about each client that is dropped to bound the memory."""
        self._gone = gone
        self._all: dict[Conversation, Client] = {}
        self._departed: deque[Conversation] = deque()
        self.seen = 0

    def __iter__(self) -> Iterator[Client]:
        return iter(self._all.values())

    def of(self, call: Exchange) -> Client:
        """Return the client of a call, new if this is its first."""
        client = self._all.get(call.conversation)
        if client is None:
            self.seen += 1
            if len(self._all) >= MOST_CONVERSATIONS:
                silent = min(self._all.values(), key=lambda each: each.last.activity)
                del self._all[silent.conversation]
                self._gone(silent)
            client = self._all[call.conversation] = Client(call)
        return client

    def depart(self, conversation: Conversation) -> None:
        """Take notice that a client is gone for good; the latest few are remembered, for the others' sake."""
        client = self._all.get(conversation)
        if client is None:
            return
        client.points.clear()
        self._departed.append(conversation)
        if len(self._departed) > MOST_DEPARTED:
            forgotten = self._all.pop(self._departed.popleft(), None)
            if forgotten is not None:
                self._gone(forgotten)

    def find(self, conversation: Conversation) -> Client | None:
        """Return a client that has called; None for one that has not, or is forgotten."""
        return self._all.get(conversation)

    def others(self, client: Client) -> list[Client]:
        """Return the other clients of the same controller."""
        host = client.conversation.server.host
        return [each for each in self if each is not client and each.conversation.server.host == host]
