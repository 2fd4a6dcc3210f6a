"""The last step of the proxy's rules: the guard refuses requests, and the proxy answers the refused requests
instead of the controller.
"""

from __future__ import annotations

from collections.abc import Sequence

from bcapscope.faults.reply_factory import ReplyFactory
from bcapscope.messages import Message
from bcapscope.protocol.codec.frame import Frame
from bcapscope.protocol.tables.hresult import E_ACCESSDENIED
from bcapscope.proxy.direction_state import DirectionState
from bcapscope.proxy.policy import PolicyDecision, SendAction
from bcapscope.proxy.request_guard import RequestGuard
from bcapscope.traffic.observation import Direction


class MessageSender:
    """Forwards messages, refuses requests and answers them. `refused_requests` counts the requests that the
    guard or a missing script refused.
    """

    def __init__(self, guard: RequestGuard | None, replies: ReplyFactory) -> None:
        self.guard = guard
        self.refused_requests = 0
        self._replies = replies

    def send(self, state: DirectionState, data: bytes, note: Message | None, work: PolicyDecision) -> None:
        """Forward a message. The guard checks a request before the proxy forwards it. Adjacent bytes of a
        stream that no proxy rule changed are sent in one piece.
        """
        direction = state.flow.direction
        if self.guard is not None and direction is Direction.REQUEST:
            data = self._apply_guard(self.guard, state, data, work)
            if not data:
                return
        last = work.actions[-1] if work.actions and state.is_stream and note is None else None
        if isinstance(last, SendAction) and last == SendAction(state.client, direction, last.data):
            work.actions[-1] = SendAction(state.client, direction, last.data + data)
        else:
            work.actions.append(SendAction(state.client, direction, data, note))

    def refuse(
        self, state: DirectionState, requests: Sequence[Frame], note: Message, work: PolicyDecision
    ) -> None:
        self.refused_requests += len(requests)
        self.answer(state, requests, E_ACCESSDENIED, note, work)

    def answer(
        self,
        state: DirectionState,
        requests: Sequence[Frame],
        code: int,
        note: Message,
        work: PolicyDecision,
    ) -> None:
        """Reply to each request in place of the controller, with a result code and no value."""
        for request in requests:
            raw = self._replies.make_reply(state.flow.conversation, request, code)
            work.actions.append(SendAction(state.client, Direction.RESPONSE, raw, note))

    def _apply_guard(
        self, guard: RequestGuard, state: DirectionState, data: bytes, work: PolicyDecision
    ) -> bytes:
        passing, refused, dropped = guard.filter_frames(data)
        for frame, why in refused:
            work.notes.append(Message("guard.answered", reason=why))
            self.refuse(state, (frame,), Message("guard.refused", reason=why), work)
        if dropped:
            work.notes.append(Message("guard.dropped"))
        return passing
