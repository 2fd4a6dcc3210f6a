"""A short session of a client, for the tests of simulator and proxy."""

from __future__ import annotations

from bcapscope.client import Blocking, RetryPolicies, connect, over_tcp, over_udp
from bcapscope.protocol.retry.requester import RetryPolicy

_PACE = RetryPolicy(200_000_000, 7)
SESSION = ["Service_Start", "Controller_Connect", "Controller_Disconnect", "Service_Stop"]
"""Functions that the session calls."""


def run_session(host: str, port: int, *, tcp: bool = False) -> None:
    """Connect to a controller and disconnect."""
    with Blocking() as wait:
        opener = (over_tcp if tcp else over_udp)(host, port)
        service = wait.enter(connect(opener, retry_policies=RetryPolicies(others=_PACE)))
        wait(service.connect("", "CaoProv.DENSO.VRC", "localhost"))
