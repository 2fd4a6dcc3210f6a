"""Keys in their order: each goes where the one before has left the focus.

Textual gives a key to what has the focus when it is read, and answers it later, after it has gone from that
widget through all that hold it. Of `/` and letters that come in one packet, as fast typists, pastes and
terminals far away send them, all would go to the list, and none to the field that `/` opens.
"""

from __future__ import annotations

from collections import deque
from functools import partial

from textual import on
from textual.app import App
from textual.events import Event, Key, Paste
from textual.message import Message

PATIENCE = 1.0
"""Seconds that keys wait for the one before them, which may have gone to a widget that is no more."""

_MOUNTING = 0.02
"""Seconds from one look at a screen that is being made to the next."""


class Handled(Message):
    """Goes the way of a key, behind it: when this has come to the application, the key is answered."""


class KeyOrder(App[None]):
    """An application that answers one key after the other."""

    _behind: Handled | None = None

    def __init__(self) -> None:
        """Begin with no key pressed."""
        super().__init__()
        self._waiting: deque[Event] = deque()

    async def on_event(self, event: Event) -> None:
        """Let keys, and what is pasted, wait for the key before them; all else goes on."""
        if not isinstance(event, Key | Paste) or event.is_forwarded:
            await super().on_event(event)
        elif self._behind is None:
            await self._forward(event)
        else:
            self._waiting.append(event)
            if len(self._waiting) == 1:
                self._limit(self._behind)

    async def _forward(self, event: Event) -> None:
        behind, target = Handled(), self.focused or self.screen
        self._behind = behind
        await super().on_event(event)
        if not target.post_message(behind):
            self.call_later(self._go_on, behind)
        elif self._waiting:
            self._limit(behind)

    def _limit(self, behind: Handled) -> None:
        self.set_timer(PATIENCE, partial(self._go_on, behind, True))

    @on(Handled)
    def _answered(self, message: Handled) -> None:
        message.stop()
        self.call_later(self._go_on, message)  # behind what the key has put off, such as the focus

    async def _go_on(self, behind: Handled, at_last: bool = False) -> None:
        """Give out the next key, once the screen that the key before has opened is there."""
        if behind is not self._behind:
            return
        if self._waiting and not at_last and not self.screen.is_mounted:
            self.set_timer(_MOUNTING, partial(self._go_on, behind))
            return
        self._behind = None
        if self._waiting:
            await self._forward(self._waiting.popleft())
