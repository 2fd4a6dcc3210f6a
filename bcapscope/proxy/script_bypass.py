"""Messages that pass without the scripts: stops always, and all except motion while scripts are off.

A stop overtakes messages that wait for the scripts. A motion that arrived before the stop must not start
after the stop.
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
    """Parts of a request from which motion was removed.

    Attributes:
        passing: Bytes that are forwarded.
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
    """Mark the waiting motions that must not start any more, because a later stop has overtaken them.

    A stop ends the motions of its own client. Robot_Halt and Robot_Hold end the motions of all clients of the
    controller, because these calls may arrive over a separate connection. A release ends no motion.

    Args:
        stop: Message that does not wait for the scripts.
        state: State of the request direction of the stop's client.
        request_states: States of the request directions of all clients.
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
    """Separate the frames of a request that move something, or may move something, from the other frames."""
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
