"""Asking a proxy how it stands, and telling it what to do: both wait, so the screen's own thread must not."""

from __future__ import annotations

import threading
from collections.abc import Mapping

import msgspec

from bcapscope.proxy.control_answers import Answer, Client, Rule, figures_of, list_of
from bcapscope.proxy.control_client import ControlClient
from bcapscope.proxy.control_socket import ControlError
from bcapscope.tui.proxy.standing import Standing
from bcapscope.tui.words import say


class Asker:
    """Asks one question at a time, whichever thread it is from."""

    def __init__(self, address: str) -> None:
        """Take the address of the proxy's control socket."""
        self._client = ControlClient(address)
        self._lock = threading.Lock()

    def standing(self) -> Standing:
        """Ask how the proxy stands.

        Raises:
            ControlError: it does not answer, or is none of this version.
            ControlRefused: it does not tell.
        """
        with self._lock:
            ask = self._client.ask
            try:
                return Standing(
                    list_of(ask({"do": "clients"}), "clients", Client),
                    list_of(ask({"do": "rules"}), "rules", Rule),
                    self._client.held(),
                    figures_of(ask({"do": "stats"})),
                )
            except msgspec.ValidationError as error:
                raise ControlError(say("proxy.strange")) from error

    def order(self, question: Mapping[str, object]) -> Answer:
        """Have the proxy do something.

        Raises:
            ControlError: it does not answer.
            ControlRefused: it did not do it.
        """
        with self._lock:
            return self._client.ask(question)

    def close(self) -> None:
        """Close the connection."""
        self._client.close()
