"""Rule about calls that change the robot's speed during a motion."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator
from typing import NamedTuple

from bcapscope.analysis.client_state import MOTION_COMMANDS, MOTION_FUNCTIONS, ClientState
from bcapscope.analysis.finding_places import call_name_place, call_place, client_place
from bcapscope.analysis.rules.rule_checker import CallHealth, Occurrence, RuleChecker, frame_numbers
from bcapscope.analysis.slave.slave_session import SlaveSession
from bcapscope.messages import Message
from bcapscope.messages.places import CallPlace, Moment
from bcapscope.protocol.tables.function_table import ID
from bcapscope.traffic.call import Call
from bcapscope.traffic.call_kind import CallKind
from bcapscope.traffic.observation import Conversation

_REMEMBERED = 32
"""Maximum number of motions, and of speed changes, that the checker remembers for all controllers together.
The checker may get a speed change before or after the motion, because calls of different clients may complete
in any order.
"""

_SPEED_VARIABLES = frozenset(("@extaccel", "@extdecel", "@extspeed"))


class _TimedCall(NamedTuple):
    """One motion or one change of speed. All set points of a slave-mode session count as one motion."""

    conversation: Conversation
    began: int
    ended: int
    frames: tuple[int, ...]
    call: CallPlace


class MotionChecker(RuleChecker):
    def set_up(self) -> None:
        self._motions: deque[_TimedCall] = deque(maxlen=_REMEMBERED)
        self._changes: deque[_TimedCall] = deque(maxlen=_REMEMBERED)

    def wants_call(self, call_kind: CallKind, health: CallHealth) -> bool:
        return health is not CallHealth.REFUSED and (
            call_kind.function_id in (*MOTION_FUNCTIONS, ID["Variable_PutValue"])
            or call_kind.folded_command in (*MOTION_COMMANDS, "extspeed")
        )

    def on_call(self, call: Call, client: ClientState) -> None:
        if call.reply is None:
            return
        pairs: list[tuple[_TimedCall, _TimedCall]] = []
        times, frames = (call.request.time, call.reply.time), frame_numbers(call)
        if _is_motion(call):
            motion = _TimedCall(call.conversation, *times, frames, call_place(call))
            self._motions.append(motion)
            pairs = [(motion, change) for change in self._changes]
        elif _sets_speed(call, client):
            change = _TimedCall(call.conversation, *times, frames, call_name_place(call))
            self._changes.append(change)
            pairs = [(motion, change) for motion in self._motions]
        for pair in pairs:
            for occurrence in _occurrences(*pair):
                self.report_occurrence(occurrence)

    def session_occurrences(self, session: SlaveSession) -> Iterator[Occurrence]:
        first, last = session.first_set_point, session.last_set_point
        if first is not None and last is not None:
            place = CallPlace("slvMove", None, 0)
            frames = (first.frame, last.frame)
            motion = _TimedCall(session.conversation, first.time, last.time, frames, place)
            for change in self._changes:
                yield from _occurrences(motion, change)


def _occurrences(motion: _TimedCall, change: _TimedCall) -> Iterator[Occurrence]:
    is_same_controller = motion.conversation.server.host == change.conversation.server.host
    if not is_same_controller or not motion.began < change.ended < motion.ended:
        return
    fact = Message(
        "finding.speed-changed-in-motion",
        at=Moment(change.ended),
        client=client_place(change.conversation),
        call=change.call,
        motion=motion.call,
        mover=client_place(motion.conversation),
    )
    clause = Message("clause.speed-changed-in-motion", call=change.call)
    frames = tuple(sorted({*motion.frames, *change.frames}))
    time, client, number = change.ended, change.conversation, change.call.call
    yield Occurrence("speed-changed-in-motion", time, time, client, frames, fact, clause, number)


def _is_motion(call: Call) -> bool:
    return call.kind.function_id in MOTION_FUNCTIONS or call.kind.folded_command in MOTION_COMMANDS


def _sets_speed(call: Call, client: ClientState) -> bool:
    if call.kind.folded_command == "extspeed":
        return True
    target = client.target_object
    return target is not None and target.name.casefold() in _SPEED_VARIABLES
