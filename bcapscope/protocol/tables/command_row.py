"""One row of the tables of commands, and where rows come from."""

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
    """One command, or several that are used alike.

    Attributes:
        names: separated by blanks.
        parameter: accepted types.
        result: types of the result.
        text: what it does, one clause.
        effect: the most that it can do.
        source: where it was seen.
        elements: what a parameter with several elements holds, in order; else empty.
        returns: what the result holds; else empty.
        in_slave_mode: accepted while slave mode is on, refused, or None where nobody says.
        controllers: those that have it where that is known; else empty.
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
