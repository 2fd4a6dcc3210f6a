"""Talking to a controller: sessions, objects with the functions as typed methods, and a face without async.

    async with connect(over_udp("192.168.0.1")) as service:
        controller = await service.connect("", "CaoProv.DENSO.VRC", "localhost")
        robot = await controller.get_robot("Arm")
        print(await robot.execute("CurJnt"))

What was opened is let go at the end of the block, newest first, however it ends.
"""

from bcapscope.client.blocking import Blocking
from bcapscope.client.remote_objects import (
    Command,
    Controller,
    Extension,
    File,
    Message,
    Robot,
    Task,
    Variable,
)
from bcapscope.client.retry_policies import DEFAULT_RETRY_POLICIES, RetryPolicies
from bcapscope.client.service import Service, connect
from bcapscope.client.session import Session, open_session, over_link, over_tcp, over_udp

__all__ = [
    "DEFAULT_RETRY_POLICIES",
    "Blocking",
    "Command",
    "Controller",
    "Extension",
    "File",
    "Message",
    "RetryPolicies",
    "Robot",
    "Service",
    "Session",
    "Task",
    "Variable",
    "connect",
    "open_session",
    "over_link",
    "over_tcp",
    "over_udp",
]
