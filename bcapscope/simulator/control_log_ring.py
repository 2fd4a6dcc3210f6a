"""The control log: a ring of joint records, one every 8 ms while the log is on.

The 39 values of a record and their order are those of ShoheiKobata/orin_bcap_python_samples
others/Get_Syslog.py. The counter in ms, and current and load computed from the encoders' lag, are assumptions
of bcapscope.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from typing import NamedTuple

from bcapscope.protocol.codec.variant import Variant
from bcapscope.protocol.slave_mode.modes import PERIOD_NS
from bcapscope.simulator.argument_values import bstr, i4, r8, variant_array
from bcapscope.simulator.kinematics import Joints

MAX_RECORDS = 10_000


class ControlLogRecord(NamedTuple):
    """One record: time in ns since the controller's start, commanded joints, and joints of the encoders."""

    time: int
    commanded: Joints
    actual: Joints


class ControlLog:
    """The ring of log records, oldest first; `due` is the time of the next record in ns, None if off."""

    def __init__(self) -> None:
        self.records: deque[ControlLogRecord] = deque(maxlen=MAX_RECORDS)
        self.due: int | None = None

    def start(self, now: int) -> None:
        self.due = now if self.due is None else self.due

    def stop(self) -> None:
        self.due = None

    def advance(self, now: int, sample: Callable[[int], ControlLogRecord]) -> None:
        """Store the records that are due; after a long pause, only as many records as the ring holds."""
        due = self.due
        if due is None:
            return
        if now - due > MAX_RECORDS * PERIOD_NS:
            due += (now - due) // PERIOD_NS * PERIOD_NS - MAX_RECORDS * PERIOD_NS
        while due <= now:
            self.records.append(sample(due))
            due += PERIOD_NS
        self.due = due


def log_record_variant(record: ControlLogRecord, tool: int, work: int) -> Variant:
    """Return a record as the VARIANT array that GetLogRecord returns."""
    values = []
    for commanded, actual in zip(record.commanded, record.actual, strict=True):
        lag = commanded - actual
        values += [r8(commanded), r8(actual), r8(lag), r8(abs(lag) * 10)]
    counter = record.time // 1_000_000
    return variant_array(*values, i4(0), i4(0), bstr(""), i4(0), i4(counter), i4(tool), i4(work))
