"""The sequence of handles in a session. Skipped handles show that the controller executed a call more than
once."""

from __future__ import annotations

from bcapscope.protocol.codec.variant import VT
from bcapscope.protocol.tables.function_table import FUNCTIONS, ID, ResultKind
from bcapscope.protocol.tables.hresult import is_failure
from bcapscope.traffic.call import Call

_SERVICE_START = ID["Service_Start"]
OPENERS = frozenset((_SERVICE_START, *(f.id for f in FUNCTIONS.values() if f.result is ResultKind.HANDLE)))
"""Ids of the functions whose replies return a handle from the sequence."""


class HandleSequence:
    """The handles of one conversation. In each session, the controller gives successive numbers as
    handles.
    """

    def __init__(self) -> None:
        self._last_handle = 0  # the last handle returned in this session

    def count_skipped(self, call: Call) -> None:
        """Count the handles that the controller gave for unanswered attempts of a call. Callers pass only
        calls of functions in `OPENERS`, which return handles.
        """
        reply = call.reply
        if call.kind.function_id == _SERVICE_START:
            self._last_handle = 0
        if reply is None or is_failure(reply.item.code) or not reply.item.arguments:
            return
        vt, handle, _ = reply.item.arguments[0].variant
        if vt != VT.I4 or not isinstance(handle, int):
            return
        skipped = handle - self._last_handle - 1
        if self._last_handle and 0 < skipped < len(call.attempts):
            call.skipped_handles = skipped
        self._last_handle = handle
