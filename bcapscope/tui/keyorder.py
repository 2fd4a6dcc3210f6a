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
from textual.message_pump import MessagePump
from textual.widgets import Input

PATIENCE = 1.0
"""Seconds that keys wait for the one before them, which may have gone to a widget that is no more."""

_MOUNTING = 0.02
"""Seconds from one look at a screen that is being made to the next."""


class Handled(Message):
    """Goes the way of a key, behind it: when this has come to the application, the key is answered."""

    def __init__(self, target: MessagePump, is_second: bool = False) -> None:
        """Take what the key was given to, and whether this goes there for the second time.

        Keys that wait let it: what the key has done there, such as to press a button, goes the same way.
        """
        super().__init__()
        self.target, self.is_second = target, is_second


class KeyOrder(App[None]):
    """An application that answers one key after the other."""

    _behind: Handled | None = None
    _watched: Handled | None = None

    def __init__(self) -> None:
        """Begin with no key pressed."""
        super().__init__()
        self._waiting: deque[Event] = deque()

    async def on_event(self, event: Event) -> None:
        """Let keys, and what is pasted, wait for the key before them; all else, and HALT, goes on."""
        if not isinstance(event, Key | Paste) or event.is_forwarded or self._is_urgent(event):
            await super().on_event(event)
        elif self._behind is None:
            await self._forward(event)
        else:
            self._waiting.append(event)
            self._watch()

    def _is_urgent(self, event: Event) -> bool:
        bindings = self._bindings.key_to_bindings.get(event.key, ()) if isinstance(event, Key) else ()
        return any(binding.priority for binding in bindings)

    async def _forward(self, event: Event) -> None:
        """Give out a key, and those that wait behind it as far as they are letters for the same field."""
        while True:
            target = self.focused or self.screen
            await super().on_event(event)
            if not (isinstance(target, Input) and isinstance(event, Key) and event.is_printable):
                self._follow(Handled(target))
                return
            self._behind = None
            if not self._waiting:
                return
            event = self._waiting.popleft()

    def _follow(self, behind: Handled) -> None:
        self._behind = behind
        if not behind.target.post_message(behind):
            self.call_later(self._go_on, behind)

    @on(Handled)
    def _answered(self, message: Handled) -> None:
        message.stop()
        self.call_later(self._go_on, message)  # behind what the key has put off, such as the focus

    async def _go_on(self, behind: Handled) -> None:
        """Give out the next key, once the screen that the key before has opened is there."""
        if behind is not self._behind:
            return
        if not self._waiting:
            self._behind = None
        elif not behind.is_second:
            self._follow(Handled(behind.target, is_second=True))
        elif not self.screen.is_mounted:
            self.set_timer(_MOUNTING, partial(self._go_on, behind))
        else:
            await self._forward(self._waiting.popleft())

    def _watch(self) -> None:
        """Look after a while whether keys wait for one that will never be answered."""
        if self._watched is None:
            self._watched = self._behind
            self.set_timer(PATIENCE, self._look)

    async def _look(self) -> None:
        is_stuck, self._watched = self._watched is self._behind, None
        if self._waiting:
            if is_stuck:
                await self._forward(self._waiting.popleft())
            self._watch()
