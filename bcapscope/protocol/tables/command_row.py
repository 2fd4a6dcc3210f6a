"""The row type of the command tables, and the names of their sources."""

from __future__ import annotations

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
"""Controllers that a row may name."""


class CommandRow(NamedTuple):
    """One command, or several commands that share one description.

    Attributes:
        names: Names of the commands, separated by blanks.
        parameter: Accepted types of the parameter, in the short notation of `command_table`.
        result: Types of the result, in the same notation.
        text: What the command does, one clause.
        effect: Strongest effect that the command can have.
        source: Source in which the command was found.
        elements: Meaning of the elements of the parameter, in order; else empty.
        returns: Meaning of the result; else empty.
        in_slave_mode: Whether the controller accepts the command in slave mode; None if no source says.
        controllers: Controllers that have the command, if known; else empty.
    """

    names: str
    parameter: str
    result: str
    text: str
    effect: CallEffect
    source: str
    elements: str = ""
    returns: str = ""
    in_slave_mode: bool | None = None
    controllers: str = ""
