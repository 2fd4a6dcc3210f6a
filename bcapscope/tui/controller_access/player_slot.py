"""Holds the running player, if there is one, so that HALT and the end of the screen can reach the player."""

from __future__ import annotations

import asyncio

from bcapscope.player.player_messages import PlayEnded, PlayerMessage, PlayPlan
from bcapscope.player.player_process import PlayerProcess

POLL_SECONDS = 0.1
"""Maximum time in seconds of one poll for the player's messages."""


class PlayerSlot:
    """Holds at most one player."""

    def __init__(self) -> None:
        self._player: PlayerProcess | None = None
        self._ended: PlayEnded | None = None
        self._read_lock = asyncio.Lock()

    @property
    def is_playing(self) -> bool:
        return self._player is not None

    async def start_player(self, plan: PlayPlan) -> None:
        """Start a player; raises `OSError` if its process cannot be started."""
        assert self._player is None
        self._ended = None
        self._player = await asyncio.to_thread(PlayerProcess, plan)

    async def next_messages(self) -> list[PlayerMessage]:
        """Wait at most `POLL_SECONDS` seconds for messages of the player, and return those that arrived.

        The last message of a player says how the run ended, even if another caller ended the run.
        """
        async with self._read_lock:
            if self._player is not None:
                return await asyncio.to_thread(self._player.wait_for_messages, POLL_SECONDS)
        await asyncio.sleep(POLL_SECONDS)
        return [] if self._ended is None else [self._ended]

    def answer_question(self, choice: str) -> None:
        if self._player is not None:
            self._player.answer(choice)

    def stop(self) -> None:
        """Tell the player to bring the robot to rest on its path, and then to end in order."""
        if self._player is not None:
            self._player.stop()

    def halt(self) -> bool:
        """Stop the robot without waiting; return whether a player is running. Any thread may call this."""
        player = self._player
        if player is not None:
            player.halt()
        return player is not None

    async def end_player(self) -> None:
        """If a player is running, stop it in order and wait until it has ended."""
        player, self._player = self._player, None
        if player is not None:
            player.stop()
            async with self._read_lock:
                self._ended = await asyncio.to_thread(player.close)
