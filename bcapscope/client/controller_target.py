"""A controller, how to reach it, and what to say to it first."""

from __future__ import annotations

import os
from dataclasses import dataclass

from bcapscope.client.retry_policies import DEFAULT_PORT, DEFAULT_RETRY_POLICIES, RetryPolicies
from bcapscope.protocol.retry.requester import RetryPolicy
from bcapscope.protocol.retry.reserved_convention import ReservedConvention

_MS = 1_000_000


@dataclass(frozen=True, slots=True)
class ControllerTarget:
    """A controller, how to reach it, and what to say to it first.

    Attributes:
        host: name or address.
        port: UDP or TCP.
        tcp: TCP instead of UDP.
        timeout: of each try, ms, for all calls but slvMove.
        retries: after the first try, likewise.
        convention: of reserved; None for the usual one.
        service: option of Service_Start.
        connect: name, provider, machine and option of Controller_Connect.
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
        """The four arguments of Controller_Connect."""
        return self.name, self.provider, self.machine, self.connect_option

    @property
    def retry_policies(self) -> RetryPolicies:
        """How long to wait and how often to ask again."""
        return RetryPolicies(others=RetryPolicy(round(self.timeout * _MS), self.retries))

    def __str__(self) -> str:
        host = f"[{self.host}]" if ":" in self.host else self.host
        return f"{host}:{self.port} over {'TCP' if self.tcp else 'UDP'}"


def split_host_port(text: str) -> tuple[str, str]:
    """Split ``host:port``, ``[address]:port`` or either without a port, which is empty then.

    More than one colon without brackets is an address of IPv6, which has no port.
    """
    if text.startswith("["):
        host, _, behind = text[1:].partition("]")
        return host, behind.removeprefix(":")
    host, colon, port = text.rpartition(":")
    return (host, port) if colon and ":" not in host else (text, "")


def os_error_text(error: OSError) -> str:
    """Return what went wrong on the way to a controller, without what asyncio says around it."""
    if isinstance(error, TimeoutError):
        return "no answer"
    if error.errno is not None and error.errno > 0:
        return os.strerror(error.errno).lower()
    return str(error.strerror or error).lower()
