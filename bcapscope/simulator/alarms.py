"""Errors of the controller: the active errors until ClearError, and the log of all errors.

The fields of GetCurErrorInfo and GetErrorLog are those of ShoheiKobata/orin_bcap_python_samples and
nkawa/Denso_CobottaPro900_MQTT_Control. Fields that only a real controller program can fill are 0.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass

from bcapscope.protocol.tables.hresult import describe_hresult

MAX_ACTIVE = 32
MAX_LOGGED = 128


@dataclass(frozen=True, slots=True)
class Alarm:
    """One error: its HRESULT as an unsigned number, and its time in ns of the model's clock."""

    code: int
    time: int

    @property
    def text(self) -> str:
        """Description of the error, in bcapscope's words."""
        return describe_hresult(self.code).text


class Alarms:
    """The active errors and the error log of a controller, both newest first."""

    def __init__(self) -> None:
        self.active: deque[Alarm] = deque(maxlen=MAX_ACTIVE)
        self.log: deque[Alarm] = deque(maxlen=MAX_LOGGED)

    def add(self, code: int, now: int) -> None:
        alarm = Alarm(code & 0xFFFFFFFF, now)
        self.active.appendleft(alarm)
        self.log.appendleft(alarm)

    def is_active(self, code: int) -> bool:
        return any(alarm.code == code for alarm in self.active)

    def clear(self) -> None:
        """Clear the active errors; the log keeps them."""
        self.active.clear()
