"""The client: sessions with a controller, the controller's objects with typed methods, and a synchronous
wrapper.

    async with connect(over_udp("192.168.0.1")) as service:
        controller = await service.connect("", "CaoProv.DENSO.VRC", "localhost")
        robot = await controller.get_robot("Arm")
        print(await robot.execute("CurJnt"))

When the block ends, all objects that were opened in the block are released, newest first, even after an
error.
"""

from bcapscope.client.blocking import Blocking
from bcapscope.client.controller_target import DEFAULT_RETRY_POLICIES, RetryPolicies
from bcapscope.client.remote_objects import (
    Command,
    Controller,
    ControllerMessage,
    Extension,
    File,
    Robot,
    Service,
    Task,
    Variable,
    connect,
)
from bcapscope.client.session import Session, open_session, over_tcp, over_udp

__all__ = [
    "DEFAULT_RETRY_POLICIES",
    "Blocking",
    "Command",
    "Controller",
    "ControllerMessage",
    "Extension",
    "File",
    "RetryPolicies",
    "Robot",
    "Service",
    "Session",
    "Task",
    "Variable",
    "connect",
    "open_session",
    "over_tcp",
    "over_udp",
]
