"""Find executions and replies that the capture lacks, from the handles that a controller gave in a session.

A skipped handle shows that the controller executed a retried call more than once. An accepted handle that no
captured reply contains shows that the capture lacks a reply.
"""

from __future__ import annotations

from collections.abc import Iterable

from bcapscope.protocol.tables.function_table import FUNCTIONS, ID, ObjectClass, ResultKind
from bcapscope.protocol.tables.hresult import is_success
from bcapscope.traffic.call import Call
from bcapscope.traffic.handle_tracker import MAX_OBJECTS, handle_in_reply, handle_of
from bcapscope.traffic.observation import Direction

_SERVICE_START = ID["Service_Start"]
OPENERS = frozenset((_SERVICE_START, *(f.id for f in FUNCTIONS.values() if f.result is ResultKind.HANDLE)))


class HandleSequence:
    """The handles of one conversation. In each session, the controller gives successive numbers."""

    def __init__(self) -> None:
        self._last_handle = 0  # handle in the latest reply of this session; 0 if there is none
        # handles given in this session; None if the capture lacks the start of the session
        self._given: set[tuple[ObjectClass | None, int]] | None = None

    def add_call(self, call: Call) -> None:
        """Add a complete call of a function in `OPENERS`, and set `skipped_handles` of the call."""
        if call.kind.function_id == _SERVICE_START:
            self._last_handle, self._given = 0, set()
        elif self._given is not None:
            self._given.update(_given_by(call))
            if len(self._given) > MAX_OBJECTS:
                self._given = None
        handle = handle_in_reply(call.reply)
        if handle is None:
            return
        skipped = handle - self._last_handle - 1
        if self._last_handle and 0 < skipped < len(call.attempts):
            call.skipped_handles = skipped
        self._last_handle = handle

    def prove_reply(self, call: Call, later_calls: Iterable[Call]) -> bool:
        """Return whether later calls prove that the client received a reply to `call` that was not captured.
        The proof is a handle that the controller accepted, but that no captured reply contains.
        """
        function = FUNCTIONS.get(call.kind.function_id)
        if self._given is None or function is None or function.creates is None:
            return False
        given, used = set(self._given), set[tuple[ObjectClass | None, int]]()
        for later in later_calls:
            if later.kind.function_id == _SERVICE_START:
                break
            given.update(_given_by(later))
            user = FUNCTIONS.get(later.kind.function_id)
            if user is not None and user.takes_handle and user.owner is function.creates:
                handle = handle_of(later.request.item) or 0
                if handle > 0 and later.hresult is not None and is_success(later.hresult):
                    used.add((function.creates, handle))
        return not used <= given


def _given_by(call: Call) -> Iterable[tuple[ObjectClass | None, int]]:
    """Yield each handle that a captured reply of a call holds, with the class of its object."""
    function = FUNCTIONS.get(call.kind.function_id)
    if function is None or function.creates is None:
        return
    for _, seen in call.frames:
        handle = handle_in_reply(seen) if seen.flow.direction is Direction.RESPONSE else None
        if handle is not None:
            yield function.creates, handle
