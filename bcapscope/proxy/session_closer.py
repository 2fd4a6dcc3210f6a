"""Tracks which sessions clients have left open at a controller, and makes the requests that close them.

Over UDP, a controller cannot notice that a client is gone: the client's handles stay open, the arm stays
taken, and slave mode stays on. None of the closing requests moves the robot.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import NamedTuple

from bcapscope.messages import Message
from bcapscope.protocol.closing_calls import closing_calls
from bcapscope.protocol.codec.frame import encode_frame
from bcapscope.protocol.retry.reserved_convention import ReservedConvention
from bcapscope.protocol.tables.hresult import is_failure
from bcapscope.traffic.call import Call
from bcapscope.traffic.handle_tracker import (
    HandleTracker,
    ServiceSession,
    SessionEnding,
    TrackedObject,
    handle_of,
)
from bcapscope.traffic.observation import Conversation, Transport
from bcapscope.traffic.pipeline import PipelineSubscriber
from bcapscope.traffic.slave_mode_tracker import SlaveModeTracker

_TAKE, _GIVE = "takearm", "givearm"


class CloseSequence(NamedTuple):
    """Requests that close a session which its client left open. Each request must wait for the reply to the
    previous request. `open_state` is what the client left open besides handles: slave mode, the arm or both.
    """

    conversation: Conversation
    open_state: Message | None
    requests: tuple[bytes, ...]


class SessionCloser(PipelineSubscriber):
    def __init__(self, handles: HandleTracker, slave_mode: SlaveModeTracker) -> None:
        """`handles` and `slave_mode` must belong to the pipeline to which this object subscribes."""
        self._handles = handles
        self._slave_mode = slave_mode
        self._last_calls: dict[Conversation, Call] = {}
        self._arm_handles: dict[Conversation, dict[int, None]] = {}
        self._left_open: dict[Conversation, Message | None] = {}

    def on_call(self, call: Call, target: TrackedObject | None) -> None:
        self._last_calls[call.conversation] = call
        command = call.kind.folded_command
        if command in (_TAKE, _GIVE):
            handle = handle_of(call.request.item)
            if handle is None or call.hresult is None or is_failure(call.hresult):
                return
            arm_handles = self._arm_handles.setdefault(call.conversation, {})
            if command == _TAKE:
                arm_handles[handle] = None
            else:
                arm_handles.pop(handle, None)

    def on_set_points(self, calls: Sequence[Call]) -> None:
        self.on_call(calls[-1], None)

    def on_conversation_closed(self, conversation: Conversation) -> None:
        self._left_open[conversation] = self._open_state(conversation)
        self._last_calls.pop(conversation, None)
        self._arm_handles.pop(conversation, None)

    def pop_left_open(self, client: Conversation) -> Message | None:
        """Return what a removed client left open besides handles."""
        return self._left_open.pop(client, None)

    def close_sequences(self) -> tuple[CloseSequence, ...]:
        """Return the requests that close each open UDP session. A TCP session ends with its connection."""
        return tuple(
            CloseSequence(
                session.conversation,
                self._open_state(session.conversation),
                tuple(self._closing_requests(session, last_call)),
            )
            for session in self._handles.sessions()
            if session.ending is SessionEnding.OPEN
            and session.conversation.transport is Transport.UDP
            and (last_call := self._last_calls.get(session.conversation)) is not None
        )

    def _open_state(self, client: Conversation) -> Message | None:
        has_arm = bool(self._arm_handles.get(client))
        if self._slave_mode.find(client).robots:
            return Message("session.open.both" if has_arm else "session.open.slave-mode")
        return Message("session.open.arm") if has_arm else None

    def _closing_requests(self, session: ServiceSession, last_call: Call) -> Iterator[bytes]:
        """Yield requests with the client's next serials and its convention for the reserved field."""
        robots = self._slave_mode.find(session.conversation).robots
        arms = self._arm_handles.get(session.conversation, {})
        objects = [(each.kind, each.handle) for each in reversed(session.unreleased)]
        serial = last_call.last_attempt.item.serial
        for function_id, arguments in closing_calls(robots, arms, objects):
            serial = serial % 0xFFFF + 1
            reserved = serial if last_call.convention is ReservedConvention.OWN else 0
            yield encode_frame(serial, reserved, function_id, arguments)
