"""Asking a proxy how it stands, and telling it what to do: both wait, so the screen's own thread must not."""

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
    """Asks one question at a time, whichever thread it is from."""

    def __init__(self, address: str) -> None:
        """Take the address of the proxy's control socket."""
        self._client = ControlClient(address)
        self._lock = threading.Lock()

    def read_state(self) -> ProxyState:
        """Ask how the proxy stands.

        Raises:
            ControlError: it does not answer, or is none of this version.
            ControlRefused: it does not tell.
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
        """Have the proxy do something.

        Raises:
            ControlError: it does not answer.
            ControlRefused: it did not do it.
        """
        with self._lock:
            return self._client.request(order)

    def close(self) -> None:
        """Close the connection."""
        self._client.close()
