"""Follow the slave mode of each client: whether it is on, and which calls switch it on and off."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from enum import Enum
from typing import NamedTuple

from bcapscope.protocol.codec.variant import integer_value
from bcapscope.protocol.tables.command_catalogue import command_parameter
from bcapscope.protocol.tables.function_table import ID
from bcapscope.protocol.tables.hresult import (
    E_NOT_IN_SLAVE_MODE,
    E_SLAVE_OVERFLOW,
    ends_slave_mode,
    is_failure,
)
from bcapscope.traffic.bounded_dict import BoundedDict
from bcapscope.traffic.call import Call
from bcapscope.traffic.call_kind import MAX_CONVERSATIONS, CallKind
from bcapscope.traffic.handle_tracker import handle_of
from bcapscope.traffic.observation import Conversation

SLAVE_MODE_OFF_CODES = frozenset((E_NOT_IN_SLAVE_MODE, 0x83501033, 0x8120184E))
"""Result codes with which a controller refuses a command because slave mode is off."""

_ROBOT_EXECUTE, _ROBOT_RELEASE = ID["Robot_Execute"], ID["Robot_Release"]
_SESSION_BOUNDARIES = frozenset(
    ID[name] for name in ("Service_Start", "Service_Stop", "Controller_Disconnect")
)


class SlaveModeEffect(Enum):
    SET_POINT = "set point"
    """A set point that was accepted, unanswered, or refused because the controller's buffer was full."""
    SET_POINT_FAILED = "set point failed"
    """A set point that the controller refused, but not because of a full buffer or inactive slave mode."""
    FOUND_OFF = "found off"
    """A set point that the controller refused because slave mode is off."""
    MODE_CHANGED = "mode changed"
    """A slvChangeMode that the controller did not refuse."""
    SESSION_BOUNDARY = "session boundary"
    """A call that begins or ends a client's session, and that the controller did not refuse."""
    ROBOT_RELEASED = "robot released"
    """A call that releases a robot, and that the controller did not refuse."""
    ERROR = "error"
    """Any other call that failed with an error that switches slave mode off."""


def slave_mode_effect(call: Call) -> SlaveModeEffect | None:
    """Return what a call changes or shows about slave mode; None if it changes and shows nothing."""
    function_id, command = call.kind
    code = call.hresult
    refused = code is not None and is_failure(code)
    if function_id == _ROBOT_EXECUTE and command is not None:
        name = command.casefold()
        if name == "slvmove":
            if code in SLAVE_MODE_OFF_CODES:
                return SlaveModeEffect.FOUND_OFF
            failed = refused and code != E_SLAVE_OVERFLOW
            return SlaveModeEffect.SET_POINT_FAILED if failed else SlaveModeEffect.SET_POINT
        if name == "slvchangemode" and not refused:
            return SlaveModeEffect.MODE_CHANGED
    elif not refused and function_id in _SESSION_BOUNDARIES:
        return SlaveModeEffect.SESSION_BOUNDARY
    elif not refused and function_id == _ROBOT_RELEASE:
        return SlaveModeEffect.ROBOT_RELEASED
    return SlaveModeEffect.ERROR if code is not None and ends_slave_mode(code) else None


def is_set_point(call_kind: CallKind) -> bool:
    function_id, command = call_kind
    return function_id == _ROBOT_EXECUTE and command is not None and command.casefold() == "slvmove"


def requested_mode(call: Call) -> int | None:
    """Return the mode that a slvChangeMode call requests; None for other calls and for an unreadable mode."""
    if call.kind.folded_command != "slvchangemode":
        return None
    parameter = command_parameter(call.request.item.variants)
    return None if parameter is None else integer_value(parameter)


@dataclass(frozen=True, slots=True)
class SlaveModeChange:
    """A change of a client's slave mode by `call`. The new `mode` is 0 for off, and None if unknown."""

    call: Call
    effect: SlaveModeEffect
    mode: int | None


class OpenSlaveMode(NamedTuple):
    """A client's slave mode: 0 for off, None if unknown. `robots` are handles of the robots in slave mode."""

    mode: int | None = None
    robots: tuple[int, ...] = ()
    set_points_refused: bool = False


class SlaveModeTracker:
    def __init__(self) -> None:
        self._clients: BoundedDict[Conversation, OpenSlaveMode] = BoundedDict(MAX_CONVERSATIONS)

    def on_call(self, call: Call) -> SlaveModeChange | None:
        """Process the next call; return the change of slave mode that the call makes, or None."""
        effect = slave_mode_effect(call)
        if effect is None:
            return None
        known = self.find(call.conversation)
        if effect is SlaveModeEffect.SET_POINT:
            refused = call.hresult is not None and is_failure(call.hresult)
            if refused is not known.set_points_refused:
                self._clients[call.conversation] = known._replace(set_points_refused=refused)
            return None
        if call.reply is None and not call.reply_not_captured:
            return None
        updated = _updated(known, effect, call)
        if updated is None:
            return None
        self._clients[call.conversation] = updated
        if effect is not SlaveModeEffect.MODE_CHANGED and updated.mode == known.mode:
            return None
        return SlaveModeChange(call, effect, updated.mode)

    def find(self, conversation: Conversation) -> OpenSlaveMode:
        return self._clients.get(conversation, _NOTHING_KNOWN)

    def clients_in_slave_mode(self) -> Iterator[Conversation]:
        """Yield the conversations in slave mode, except those whose latest set point was refused."""
        for conversation, known in self._clients.items():
            if known.robots and not known.set_points_refused:
                yield conversation

    def close_conversation(self, conversation: Conversation) -> OpenSlaveMode:
        return self._clients.pop(conversation, _NOTHING_KNOWN)


_NOTHING_KNOWN = OpenSlaveMode()


def _updated(known: OpenSlaveMode, effect: SlaveModeEffect, call: Call) -> OpenSlaveMode | None:
    """Return the client's slave mode after a call; None if the call does not change slave mode."""
    handle = handle_of(call.request.item)
    others = tuple(robot for robot in known.robots if robot != handle)
    if effect is SlaveModeEffect.MODE_CHANGED:
        parameter = command_parameter(call.request.item.variants)
        leaves = parameter is not None and parameter.value == (0,)  # an array of one number
        mode = 0 if leaves else requested_mode(call)
        return OpenSlaveMode(mode, others if mode == 0 or handle is None else (*others, handle))
    if effect is SlaveModeEffect.SESSION_BOUNDARY:
        return OpenSlaveMode(0)
    if effect is SlaveModeEffect.ROBOT_RELEASED:
        return known._replace(robots=others) if others != known.robots else None
    failed_set_point = effect is not SlaveModeEffect.ERROR
    mode = 0 if call.hresult is not None and ends_slave_mode(call.hresult) else known.mode
    return known._replace(mode=mode, set_points_refused=failed_set_point or known.set_points_refused)
