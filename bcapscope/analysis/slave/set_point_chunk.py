"""Chunks of set points, for callers that need each set point and not only figures."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple, TypeAlias

from bcapscope.analysis.slave.column_templates import PoseColumns
from bcapscope.analysis.slave.set_point_table import SetPointTable
from bcapscope.analysis.slave.slave_session import AcceptedFormat, KnownMode
from bcapscope.protocol.slave_mode.poses import Axis
from bcapscope.traffic.observation import Conversation


class SetPointChunk(NamedTuple):
    """Successive set points of one slave-mode session, including refused ones.

    Attributes:
        mode: Slave mode, as far as known at the first set point.
        grid_ms: Period that the client should keep, ms.
        microseconds: True if the controller's time stamps are in µs, not ms.
        axes: Axes of the poses; () if no pose could be read.
        table: Calls of the set points.
        commanded: Poses of the requests, one row per call.
        returned: Poses of the same type and time stamps in the replies, one row per call.
    """

    session_number: int
    conversation: Conversation
    robot: int | None
    mode: KnownMode
    send_format: AcceptedFormat | None
    receive_format: AcceptedFormat | None
    grid_ms: float
    microseconds: bool
    axes: tuple[Axis, ...]
    table: SetPointTable
    commanded: PoseColumns
    returned: PoseColumns


SetPointHandler: TypeAlias = Callable[[SetPointChunk], None]
"""Receives the set points of all slave-mode sessions, some thousand at a time."""
