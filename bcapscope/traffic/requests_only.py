"""Captures that hold only the requests of a conversation."""

from __future__ import annotations

from bcapscope.protocol.tables.function_table import FUNCTIONS, ObjectClass
from bcapscope.traffic.call import Call
from bcapscope.traffic.handle_tracker import handle_of

FEWEST_CALLS = 8

LONGEST_STEP_NS = 500_000_000
"""Maximum time in ns between two calls in quick succession. A client that gets no reply begins the next call
only after its timeout: 1 s in DENSO Wave 2009, 3 s in orin_bcap Python bcapclient.py.
"""


class RequestsOnlyEvidence:
    """Finds out from a client's requests whether the client received replies that were not captured.

    Either of two facts proves that the client received replies. First, the client opened an object, and then
    uses a handle of an object of the same class. Second, the client made at least `FEWEST_CALLS` calls in
    quick succession without a retry, and uses a handle.
    """

    def __init__(self) -> None:
        self.is_proven = False
        # classes of the objects that the client opened in this capture
        self._opened: set[ObjectClass] = set()
        self._calls_in_a_row = 0
        self._latest_call: Call | None = None

    def add_call(self, call: Call) -> None:
        if self.is_proven:
            return
        before, self._latest_call = self._latest_call, call
        if before is not None and (
            before.other_frames or call.request.time - before.request.time >= LONGEST_STEP_NS
        ):
            self._calls_in_a_row = 0
        self._calls_in_a_row += 1
        function = FUNCTIONS.get(call.kind.function_id)
        if function is None:
            return
        if function.creates is not None:
            self._opened.add(function.creates)
        if function.takes_handle and (handle_of(call.request.item) or 0) > 0:
            self.is_proven = function.owner in self._opened or self._calls_in_a_row >= FEWEST_CALLS
