"""Address of a controller and the options for connecting to it."""

from __future__ import annotations

from dataclasses import dataclass

from bcapscope.client.retry_policies import DEFAULT_PORT, DEFAULT_RETRY_POLICIES, RetryPolicies
from bcapscope.messages import Message
from bcapscope.protocol.retry.requester import RetryPolicy
from bcapscope.protocol.retry.reserved_convention import ReservedConvention, client_conventions

DEFAULT_ROBOT = "Arm"
"""Name of the robot on most controllers."""

ROBSLAVE = "RobSlave"
"""Name of the program that must run on an RC7 for slave mode (DENSO Wave 2009, How to use the Slave mode)."""

_MS = 1_000_000


@dataclass(frozen=True, slots=True)
class ControllerTarget:
    """Address of a controller and the options for connecting to it.

    Attributes:
        timeout: Timeout of each attempt, ms, for all calls but slvMove.
        retries: Number of retries, for all calls but slvMove.
        convention: Convention of the reserved field; None for the default.
        service: Option string of Service_Start.
        name: Name of the controller in Controller_Connect, as for `provider`, `machine` and `connect_option`.
    """

    host: str
    port: int = DEFAULT_PORT
    tcp: bool = False
    timeout: float = DEFAULT_RETRY_POLICIES.others.timeout / _MS
    retries: int = DEFAULT_RETRY_POLICIES.others.retries
    convention: ReservedConvention | None = None
    service: str = ""
    name: str = ""
    provider: str = "CaoProv.DENSO.VRC"
    machine: str = "localhost"
    connect_option: str = ""

    @property
    def connect(self) -> tuple[str, str, str, str]:
        return self.name, self.provider, self.machine, self.connect_option

    @property
    def retry_policies(self) -> RetryPolicies:
        return RetryPolicies(others=RetryPolicy(round(self.timeout * _MS), self.retries))

    def convention_for(self, datagrams: bool) -> ReservedConvention:
        """Return the convention of the reserved field over UDP (`datagrams`) or TCP."""
        allowed = client_conventions(datagrams)
        return self.convention if self.convention in allowed else allowed[0]

    @property
    def address(self) -> str:
        """Host and port as text, with an IPv6 address in brackets."""
        host = f"[{self.host}]" if ":" in self.host else self.host
        return f"{host}:{self.port}"

    @property
    def message(self) -> Message:
        return Message("target", address=self.address, transport="TCP" if self.tcp else "UDP")

    def __str__(self) -> str:
        return str(self.message)


def split_host_port(text: str) -> tuple[str, str]:
    """Split ``host:port`` or ``[address]:port``; the port is "" if the text has no port.

    A text with more than one colon and no brackets is an IPv6 address without a port.
    """
    if text.startswith("["):
        host, _, behind = text[1:].partition("]")
        return host, behind.removeprefix(":")
    host, colon, port = text.rpartition(":")
    return (host, port) if colon and ":" not in host else (text, "")
