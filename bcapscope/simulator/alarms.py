"""Errors of the controller: those that are active until ClearError, and the log of all.

The fields of GetCurErrorInfo and GetErrorLog are those of ShoheiKobata/orin_bcap_python_samples and
nkawa/Denso_CobottaPro900_MQTT_Control; numbers that only a real program has are 0.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass

from bcapscope.protocol.tables.hresult import describe_hresult

MAX_ACTIVE = 32
MAX_LOGGED = 128


@dataclass(frozen=True, slots=True)
class Alarm:
    """One error.

    Attributes:
        code: unsigned.
        time: ns of the model's clock.
    """

    code: int
    time: int

    @property
    def text(self) -> str:
        """Its description, in our words."""
        return describe_hresult(self.code).text


class Alarms:
    """The error lists, newest first."""

    def __init__(self) -> None:
        self.active: deque[Alarm] = deque(maxlen=MAX_ACTIVE)
        self.log: deque[Alarm] = deque(maxlen=MAX_LOGGED)

    def add(self, code: int, now: int) -> None:
        """Note an error as active and in the log."""
        alarm = Alarm(code & 0xFFFFFFFF, now)
        self.active.appendleft(alarm)
        self.log.appendleft(alarm)

    def is_active(self, code: int) -> bool:
        """Return whether an error of this code (unsigned) is active."""
        return any(alarm.code == code for alarm in self.active)

    def clear(self) -> None:
        """Forget the active errors; the log keeps them."""
        self.active.clear()
