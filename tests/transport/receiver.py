"""Somebody who notes what a link tells."""

from __future__ import annotations

import asyncio

from bcapscope.messages import Message


class Notes:
    """Collects what happens, and lets others wait for it."""

    def __init__(self) -> None:
        self.told: asyncio.Queue[tuple[str, bytes | str]] = asyncio.Queue()

    def on_data(self, data: bytes) -> None:
        self.told.put_nowait(("received", data))

    def on_send_error(self, reason: Message) -> None:
        self.told.put_nowait(("trouble", str(reason)))

    def on_link_lost(self, reason: Message) -> None:
        self.told.put_nowait(("lost", str(reason)))
