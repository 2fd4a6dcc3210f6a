"""State of each controller, deduced from the calls of all its clients."""

from __future__ import annotations

from collections import deque

from bcapscope.analysis.slave.generation_clues import NO_CLUE, GenerationClue
from bcapscope.analysis.slave.motion_model import KnownPosition
from bcapscope.analysis.slave.session_builder import SessionKey, SlaveSessionBuilder
from bcapscope.analysis.slave.session_models import SlaveSetup
from bcapscope.analysis.slave.slave_session import AcceptedFormat, CallFact
from bcapscope.messages import Message
from bcapscope.messages.places import WireText
from bcapscope.protocol.slave_mode.formats import parse_format_parameter
from bcapscope.protocol.slave_mode.modes import PoseType
from bcapscope.protocol.slave_mode.poses import pose_numbers
from bcapscope.protocol.tables.command_catalogue import command_parameter
from bcapscope.traffic.call import Call
from bcapscope.traffic.slave_mode_tracker import requested_mode

MAX_CALLS = 1024
"""For each controller, at most this many calls are kept; set points do not count."""

MAX_BYTES = 1 << 20
"""Maximum total size in bytes of the calls that are kept for each controller."""

MAX_PENDING = 16
"""Maximum number of pending slave-mode sessions of one controller; a pending session has no set point yet."""

_POSITIONS = {"curjnt": PoseType.J, "curpos": PoseType.P, "curtrn": PoseType.T}


class ControllerState:
    """State of one controller.

    Attributes:
        unanswered_entry: Latest slvChangeMode call that got no reply, but may have entered slave mode.
        reported_mode: Slave mode of a session whose start was not captured, and the command that shows this
            mode.
        position: Latest reported position; None if the robot may have moved since.
    """

    def __init__(self) -> None:
        self.clue: GenerationClue = NO_CLUE
        self.recent_calls: deque[Call] = deque()
        self._bytes_kept = 0
        self.pending_sessions: dict[SessionKey, SlaveSessionBuilder] = {}
        self.unanswered_entry: Call | None = None
        self.reported_mode: tuple[int | None, str] = (None, "")
        self._send: AcceptedFormat | None = None
        self._receive: AcceptedFormat | None = None
        self.position: KnownPosition | None = None

    def slave_setup(self, mode: tuple[int | None, str], position: KnownPosition | None) -> SlaveSetup:
        value, known_by = mode
        return SlaveSetup(value, known_by, self.clue, self._send, self._receive, position)

    def remember_call(self, call: Call) -> None:
        self.recent_calls.append(call)
        self._bytes_kept += call.memory_bytes
        while self.recent_calls and (len(self.recent_calls) > MAX_CALLS or self._bytes_kept > MAX_BYTES):
            self._bytes_kept -= self.recent_calls.popleft().memory_bytes

    def calls_between(self, begin: int, end: int) -> list[Call]:
        """Return the recent calls that overlap the time from `begin` to `end`, sorted by request time."""
        found = [
            call for call in self.recent_calls if call.request.time <= end and call.last_activity >= begin
        ]
        return sorted(found, key=lambda call: call.request.time)

    def add_pending(self, key: SessionKey, builder: SlaveSessionBuilder) -> SlaveSessionBuilder | None:
        """Add a session without set points. If there were already `MAX_PENDING` of these sessions, remove and
        return the oldest one.
        """
        dropped = None
        if len(self.pending_sessions) >= MAX_PENDING:
            dropped = self.pending_sessions.pop(next(iter(self.pending_sessions)))
        self.pending_sessions[key] = builder
        return dropped

    def claim_pending(self, key: SessionKey) -> SlaveSessionBuilder | None:
        """Remove and return the pending session with this key, or else the oldest pending session, if any."""
        if not self.pending_sessions:
            return None
        oldest = next(iter(self.pending_sessions))
        builder = self.pending_sessions.pop(key if key in self.pending_sessions else oldest)
        builder.key = key
        return builder

    def claim_unanswered_entry(self) -> CallFact | None:
        """Return the slvChangeMode call in `unanswered_entry`, if any, and set `unanswered_entry` to None.
        Call this method when a set point begins a session: the set point shows that this slvChangeMode call
        succeeded.
        """
        entry, self.unanswered_entry = self.unanswered_entry, None
        if entry is None:
            return None
        self.reported_mode = requested_mode(entry), "slvChangeMode"
        return call_fact(entry)

    def record_format(self, call: Call, command: str) -> None:
        parameter = command_parameter(call.request.item.variants)
        found = None if parameter is None else parse_format_parameter(parameter)
        if found is None:
            return
        format_ = AcceptedFormat(found.value, found.microseconds, call.request.number)
        if command == "slvsendformat":
            self._send = format_
        else:
            self._receive = format_

    def record_position(self, call: Call, command: str) -> None:
        pose_type, reply = _POSITIONS.get(command), call.reply
        if pose_type is None or reply is None or not reply.item.arguments:
            return
        values = pose_numbers(reply.item.arguments[0].variant)
        if values:
            frames = call.request.number, reply.number
            known_by = Message("position-by.command", command=WireText(call.kind.command or ""))
            self.position = KnownPosition(pose_type, values, known_by, frames)


def call_fact(call: Call) -> CallFact:
    reply = call.reply
    return CallFact(
        call=call.number,
        client=call.conversation.client,
        function_id=call.kind.function_id,
        command=call.kind.command,
        request_frame=call.request.number,
        time=call.request.time,
        reply_frame=None if reply is None else reply.number,
        reply_time=None if reply is None else reply.time,
        hresult=call.hresult,
    )
