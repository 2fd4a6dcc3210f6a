"""Messages to the proxy screen from threads that query the proxy or read the proxy's output."""

from __future__ import annotations

from collections.abc import Callable

from textual.message import Message

from bcapscope.tui.proxy_panel.shared_control_client import ProxyState


class ProxyStateRead(Message):
    """The proxy has reported its state; if it did not, `problem` says why."""

    def __init__(self, state: ProxyState | None, problem: str = "") -> None:
        super().__init__()
        self.state, self.problem = state, problem


class OrderDone(Message):
    """The proxy has carried out an order, or refused it with a reason.

    A thread posts this message instead of calling the screen, so that it never waits for a closing screen.

    Attributes:
        callback: Function that the screen's thread must call next.
    """

    def __init__(self, callback: Callable[[], None]) -> None:
        super().__init__()
        self.callback = callback


class ProxyOutput(Message):
    """The proxy printed the line `text`, or ended with `text` as its last output."""

    def __init__(self, text: str, is_end: bool) -> None:
        super().__init__()
        self.text, self.is_end = text, is_end
