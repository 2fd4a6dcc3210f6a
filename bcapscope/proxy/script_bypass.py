"""What passes without the scripts: stops always, and everything except motion while the scripts are off.

A stop overtakes messages that wait for the scripts. A motion that arrived before it must not start after it.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import NamedTuple

from bcapscope.faults.wire_message import WireMessage
from bcapscope.protocol.codec.frame import Frame, Malformed
from bcapscope.protocol.guard import always_passes, request_effect
from bcapscope.protocol.tables.call_effect import CallEffect
from bcapscope.protocol.tables.function_table import FUNCTIONS, ID
from bcapscope.proxy.direction_state import DirectionState
from bcapscope.traffic.observation import Direction

_HALTS = frozenset((ID["Robot_Halt"], ID["Robot_Hold"]))


class BypassResult(NamedTuple):
    """The result of removing motion from a request that bypasses the scripts.

    Attributes:
        passing: Bytes to forward.
        refused: Frames that were removed because they may move something.
    """

    passing: bytes
    refused: tuple[Frame, ...]


def is_stop_request(message: WireMessage) -> bool:
    """Return whether a message is a request that only stops the robot or releases something."""
    if message.flow.direction is Direction.RESPONSE or not message.frames:
        return False
    return all(not each.problems and _always_passes(each) for each in message.frames)


def mark_overtaken(
    stop: WireMessage, state: DirectionState, request_states: Iterable[DirectionState]
) -> None:
    """Mark the waiting motions that must not start any more, because a later stop overtakes them.

    A stop ends the motions of its own client. Robot_Halt and Robot_Hold end those of all clients of the
    controller, because they may arrive over a separate connection. A release ends none.

    Args:
        stop: The message that does not wait.
        state: Request direction of its client.
        request_states: Request directions of all clients.
    """
    codes = {each.code for each in stop.frames}
    if not codes.isdisjoint(_HALTS):
        controller = state.flow.conversation.server
        for each in request_states:
            if each.flow.conversation.server == controller:
                each.overtaken_by = stop.number
    elif any(FUNCTIONS[code].releases is None for code in codes):
        state.overtaken_by = stop.number


def remove_motion(items: Iterable[Frame | Malformed]) -> BypassResult:
    """Separate the frames that move something, or may, from the rest of a request."""
    passing, refused = [], []
    for item in items:
        if isinstance(item, Frame) and _moves(item):
            refused.append(item)
        else:
            passing.append(item.raw)
    return BypassResult(b"".join(passing), tuple(refused))


def _moves(frame: Frame) -> bool:
    return not _always_passes(frame) and request_effect(frame.code, frame.variants) >= CallEffect.MOVES


def _always_passes(frame: Frame) -> bool:
    return always_passes(frame.code, frame.variants)
