"""Rule about calls that change a motion while it runs."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator
from dataclasses import dataclass

from bcapscope.analysis.client_state import ClientRegistry, ClientState, folded_command
from bcapscope.analysis.finding import Severity
from bcapscope.analysis.finding_places import call_name_place, call_place, client_place
from bcapscope.analysis.rules.rule_checker import (
    CallHealth,
    DiagnosisRule,
    Occurrence,
    OccurrenceSink,
    RuleChecker,
    frame_numbers,
)
from bcapscope.analysis.slave.slave_session import SlaveSession
from bcapscope.messages import Message
from bcapscope.messages.places import CallPlace, Moment
from bcapscope.protocol.tables.function_table import ID
from bcapscope.traffic.call import Call
from bcapscope.traffic.call_kind import CallKind
from bcapscope.traffic.observation import Conversation

SPEED_CHANGED_IN_MOTION = DiagnosisRule(
    "speed-changed-in-motion",
    Severity.NOTE,
    "ShoheiKobata/orin_bcap_python_samples; nkawa/Denso_CobottaPro900_MQTT_Control denso_robot.py (ExtSpeed)",
)

_REMEMBERED = 32
"""Motions and speed changes of all controllers that are kept, the latest of each. Calls of different clients
arrive in the order in which they settle, so either may arrive first."""

_MOTION_FUNCTIONS = frozenset(ID[f"Robot_{name}"] for name in ("Drive", "GoHome", "Move", "Rotate"))
_MOTION_COMMANDS = frozenset(("approach", "depart", "driveaex", "driveex"))
_SPEED_VARIABLES = frozenset(("@extaccel", "@extdecel", "@extspeed"))


@dataclass(frozen=True, slots=True)
class _Motion:
    conversation: Conversation
    began: int
    ended: int
    frames: tuple[int, ...]
    call: CallPlace


@dataclass(frozen=True, slots=True)
class _SpeedChange:
    conversation: Conversation
    time: int
    frames: tuple[int, ...]
    call: CallPlace


class MotionChecker(RuleChecker):
    """Checks whether the external speed changed while the robot of the same controller moved."""

    rules = (SPEED_CHANGED_IN_MOTION,)

    def __init__(self, report_occurrence: OccurrenceSink, clients: ClientRegistry) -> None:
        super().__init__(report_occurrence, clients)
        self._motions: deque[_Motion] = deque(maxlen=_REMEMBERED)
        self._changes: deque[_SpeedChange] = deque(maxlen=_REMEMBERED)

    def wants_call(self, call_kind: CallKind, health: CallHealth) -> bool:
        return health is not CallHealth.REFUSED and (
            call_kind.function_id in (*_MOTION_FUNCTIONS, ID["Variable_PutValue"])
            or folded_command(call_kind) in (*_MOTION_COMMANDS, "extspeed")
        )

    def on_call(self, call: Call, client: ClientState) -> None:
        if call.reply is None:
            return
        if _is_motion(call):
            end = call.reply.time
            frames = frame_numbers(call)
            self._add_motion(_Motion(call.conversation, call.request.time, end, frames, call_place(call)))
        elif _sets_speed(call, client):
            self._add_change(
                _SpeedChange(call.conversation, call.reply.time, frame_numbers(call), call_name_place(call))
            )

    def session_occurrences(self, session: SlaveSession) -> Iterator[Occurrence]:
        first, last = session.first_set_point, session.last_set_point
        if first is not None and last is not None:
            place = CallPlace("slvMove", None, 0)
            frames = (first.frame, last.frame)
            motion = _Motion(session.conversation, first.time, last.time, frames, place)
            for change in self._changes:
                yield from _occurrences(motion, change)

    def _add_motion(self, motion: _Motion) -> None:
        self._motions.append(motion)
        for change in self._changes:
            self._report(motion, change)

    def _add_change(self, change: _SpeedChange) -> None:
        self._changes.append(change)
        for motion in self._motions:
            self._report(motion, change)

    def _report(self, motion: _Motion, change: _SpeedChange) -> None:
        for occurrence in _occurrences(motion, change):
            self.report_occurrence(occurrence)


def _occurrences(motion: _Motion, change: _SpeedChange) -> Iterator[Occurrence]:
    """Yield an occurrence if the speed of this controller changed during the motion."""
    is_same_controller = motion.conversation.server.host == change.conversation.server.host
    if is_same_controller and motion.began < change.time < motion.ended:
        yield Occurrence(
            SPEED_CHANGED_IN_MOTION,
            change.time,
            change.time,
            change.conversation,
            tuple(sorted({*motion.frames, *change.frames})),
            Message(
                "finding.speed-changed-in-motion",
                at=Moment(change.time),
                client=client_place(change.conversation),
                call=change.call,
                motion=motion.call,
                mover=client_place(motion.conversation),
            ),
            Message("clause.speed-changed-in-motion", call=change.call),
            call=change.call.number,
        )


def _is_motion(call: Call) -> bool:
    return call.kind.function_id in _MOTION_FUNCTIONS or folded_command(call.kind) in _MOTION_COMMANDS


def _sets_speed(call: Call, client: ClientState) -> bool:
    if folded_command(call.kind) == "extspeed":
        return True
    target = client.target_object
    return target is not None and target.name.casefold() in _SPEED_VARIABLES
