"""Set points of a stay as they come, for whoever wants each of them and not only figures."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple, TypeAlias

from bcapscope.analysis.slave.column_templates import PoseColumns
from bcapscope.analysis.slave.set_point_table import SetPointTable
from bcapscope.analysis.slave.slave_session import AcceptedFormat, KnownMode
from bcapscope.protocol.slave_mode.poses import Axis
from bcapscope.traffic.observation import Conversation


class SetPointChunk(NamedTuple):
    """Set points that follow each other in one stay, refused ones among them.

    Attributes:
        session_number: number of the stay.
        conversation: whose they are.
        robot: handle of the robot; None where it could not be read.
        mode: as far as it was known at the first set point.
        send_format: accepted send format; None where none was seen.
        receive_format: likewise.
        grid_ms: the period that the client should keep.
        microseconds: unit of the controller's time stamps.
        axes: of the poses; () where no pose could be read.
        table: the calls.
        commanded: poses of the requests, a row a call.
        returned: poses of the same type and time stamps in the replies, a row a call.
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
"""Takes the set points of all stays in, some thousand at a time."""
