"""What threads that ask a proxy, or listen to it, tell its screen."""

from __future__ import annotations

from collections.abc import Callable

from textual.message import Message

from bcapscope.tui.proxy_panel.proxy_state import ProxyState


class ProxyStateRead(Message):
    """The proxy has told how it stands, or why it does not answer."""

    def __init__(self, state: ProxyState | None, problem: str = "") -> None:
        super().__init__()
        self.state, self.problem = state, problem


class OrderDone(Message):
    """The proxy has done what it was told, or said why not.

    A message and no call, since the thread that asked must not wait for a screen that is being closed.

    Attributes:
        callback: what is to be done in the screen's thread.
    """

    def __init__(self, callback: Callable[[], None]) -> None:
        super().__init__()
        self.callback = callback


class ProxyOutput(Message):
    """The proxy said something, or ended; then `text` are its last words."""

    def __init__(self, text: str, is_end: bool) -> None:
        super().__init__()
        self.text, self.is_end = text, is_end
