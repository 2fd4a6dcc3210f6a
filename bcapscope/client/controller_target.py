"""How to reach a controller: its address, options for the connection, timeouts, and numbers of retries."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

from bcapscope.messages import Message
from bcapscope.protocol.retry.requester import RetryPolicy
from bcapscope.protocol.retry.reserved_convention import ReservedConvention, client_conventions

DEFAULT_ROBOT = "Arm"
"""Name of the robot on most controllers."""

ROBSLAVE = "RobSlave"
"""Name of the program that must run on an RC7 for slave mode (DENSO Wave 2009, How to use the Slave mode)."""

_MS = 1_000_000

DEFAULT_PORT = 5007
"""Port on which controllers listen (orin_bcap C/include/bcap_common.h)."""


class RetryPolicies(NamedTuple):
    """Timeouts and numbers of retries (DENSO Wave 2009, How to use the Slave mode).

    `asynchronous` is for slvMove in an Async mode. A set point then has no retry, because the next set point
    follows soon. `sync` is for slvMove in all modes except the Async modes. Its eight attempts together take
    two cycle times. `others` is for all calls except slvMove.
    """

    others: RetryPolicy = RetryPolicy(1000 * _MS, 4)
    sync: RetryPolicy = RetryPolicy(2 * _MS, 7)
    asynchronous: RetryPolicy = RetryPolicy(2 * _MS, 0)


DEFAULT_RETRY_POLICIES = RetryPolicies()

DEFAULT_TIMEOUT_MS = DEFAULT_RETRY_POLICIES.others.timeout / _MS
DEFAULT_RETRIES = DEFAULT_RETRY_POLICIES.others.retries

OTHERS_IN_ASYNC_MODE = RetryPolicy(1000 * _MS, 3)
"""Retry policy that DENSO recommends in an Async mode for all calls except slvMove."""


@dataclass(frozen=True, slots=True)
class ControllerTarget:
    """Address of a controller and the options for connecting to it.

    Attributes:
        timeout: Timeout in ms of each attempt, for all calls except slvMove.
        retries: Maximum number of retries, for all calls except slvMove.
        convention: Convention of the reserved field; None for the default convention of the transport.
        service: Option string that is sent with Service_Start.
        name: Argument of Controller_Connect, as are `provider`, `machine` and `connect_option`.
    """

    host: str
    port: int = DEFAULT_PORT
    tcp: bool = False
    timeout: float = DEFAULT_TIMEOUT_MS
    retries: int = DEFAULT_RETRIES
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
        """`datagrams` is True for UDP and False for TCP."""
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
