"""Handles keys one after the other: only when a key is handled, the widget for the next one is chosen.

Without this module, Textual chooses the widget for a key as soon as Textual reads the key, although an
earlier key may still move the focus. For example, `/` opens an input field. If the user types fast or pastes
text, or if the terminal is remote, `/` and the next letters can arrive together. Textual would then deliver
the letters to the widget that had the focus before `/`, and not to the input field.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass
from functools import partial

from textual import on
from textual.app import App
from textual.binding import Binding
from textual.events import Event, Key, Paste
from textual.message import Message
from textual.message_pump import MessagePump
from textual.widgets import Input

STUCK_AFTER = 1.0
"""Maximum time in seconds that a key waits for the previous key to be handled."""

_MOUNT_POLL_INTERVAL = 0.02  # seconds


@dataclass
class KeyHandled(Message):
    """A message that the application posts to a widget after a key. A widget handles messages in order, so
    `KeyHandled` arrives after the widget has handled the key. A second `KeyHandled` (`is_second`) arrives
    after the widgets have handled all events that the key caused.
    """

    target: MessagePump
    is_second: bool = False


class KeyOrderApp(App[None]):
    _pending: KeyHandled | None = None
    _watched_key: KeyHandled | None = None

    def __init__(self) -> None:
        super().__init__()
        self._queued_events: deque[Event] = deque()
        self._urgent_keys = {each.key for each in Binding.make_bindings(self.BINDINGS) if each.priority}

    async def on_event(self, event: Event) -> None:
        """Delay keys and pasted text until the previous key is handled, except urgent keys such as HALT."""
        is_urgent = isinstance(event, Key) and event.key in self._urgent_keys
        if not isinstance(event, Key | Paste) or event.is_forwarded or is_urgent:
            await super().on_event(event)
        elif self._pending is None:
            await self._deliver_event(event)
        else:
            self._queued_events.append(event)
            self._start_stuck_timer()

    async def _deliver_event(self, event: Event) -> None:
        """Deliver an event. After a printable key for an input field, also deliver the next event at once."""
        while True:
            target = self.focused or self.screen
            await super().on_event(event)
            if not (isinstance(target, Input) and isinstance(event, Key) and event.is_printable):
                self._post_marker(KeyHandled(target))
                return
            self._pending = None
            if not self._queued_events:
                return
            event = self._queued_events.popleft()

    def _post_marker(self, marker: KeyHandled) -> None:
        self._pending = marker
        if not marker.target.post_message(marker):
            self.call_later(self._deliver_next, marker)

    @on(KeyHandled)
    def _marker_returned(self, message: KeyHandled) -> None:
        # the callbacks that this key scheduled, such as a change of focus, run before the next key
        self.call_later(self._deliver_next, message)

    async def _deliver_next(self, marker: KeyHandled) -> None:
        """Deliver the next key. If the previous key opened a screen, wait until this screen is mounted."""
        if marker is not self._pending:
            return
        if not self._queued_events:
            self._pending = None
        elif not marker.is_second:
            self._post_marker(KeyHandled(marker.target, is_second=True))
        elif not self.screen.is_mounted:
            self.set_timer(_MOUNT_POLL_INTERVAL, partial(self._deliver_next, marker))
        else:
            await self._deliver_event(self._queued_events.popleft())

    def _start_stuck_timer(self) -> None:
        """After `STUCK_AFTER` seconds, deliver a waiting key even if the previous key was never handled."""
        if self._watched_key is None:
            self._watched_key = self._pending
            self.set_timer(STUCK_AFTER, self._deliver_if_stuck)

    async def _deliver_if_stuck(self) -> None:
        is_stuck, self._watched_key = self._watched_key is self._pending, None
        if self._queued_events:
            if is_stuck:
                await self._deliver_event(self._queued_events.popleft())
            self._start_stuck_timer()
