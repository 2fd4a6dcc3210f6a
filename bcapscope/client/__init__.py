"""The client: sessions with a controller, its objects with typed methods, and a synchronous wrapper."""

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
