"""The row type of the command tables, and the names of their sources."""

from __future__ import annotations

from functools import partial
from typing import NamedTuple

from bcapscope.protocol.tables.call_effect import CallEffect

SLIDES = "DENSO Wave 2009, How to use the Slave mode"
SAMPLES = "ShoheiKobata/orin_bcap_python_samples"
ROS = "DENSORobot/denso_robot_ros2 denso_robot_core/src/denso_robot.cpp"
DRIVER = "DENSORobot/denso_robot_ros2 denso_robot_core/src/denso_controller.cpp"
NKAWA = "nkawa/Denso_CobottaPro900_MQTT_Control"
JSK = "start-jsk/denso denso_controller/src/main.cpp"
OTHER = "public robot code outside DENSO"
COBOTTA_ROS = "DENSORobot/denso_cobotta_ros"
BRIDGES = "public ROS bridges of COBOTTA"

COBOTTA, COBOTTA_PRO = "COBOTTA", "COBOTTA PRO"
"""Controllers that a row of the command tables may name."""


class CommandRow(NamedTuple):
    """A row of the command tables: one command, or several commands with a common description.

    Attributes:
        effect: Strongest effect that the command can have.
        signature: Names of the commands, accepted types of the parameter, and types of the result, such as
            `TakeArmState: I4 -> I4`.
        text: What the command does, one clause.
        source: Source in which the command was found.
        elements: Meaning of the elements of the parameter in order; empty if unknown.
        returns: Meaning of the result; empty if unknown.
        in_slave_mode: Whether the controller accepts the command in slave mode; None if no source says.
        controllers: Controllers that have the command; empty if unknown.
    """

    effect: CallEffect
    signature: str
    text: str
    source: str
    elements: str = ""
    returns: str = ""
    in_slave_mode: bool | None = None
    controllers: str = ""


reads = partial(CommandRow, CallEffect.READS)
changes = partial(CommandRow, CallEffect.CHANGES)
energises = partial(CommandRow, CallEffect.ENERGISES)
moves = partial(CommandRow, CallEffect.MOVES)
