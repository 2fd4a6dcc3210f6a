"""A control client for several threads. Its calls block, so the screen's own thread must not make them."""

from __future__ import annotations

import threading
from collections.abc import Mapping

import msgspec

from bcapscope.proxy.control_answers import ClientStatus, ControlAnswer, FaultStatus, parse_list, parse_stats
from bcapscope.proxy.control_client import ControlClient
from bcapscope.proxy.control_socket import ControlError
from bcapscope.tui.proxy_panel.proxy_state import ProxyState
from bcapscope.tui.words import say


class SharedControlClient:
    """Sends one request at a time, from any thread."""

    def __init__(self, address: str) -> None:
        """Store the address of the proxy's control socket."""
        self._client = ControlClient(address)
        self._lock = threading.Lock()

    def read_state(self) -> ProxyState:
        """Query the proxy's state.

        Raises:
            ControlError: The proxy does not answer, or has another version.
            ControlRefused: The proxy refused to answer.
        """
        with self._lock:
            ask = self._client.request
            try:
                return ProxyState(
                    parse_list(ask({"do": "clients"}), "clients", ClientStatus),
                    parse_list(ask({"do": "rules"}), "rules", FaultStatus),
                    self._client.list_held(),
                    parse_stats(ask({"do": "stats"})),
                )
            except msgspec.ValidationError as error:
                raise ControlError(say("proxy.strange")) from error

    def send_order(self, order: Mapping[str, object]) -> ControlAnswer:
        """Send an order to the proxy; return its answer.

        Raises:
            ControlError: The proxy does not answer.
            ControlRefused: The proxy refused the order.
        """
        with self._lock:
            return self._client.request(order)

    def close(self) -> None:
        self._client.close()
