"""Tracks what clients have left open at a controller, and closes it when the proxy ends.

On UDP a controller cannot see that a client is gone: its handles, its arm and slave mode stay. The proxy
sends only requests that give something back: slave mode off, the arm, handles, the service. None of them
moves the robot.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import NamedTuple

from bcapscope.protocol.codec.frame import encode_frame
from bcapscope.protocol.codec.variant import EMPTY, VT, Variant
from bcapscope.protocol.retry.reserved_convention import ReservedConvention
from bcapscope.protocol.tables.function_table import FUNCTIONS, ObjectClass
from bcapscope.protocol.tables.hresult import is_failure, is_success
from bcapscope.traffic.call import Call
from bcapscope.traffic.handle_tracker import HandleTracker, ServiceSession, SessionEnding, handle_of
from bcapscope.traffic.observation import Conversation, Transport

_ROBOT_EXECUTE = next(each.id for each in FUNCTIONS.values() if each.name == "Robot_Execute")
_RELEASES = {each.releases: each.id for each in FUNCTIONS.values() if each.releases is not None}
_STATES = _SLAVE, _TAKE, _GIVE = "slvchangemode", "takearm", "givearm"
_POINT = "slvmove"


class CloseSequence(NamedTuple):
    """The requests that close a session in its client's place.

    Attributes:
        conversation: Conversation of the client.
        open_state: What is open besides handles, as text: slave mode, the arm; "" for nothing.
        requests: Frames to send in this order, each after the reply to the previous one.
    """

    conversation: Conversation
    open_state: str
    requests: tuple[bytes, ...]


class _State:
    def __init__(self) -> None:
        self.slave_mode_handles: dict[int, None] = {}
        self.arm_handles: dict[int, None] = {}
        self.set_point_refused = False  # result of the latest set point; slave mode may have ended
        self.serial = 0
        self.convention = ReservedConvention.UNKNOWN

    def describe(self) -> str:
        parts = []
        if self.slave_mode_handles:
            parts.append("slave mode is on")
        if self.arm_handles:
            parts.append("the arm is held")
        return " and ".join(parts)


class SessionCloser:
    """Follows complete calls, in the order of their start."""

    def __init__(self, handles: HandleTracker) -> None:
        """Use a handle tracker. Its owner shows it each call."""
        self._handles = handles
        self._states: dict[Conversation, _State] = {}

    def on_call(self, call: Call) -> None:
        """Follow the next call."""
        state = self._states.get(call.conversation)
        if state is None:
            state = self._states[call.conversation] = _State()
        state.serial = call.last_attempt.item.serial
        state.convention = call.convention
        command = (call.kind.command or "").casefold()
        if command == _POINT:
            state.set_point_refused = call.hresult is not None and is_failure(call.hresult)
        elif command in _STATES:
            self._update_state(state, call, command)

    def clients_in_slave_mode(self) -> Iterator[Conversation]:
        """Yield the clients that are in slave mode, as far as seen, and whose set points are accepted."""
        for client, state in self._states.items():
            if state.slave_mode_handles and not state.set_point_refused:
                yield client

    def remove_client(self, client: Conversation) -> str:
        """Forget a client that is gone. Return what it left open besides handles, as text."""
        state = self._states.pop(client, None)
        return state.describe() if state is not None else ""

    def close_sequences(self) -> tuple[CloseSequence, ...]:
        """Return how to close the open UDP sessions. TCP sessions end with their connections."""
        return tuple(
            CloseSequence(session.conversation, state.describe(), tuple(_closing_requests(session, state)))
            for session in self._handles.sessions()
            if session.ending is SessionEnding.OPEN
            and session.conversation.transport is Transport.UDP
            and (state := self._states.get(session.conversation)) is not None
        )

    def _update_state(self, state: _State, call: Call, command: str) -> None:
        handle = handle_of(call.request.item)
        if handle is None or call.hresult is None or not is_success(call.hresult):
            return
        if command == _SLAVE:
            state.set_point_refused = False
            _switch(state.slave_mode_handles, handle, _mode(call.request.item.arguments) != 0)
        else:
            _switch(state.arm_handles, handle, command == _TAKE)


def _mode(arguments: Sequence[tuple[Variant, int, int]]) -> object:
    """Return the parameter of a command: the third argument, a number or an array of one."""
    value = arguments[2][0].value if len(arguments) > 2 else None
    return value[0] if isinstance(value, tuple) and value else value


def _switch(known: dict[int, None], handle: int, on: bool) -> None:
    if on:
        known[handle] = None
    else:
        known.pop(handle, None)


def _closing_requests(session: ServiceSession, state: _State) -> Iterator[bytes]:
    """Yield the frames that close a session, with the next serials and the client's reserved convention."""
    calls: list[tuple[int, tuple[Variant, ...]]] = []
    for known, command, parameter in (
        (state.slave_mode_handles, "slvChangeMode", Variant(VT.I4, 0)),
        (state.arm_handles, "GiveArm", EMPTY),
    ):
        for handle in known:
            calls.append((_ROBOT_EXECUTE, (Variant(VT.I4, handle), Variant(VT.BSTR, command), parameter)))
    for thing in reversed(session.unreleased):
        calls.append((_RELEASES[thing.kind], (Variant(VT.I4, thing.handle),)))
    calls.append((_RELEASES[ObjectClass.SERVICE], ()))
    serial = state.serial
    for function_id, arguments in calls:
        serial = serial % 0xFFFF + 1
        reserved = serial if state.convention is ReservedConvention.OWN else 0
        yield encode_frame(serial, reserved, function_id, arguments)
