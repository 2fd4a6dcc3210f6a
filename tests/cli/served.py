"""A screen that is served, as a user runs it, and requests that browsers and others send to it."""

from __future__ import annotations

import asyncio
import http.client
import re
import socket
import subprocess
import sys
import threading
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from pathlib import Path

import aiohttp

from tests.proxy.relaying import eventually

PATIENCE = 30.0
WEBSOCKET = {
    "Connection": "Upgrade",
    "Upgrade": "websocket",
    "Sec-WebSocket-Version": "13",
    "Sec-WebSocket-Key": "dGhlIHNhbXBsZSBub25jZQ==",
}


class Served:
    """`bcapscope tui --serve`.

    Attributes:
        popen: the process.
        entrance: the printed address.
        authority: its host and port.
        base: the path that the entrance leads to, with a slash at the end.
        cookie: the Cookie header that the entrance gives.
    """

    def __init__(self, *words: str | Path, at: str = "127.0.0.1:0") -> None:
        argv = [sys.executable, "-m", "bcapscope", "tui", "--serve", "--serve-at", at, *map(str, words)]
        self.popen = subprocess.Popen(
            argv, stdin=subprocess.DEVNULL, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
        )
        self._said: list[str] = []
        self._readers = [
            threading.Thread(target=lambda pipe=pipe: self._said.extend(pipe), daemon=True)
            for pipe in (self.popen.stdout, self.popen.stderr)
        ]
        for reader in self._readers:
            reader.start()
        eventually(lambda: "Open http" in self.said or self.popen.poll() is not None, "the server")
        found = re.search(r"Open (http://(\S+)/\?token=\S+)", self.said)
        assert found, self.said
        self.entrance, self.authority = found.groups()
        page, headers = self.get(self.entrance.removeprefix(self.origin))[1:]
        self.cookie = headers["Set-Cookie"].partition(";")[0]
        refresh = re.search('url=([^"]+)"', page)
        assert refresh, page
        self.base = refresh[1]

    @property
    def origin(self) -> str:
        """The origin of its pages."""
        return f"http://{self.authority}"

    @property
    def said(self) -> str:
        """What it printed so far."""
        return "".join(self._said)

    def get(
        self, path: str, headers: Mapping[str, str] | None = None
    ) -> tuple[int, str, http.client.HTTPMessage]:
        """Send a GET request; return the status, the body and the headers of the response."""
        connection = http.client.HTTPConnection(self.authority, timeout=PATIENCE)
        try:
            connection.putrequest("GET", path, skip_host=True, skip_accept_encoding=True)
            for name, value in ({"Host": self.authority} | dict(headers or {})).items():
                if value:
                    connection.putheader(name, value)
            connection.endheaders()
            response = connection.getresponse()
            body = b"" if response.status == 101 else response.read()
            return response.status, body.decode(errors="replace"), response.headers
        finally:
            connection.close()

    def children(self) -> list[int]:
        """Return the processes that it started and that are alive."""
        found = []
        for task in Path(f"/proc/{self.popen.pid}/task").iterdir():
            with suppress(OSError):  # a thread that has just ended
                found += [int(pid) for pid in (task / "children").read_text().split()]
        return found

    def end(self, number: int) -> int:
        """Send it a signal; return its exit code."""
        self.popen.send_signal(number)
        return self.popen.wait(PATIENCE)

    def close(self) -> None:
        """Kill it, if it still runs."""
        self.popen.kill()
        self.popen.wait(PATIENCE)
        for reader, pipe in zip(self._readers, (self.popen.stdout, self.popen.stderr), strict=True):
            reader.join(PATIENCE)
            assert pipe is not None
            pipe.close()


@contextmanager
def served(*words: str | Path) -> Iterator[Served]:
    """Run `bcapscope tui --serve` for the length of a block."""
    screen = Served(*words)
    try:
        yield screen
    finally:
        screen.close()


class Viewer:
    """A page that shows the screen.

    Attributes:
        drawn: what it was sent to draw.
        told: messages to the page.
        websocket: its connection.
    """

    def __init__(self, session: aiohttp.ClientSession, websocket: aiohttp.ClientWebSocketResponse) -> None:
        self.drawn = bytearray()
        self.told: list[object] = []
        self.websocket = websocket
        self._session = session
        self._task = asyncio.create_task(self._read(), name="viewer")

    async def _read(self) -> None:
        async for message in self.websocket:
            if message.type is aiohttp.WSMsgType.BINARY:
                self.drawn += message.data
            elif message.type is aiohttp.WSMsgType.TEXT:
                self.told.append(message.json())

    async def sees(self, text: bytes) -> None:
        """Wait until something is drawn."""
        async with asyncio.timeout(PATIENCE):
            while text not in self.drawn:
                assert not self._task.done(), bytes(self.drawn)
                await asyncio.sleep(0.01)

    async def presses(self, keys: str) -> None:
        """Send keys, as a terminal does."""
        await self.websocket.send_json(["stdin", keys])

    async def over(self) -> None:
        """Wait until the server has closed the connection."""
        await asyncio.wait_for(asyncio.shield(self._task), PATIENCE)

    async def vanishes(self) -> None:
        """Break the connection off without a word."""
        self.websocket.get_extra_info("socket").shutdown(socket.SHUT_RDWR)
        await self._session.close()

    async def leaves(self) -> None:
        """Close the connection, as a page does that is closed or loaded again."""
        await self.websocket.close()
        await self._session.close()


async def view(screen: Served, answers_pings: bool = True) -> Viewer:
    """Open the screen as a browser does."""
    session = aiohttp.ClientSession()
    headers = {"Cookie": screen.cookie, "Origin": screen.origin}
    url = f"ws://{screen.authority}{screen.base}ws?width=100&height=30"
    return Viewer(session, await session.ws_connect(url, headers=headers, autoping=answers_pings))
