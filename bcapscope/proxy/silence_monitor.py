"""Detects clients that fall silent in slave mode. Over UDP, only silence shows that a client is gone."""

from __future__ import annotations

from collections.abc import Iterable, Iterator

from bcapscope.messages import Message
from bcapscope.traffic.observation import Conversation

SILENT_AFTER_NS = 500_000_000
"""A client in slave mode counts as silent if it sends no request for this time in ns. In this time, a client
that still works sends about 60 set points (DENSO Wave 2009, How to use the Slave mode), or all eight attempts
of a call.
"""


class SilenceMonitor:
    def __init__(self) -> None:
        self._silent_since: dict[Conversation, int] = {}

    def check(self, clients: Iterable[tuple[Conversation, int]], now: int) -> Iterator[Message]:
        """Yield a message for each client that has fallen silent or sends again. `clients` holds the clients
        in slave mode, each with the time of its last request. All times are in ns.
        """
        here = dict(clients)
        for client in [client for client in self._silent_since if client not in here]:
            del self._silent_since[client]
        for client, heard in here.items():
            since = self._silent_since.get(client)
            if since is None and now - heard > SILENT_AFTER_NS:
                self._silent_since[client] = heard
                time = f"{(now - heard) / 1e9:.1f} s"
                yield Message("client.silent.slave-mode", client=str(client.client), time=time)
            elif since is not None and heard > since:
                del self._silent_since[client]
                time = f"{(heard - since) / 1e9:.1f} s"
                yield Message("client.heard-again", client=str(client.client), time=time)
