"""Clients that fall silent in slave mode: on UDP nothing else tells that they are gone."""

from __future__ import annotations

from collections.abc import Iterable, Iterator

from bcapscope.traffic.observation import Conversation

SILENT_AFTER_NS = 500_000_000
"""ns without a request after which a client in slave mode is told to be silent: some sixty set points at 8 ms
(DENSO Wave 2009, How to use the Slave mode), longer than all eight tries of one."""


class SilenceMonitor:
    """Tells once of each silence, and of its end."""

    def __init__(self) -> None:
        self._silent_since: dict[Conversation, int] = {}

    def check(self, clients: Iterable[tuple[Conversation, int]], now: int) -> Iterator[str]:
        """Yield a sentence for each client that has fallen silent, or speaks again.

        Args:
            clients: those in slave mode, and when each was heard last, ns.
            now: ns; all that was said by then is known.
        """
        here = dict(clients)
        for client in [client for client in self._silent_since if client not in here]:
            del self._silent_since[client]
        for client, heard in here.items():
            since = self._silent_since.get(client)
            if since is None and now - heard > SILENT_AFTER_NS:
                self._silent_since[client] = heard
                yield (
                    f"{client.client} has sent nothing for {(now - heard) / 1e9:.1f} s while slave mode is on"
                )
            elif since is not None and heard > since:
                del self._silent_since[client]
                yield f"{client.client} is heard again, after {(heard - since) / 1e9:.1f} s"
