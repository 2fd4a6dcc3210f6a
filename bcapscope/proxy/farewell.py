"""What clients have left open at a controller, and how it is let go of when the proxy ends.

On UDP a controller cannot see that a client has gone: its handles, the arm that it took and slave mode stay.
Only what gives back is ever sent: slave mode off, the arm, handles, the service; nothing that moves.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import NamedTuple

from bcapscope.protocol.convention import Convention
from bcapscope.protocol.frame import encode
from bcapscope.protocol.functions import FUNCTIONS, ObjectClass
from bcapscope.protocol.hresult import is_failure, is_success
from bcapscope.protocol.variant import EMPTY, VT, Variant
from bcapscope.traffic.exchange import Exchange
from bcapscope.traffic.handles import Ending, Handles, Session, handle_of
from bcapscope.traffic.observation import Conversation, Transport

_ROBOT_EXECUTE = next(each.id for each in FUNCTIONS.values() if each.name == "Robot_Execute")
_RELEASES = {each.releases: each.id for each in FUNCTIONS.values() if each.releases is not None}
_STATES = _SLAVE, _TAKE, _GIVE = "slvchangemode", "takearm", "givearm"
_POINT = "slvmove"


class Farewell(NamedTuple):
    """How a session can be ended in its client's place.

    Attributes:
        conversation: the client's.
        state: what is open beside handles, in words: slave mode, the arm; "" for nothing.
        requests: the frames to be sent in this order, each after the answer to the one before.
    """

    conversation: Conversation
    state: str
    requests: tuple[bytes, ...]


class _State:
    def __init__(self) -> None:
        self.slave: dict[int, None] = {}
        self.arms: dict[int, None] = {}
        self.refused = False  # the latest set point, perhaps as slave mode has ended by itself
        self.serial = 0
        self.convention = Convention.UNKNOWN

    def words(self) -> str:
        parts = []
        if self.slave:
            parts.append("slave mode is on")
        if self.arms:
            parts.append("the arm is held")
        return " and ".join(parts)


class Farewells:
    """Follows settled calls, in the order of their start."""

    def __init__(self, handles: Handles) -> None:
        """Take what knows the handles; it is told of each call by somebody else."""
        self._handles = handles
        self._states: dict[Conversation, _State] = {}

    def follow(self, call: Exchange) -> None:
        """Take in the next call."""
        state = self._states.get(call.conversation)
        if state is None:
            state = self._states[call.conversation] = _State()
        state.serial = call.last.item.serial
        state.convention = call.convention
        command = (call.question.command or "").casefold()
        if command == _POINT:
            state.refused = call.hresult is not None and is_failure(call.hresult)
        elif command in _STATES:
            self._learn(state, call, command)

    def in_slave_mode(self) -> Iterator[Conversation]:
        """Yield the clients that are in slave mode, as far as was seen, and whose set points are accepted."""
        for client, state in self._states.items():
            if state.slave and not state.refused:
                yield client

    def forget(self, client: Conversation) -> str:
        """Forget a client that has gone; return what it left open beside handles, in words."""
        state = self._states.pop(client, None)
        return state.words() if state is not None else ""

    def of_all(self) -> tuple[Farewell, ...]:
        """Return how the sessions that are open can be ended; TCP clients' end with their connections."""
        return tuple(
            Farewell(session.conversation, state.words(), tuple(_requests(session, state)))
            for session in self._handles.sessions()
            if session.ending is Ending.OPEN
            and session.conversation.transport is Transport.UDP
            and (state := self._states.get(session.conversation)) is not None
        )

    def _learn(self, state: _State, call: Exchange, command: str) -> None:
        handle = handle_of(call.request.item)
        if handle is None or call.hresult is None or not is_success(call.hresult):
            return
        if command == _SLAVE:
            state.refused = False
            _switch(state.slave, handle, _mode(call.request.item.arguments) != 0)
        else:
            _switch(state.arms, handle, command == _TAKE)


def _mode(arguments: Sequence[tuple[Variant, int, int]]) -> object:
    """Return the parameter of a command: the third argument, a number or an array of one."""
    value = arguments[2][0].value if len(arguments) > 2 else None
    return value[0] if isinstance(value, tuple) and value else value


def _switch(known: dict[int, None], handle: int, on: bool) -> None:
    if on:
        known[handle] = None
    else:
        known.pop(handle, None)


def _requests(session: Session, state: _State) -> Iterator[bytes]:
    """Make the frames that end a session, with the serials that come next and the client's convention."""
    calls: list[tuple[int, tuple[Variant, ...]]] = []
    for known, command, parameter in (
        (state.slave, "slvChangeMode", Variant(VT.I4, 0)),
        (state.arms, "GiveArm", EMPTY),
    ):
        for handle in known:
            calls.append((_ROBOT_EXECUTE, (Variant(VT.I4, handle), Variant(VT.BSTR, command), parameter)))
    for thing in reversed(session.left):
        calls.append((_RELEASES[thing.kind], (Variant(VT.I4, thing.handle),)))
    calls.append((_RELEASES[ObjectClass.SERVICE], ()))
    serial = state.serial
    for function_id, arguments in calls:
        serial = serial % 0xFFFF + 1
        reserved = serial if state.convention is Convention.OWN else 0
        yield encode(serial, reserved, function_id, arguments)
