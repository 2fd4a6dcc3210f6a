"""Set points of a stay as they come, for whoever wants each of them and not only figures."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple, TypeAlias

from bcapscope.analysis.forms import Columns
from bcapscope.analysis.rows import Rows
from bcapscope.analysis.stay import Format, Mode
from bcapscope.protocol.poses import Axis
from bcapscope.traffic.observation import Conversation


class Points(NamedTuple):
    """Set points that follow each other in one stay, refused ones among them.

    Attributes:
        stay: number of the stay.
        conversation: whose they are.
        robot: handle of the robot; None where it could not be read.
        mode: as far as it was known at the first set point.
        send: accepted send format; None where none was seen.
        receive: likewise.
        grid_ms: the period that the client should keep.
        microseconds: unit of the controller's time stamps.
        axes: of the poses; () where no pose could be read.
        rows: the calls.
        commanded: poses of the requests, a row a call.
        returned: poses of the same type and time stamps in the replies, a row a call.
    """

    stay: int
    conversation: Conversation
    robot: int | None
    mode: Mode
    send: Format | None
    receive: Format | None
    grid_ms: float
    microseconds: bool
    axes: tuple[Axis, ...]
    rows: Rows
    commanded: Columns
    returned: Columns


Heed: TypeAlias = Callable[[Points], None]
"""Takes the set points of all stays in, some thousand at a time."""
