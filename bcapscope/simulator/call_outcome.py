"""The outcome of a call to the simulated controller: a result now, or later."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TypeAlias

import msgspec

from bcapscope.errors import BcapError
from bcapscope.messages import Message
from bcapscope.protocol.codec.variant import Variant
from bcapscope.protocol.tables.hresult import S_OK


# Every call makes one object of this class. A struct takes 0.1 µs to make, a named tuple 0.4 µs, and a frozen
# dataclass 0.9 µs. Unlike a named tuple, a struct never equals an object of another class.
class CallResult(msgspec.Struct, frozen=True):
    """The result of a call.

    Attributes:
        value: Value of the result; if None, the profile decides between no argument and EMPTY.
        reason: Why the call was refused, for the simulator's user; empty if the result code is enough.
    """

    hresult: int = S_OK
    value: Variant | None = None
    reason: str = ""


@dataclass(frozen=True, slots=True)
class RunningCall:
    """A call that is not finished; both functions get the current time in ns.

    Attributes:
        poll: Returns the result, or None while the call runs.
        due: Returns the latest time for the next poll in ns.
    """

    poll: Callable[[int], CallResult | None]
    due: Callable[[int], int]


CallOutcome: TypeAlias = CallResult | RunningCall

HandlerOutcome: TypeAlias = CallOutcome | Variant | None
"""Result of a handler: an outcome, the value of a call that succeeded, or None for success without value."""

DONE = CallResult()


class RefusedError(BcapError):
    """The controller refuses a call, and answers the call with `hresult`."""

    def __init__(self, hresult: int, reason: str = "") -> None:
        super().__init__(Message("simulator.refused", code=f"{hresult:08X}"))
        self.hresult = hresult
        self.reason = reason


def succeed_at(time: int) -> RunningCall:
    """Return a running call that succeeds at a given time in ns."""
    return RunningCall(lambda now: DONE if now >= time else None, lambda now: time)
