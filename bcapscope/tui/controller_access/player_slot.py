"""The player that is at work, if any: HALT and the end of the screen reach it."""

from __future__ import annotations

import asyncio

from bcapscope.player.player_messages import PlayEnded, PlayerMessage, PlayPlan
from bcapscope.player.player_process import PlayerProcess

POLL_SECONDS = 0.1
"""Seconds that one look for messages takes at most."""


class PlayerSlot:
    """Has room for one player."""

    def __init__(self) -> None:
        """Begin without one."""
        self._player: PlayerProcess | None = None
        self._ended: PlayEnded | None = None
        self._read_lock = asyncio.Lock()

    @property
    def is_playing(self) -> bool:
        """Whether a player is at work."""
        return self._player is not None

    async def start_player(self, plan: PlayPlan) -> None:
        """Start a player.

        Raises:
            OSError: that cannot be done.
        """
        assert self._player is None
        self._ended = None
        self._player = await asyncio.to_thread(PlayerProcess, plan)

    async def next_messages(self) -> list[PlayerMessage]:
        """Wait a little for messages, and return those that have come.

        The last one is how the player ended, even where somebody else has ended it.
        """
        async with self._read_lock:
            if self._player is not None:
                return await asyncio.to_thread(self._player.wait_for_messages, POLL_SECONDS)
        await asyncio.sleep(POLL_SECONDS)
        return [] if self._ended is None else [self._ended]

    def answer_question(self, choice: str) -> None:
        """Answer the question that was asked last."""
        if self._player is not None:
            self._player.answer(choice)

    def stop(self) -> None:
        """Let the robot come to rest on its way, then leave in order."""
        if self._player is not None:
            self._player.stop()

    def halt(self) -> bool:
        """Stop the robot at once; return whether a player is at work. From any thread; returns at once."""
        player = self._player
        if player is not None:
            player.halt()
        return player is not None

    async def end_player(self) -> None:
        """Stop the player if it is at work, in order, and wait until it is gone."""
        player, self._player = self._player, None
        if player is not None:
            player.stop()
            async with self._read_lock:
                self._ended = await asyncio.to_thread(player.close)
