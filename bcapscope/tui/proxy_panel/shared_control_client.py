"""A client of the proxy's control socket that several threads can share.

The client's calls block, so the screen's own thread must not make them.
"""

from __future__ import annotations

import threading

import msgspec

from bcapscope.proxy import control_messages as control
from bcapscope.proxy.control_client import ControlClient


class ProxyState(msgspec.Struct, frozen=True):
    """All responses to one poll."""

    clients: list[control.ClientStatus]
    rules: list[control.FaultStatus]
    held: list[control.HeldStatus]
    figures: control.ProxyStats


class SharedControlClient:
    """Sends one request at a time to the proxy, from any thread.

    Methods raise `ControlError` if the proxy does not respond or has another version, and `ControlRefused` if
    the proxy refuses.
    """

    def __init__(self, address: str) -> None:
        self._client = ControlClient(address)
        self._lock = threading.Lock()

    def read_state(self) -> ProxyState:
        with self._lock:
            request = self._client.request
            return ProxyState(
                request(control.ListClients(), control.ClientsResponse).clients,
                request(control.ListFaults(), control.FaultsResponse).rules,
                request(control.ListHeld(), control.HeldResponse).held,
                request(control.GetStats(), control.ProxyStats),
            )

    def send_order(self, order: control.ControlRequest) -> None:
        with self._lock:
            self._client.request(order, control.DoneResponse)

    def close(self) -> None:
        self._client.close()
