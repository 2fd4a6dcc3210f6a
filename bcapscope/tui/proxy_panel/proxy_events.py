"""Messages to the proxy screen from threads that query the proxy or read its output."""

from __future__ import annotations

from collections.abc import Callable

from textual.message import Message

from bcapscope.tui.proxy_panel.shared_control_client import ProxyState


class ProxyStateRead(Message):
    """The proxy has reported its state, or why it does not answer."""

    def __init__(self, state: ProxyState | None, problem: str = "") -> None:
        super().__init__()
        self.state, self.problem = state, problem


class OrderDone(Message):
    """The proxy has carried out an order, or refused it with a reason.

    This is a message, not a call: the thread must not wait for a screen that is being closed.

    Attributes:
        callback: What the screen's thread must do next.
    """

    def __init__(self, callback: Callable[[], None]) -> None:
        super().__init__()
        self.callback = callback


class ProxyOutput(Message):
    """The proxy printed a line, or ended; then `text` is its last output."""

    def __init__(self, text: str, is_end: bool) -> None:
        super().__init__()
        self.text, self.is_end = text, is_end
