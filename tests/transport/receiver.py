"""Somebody who notes what a link tells."""

from __future__ import annotations

import asyncio


class Notes:
    """Collects what happens, and lets others wait for it."""

    def __init__(self) -> None:
        self.told: asyncio.Queue[tuple[str, bytes | str]] = asyncio.Queue()

    def received(self, data: bytes) -> None:
        self.told.put_nowait(("received", data))

    def trouble(self, text: str) -> None:
        self.told.put_nowait(("trouble", text))

    def lost(self, reason: str) -> None:
        self.told.put_nowait(("lost", reason))
