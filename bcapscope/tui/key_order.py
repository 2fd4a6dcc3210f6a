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

STUCK_AFTER = 1.0
"""Seconds that keys wait for the one before them, which may have gone to a widget that is no more."""

_MOUNT_POLL_INTERVAL = 0.02
"""Seconds from one look at a screen that is being made to the next."""


class KeyHandled(Message):
    """Goes the way of a key, behind it: when this has come to the application, the key is answered."""

    def __init__(self, target: MessagePump, is_second: bool = False) -> None:
        """Take what the key was given to, and whether this goes there for the second time.

        Keys that wait let it: what the key has done there, such as to press a button, goes the same way.
        """
        super().__init__()
        self.target, self.is_second = target, is_second


class KeyOrderApp(App[None]):
    """An application that answers one key after the other."""

    _pending: KeyHandled | None = None
    _watched_key: KeyHandled | None = None

    def __init__(self) -> None:
        """Begin with no key pressed."""
        super().__init__()
        self._queued_events: deque[Event] = deque()

    async def on_event(self, event: Event) -> None:
        """Let keys, and what is pasted, wait for the key before them; all else, and HALT, goes on."""
        if not isinstance(event, Key | Paste) or event.is_forwarded or self._is_urgent(event):
            await super().on_event(event)
        elif self._pending is None:
            await self._deliver_event(event)
        else:
            self._queued_events.append(event)
            self._start_stuck_timer()

    def _is_urgent(self, event: Event) -> bool:
        bindings = self._bindings.key_to_bindings.get(event.key, ()) if isinstance(event, Key) else ()
        return any(binding.priority for binding in bindings)

    async def _deliver_event(self, event: Event) -> None:
        """Give out a key, and those that wait behind it as far as they are letters for the same field."""
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
        message.stop()
        self.call_later(self._deliver_next, message)  # behind what the key has put off, such as the focus

    async def _deliver_next(self, marker: KeyHandled) -> None:
        """Give out the next key, once the screen that the key before has opened is there."""
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
        """Look after a while whether keys wait for one that will never be answered."""
        if self._watched_key is None:
            self._watched_key = self._pending
            self.set_timer(STUCK_AFTER, self._deliver_if_stuck)

    async def _deliver_if_stuck(self) -> None:
        is_stuck, self._watched_key = self._watched_key is self._pending, None
        if self._queued_events:
            if is_stuck:
                await self._deliver_event(self._queued_events.popleft())
            self._start_stuck_timer()
