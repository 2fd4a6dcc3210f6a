"""The process that draws the screen for one viewer, and the limit on the number of viewers."""

from __future__ import annotations

import asyncio
import subprocess
from asyncio.subprocess import Process
from collections.abc import AsyncIterator, Awaitable, Callable, Sequence
from contextlib import asynccontextmanager, suppress

from textual_serve.app_service import AppService
from textual_serve.download_manager import DownloadManager

ENDS_WITHIN = 13.0
"""Seconds for a screen process to end before the server kills it; longer than `tui.app.CLOSE_TIMEOUT`."""

RELOAD_WITHIN = 2.0
"""Seconds that a new viewer waits for another to disconnect, such as the same viewer who reloads the page."""

_KILLED_WITHIN = 2.0


class NoSeat(Exception):
    """The maximum number of viewers is already connected."""


class ViewerSeats:
    """Limits the number of viewers. `ending` is the number of screen processes that are ending."""

    def __init__(self, count: int) -> None:
        self._free = asyncio.Semaphore(count)
        self.ending = 0

    @asynccontextmanager
    async def taken(self) -> AsyncIterator[None]:
        """Count one more viewer during the `with` block, or raise `NoSeat`."""
        if not await self._acquire(RELOAD_WITHIN) and not (
            self.ending and await self._acquire(ENDS_WITHIN + _KILLED_WITHIN)
        ):
            raise NoSeat
        try:
            yield
        finally:
            self._free.release()

    async def _acquire(self, seconds: float) -> bool:
        with suppress(TimeoutError):
            async with asyncio.timeout(seconds):
                return await self._free.acquire()
        return False


class ScreenProcess(AppService):
    """A `bcapscope tui` process that draws the screen through a websocket. The process runs in a separate
    process group, so that Ctrl-C reaches only the parent. The parent ends the screen process cleanly, so that
    the screen can release the robot.
    """

    def __init__(
        self,
        argv: Sequence[str],
        write_bytes: Callable[[bytes], Awaitable[None]],
        write_str: Callable[[str], Awaitable[None]],
        close: Callable[[], Awaitable[object]],
    ) -> None:
        """`write_bytes` sends drawing data to the page, and `write_str` sends messages. Neither function may
        raise an exception: the server would stop reading the output of the screen process, and the screen
        process would block.
        """
        super().__init__(
            subprocess.list2cmdline(argv),
            write_bytes=write_bytes,
            write_str=write_str,
            close=close,  # type: ignore[arg-type]  # textual-serve ignores the result of `close`
            download_manager=DownloadManager(),
        )
        self._argv = tuple(argv)

    async def _open_app_process(self, width: int = 80, height: int = 24) -> Process:
        """Start the command without the shell of textual-serve, which would not forward signals."""
        self._process = process = await asyncio.create_subprocess_exec(
            *self._argv,
            stdin=asyncio.subprocess.PIPE,
            stdout=asyncio.subprocess.PIPE,
            stderr=asyncio.subprocess.PIPE,
            env=self._build_environment(width, height),
            start_new_session=True,
        )
        self._stdin = process.stdin
        return process

    async def wait_until_ended(self) -> None:
        if self._process is not None:
            await self._process.wait()

    async def stop(self) -> None:
        """End the process cleanly; kill it if ending takes longer than `ENDS_WITHIN` seconds."""
        task, self._task = self._task, None
        process = self._process
        if task is None or process is None:
            return
        try:
            async with asyncio.timeout(ENDS_WITHIN):
                await self.send_meta({"type": "quit"})
                await process.wait()
        except TimeoutError:
            with suppress(ProcessLookupError):
                process.kill()
            await process.wait()
        with suppress(TimeoutError):  # a child of the killed process may still hold the output open
            async with asyncio.timeout(_KILLED_WITHIN):
                await task
