"""Other web pages and other users of this machine try to open the screen that `tui --serve` shows.

They send requests with foreign Origin and Host headers and without the token, and open connections that say
nothing. Every request must be refused with 403 and start no screen. The viewer who is connected keeps
working: the HALT key reaches the controller, and the page can be loaded again.
"""

from __future__ import annotations

import asyncio
import resource
import tempfile
import time
from collections.abc import Callable, Coroutine, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path

from tests.cli.proxying import Process
from tests.cli.served import PATIENCE, WEBSOCKET, Served, Viewer, served, view
from tests.security.harness import HonestClient, MemoryWatch, Outcome, RoundTrips, halt_delay

F5, F12 = "\x1b[15~", "\x1b[24~"

PAGE_LIMIT = 1.0
"""Seconds within which the viewer's page can be loaded again."""

_AT_ONCE = 32
_REFUSED = b"HTTP/1.1 403 "


def _foreign(screen: Served) -> Iterator[bytes]:
    """Yield requests that must be refused, again and again."""
    own = {"Host": screen.authority, "Cookie": screen.cookie}
    page, websocket = screen.base, f"{screen.base}ws"
    evil, neighbour = "https://evil.example", "http://127.0.0.1:9"
    kinds: tuple[tuple[str, Mapping[str, str]], ...] = (
        (page, own | {"Origin": evil}),
        (page, own | {"Host": "evil.example"}),
        (page, own | {"Cookie": ""}),
        (page, own | {"Sec-Fetch-Site": "cross-site"}),
        (f"{page}static/js/textual.js", own | {"Origin": "null"}),
        (f"{page}static/js/textual.js", own | {"Host": f"localhost:{screen.authority.rpartition(':')[2]}"}),
        (f"{page}static/js/textual.js", own | {"Cookie": "bcapscope=guess"}),
        (websocket, own | WEBSOCKET),
        (websocket, own | WEBSOCKET | {"Origin": neighbour}),
        (websocket, own | WEBSOCKET | {"Origin": screen.origin, "Host": "evil.example"}),
        (websocket, own | WEBSOCKET | {"Origin": screen.origin, "Cookie": ""}),
        ("/ws", own | WEBSOCKET | {"Origin": screen.origin}),
        ("/?token=guess", own),
        ("/", own),
        ("/download/guess", own),
    )
    while True:
        for path, headers in kinds:
            lines = [
                f"GET {path} HTTP/1.1",
                *(f"{name}: {value}" for name, value in headers.items() if value),
            ]
            yield "\r\n".join((*lines, "", "")).encode()


async def _refused(screen: Served, request: bytes) -> None:
    host, port = screen.authority.split(":")
    reader, writer = await asyncio.open_connection(host, int(port))
    try:
        writer.write(request)
        status = await asyncio.wait_for(reader.readline(), PATIENCE)
        assert status.startswith(_REFUSED), (request, status)
    finally:
        writer.close()


async def _ask(screen: Served, count: int) -> None:
    """Send requests that must be refused, several at a time."""
    requests = _foreign(screen)
    left = count

    async def work() -> None:
        nonlocal left
        while left > 0:
            left -= 1
            await _refused(screen, next(requests))

    await asyncio.gather(*(work() for _ in range(_AT_ONCE)))


async def _keep_silent(screen: Served, count: int) -> list[asyncio.StreamWriter]:
    """Open connections that say nothing, or not all of a request."""
    host, port = screen.authority.split(":")
    writers = []
    for index in range(count):
        _, writer = await asyncio.open_connection(host, int(port))
        if index % 2:
            writer.write(b"GET / HTTP/1.1\r\nHost: ")
        writers.append(writer)
    return writers


class _Stage:
    """A simulator, a served Tester that is connected to it, and what is measured."""

    def __init__(self, sim: Process, log: Path, screen: Served) -> None:
        self.sim = sim
        self.screen = screen
        self._log = log

    async def connect(self) -> Viewer:
        """Open the Tester and connect it to the simulator."""
        viewer = await view(self.screen)
        await viewer.sees(b"not connected")
        await viewer.presses(F5)
        await self._logged("Controller_GetRobot", "")
        return viewer

    async def halt(self, viewer: Viewer) -> float:
        """Press HALT; return the seconds until the controller has logged it."""
        before = self._log.read_text()
        began = time.perf_counter()
        await viewer.presses(F12)
        await self._logged("Robot_Halt", before)
        return time.perf_counter() - began

    async def load_again(self) -> float:
        """Load the page; return the seconds until it was loaded."""
        began = time.perf_counter()
        status = (await asyncio.to_thread(self.screen.get, self.screen.base, {"Cookie": self.screen.cookie}))[
            0
        ]
        assert status == 200
        return time.perf_counter() - began

    async def _logged(self, text: str, before: str) -> None:
        async with asyncio.timeout(PATIENCE):
            while self._log.read_text().count(text) <= before.count(text):
                await asyncio.sleep(0.002)


@contextmanager
def _stage() -> Iterator[_Stage]:
    with tempfile.TemporaryDirectory() as folder:
        log = Path(folder) / "calls"
        with log.open("wb") as stdout:
            sim = Process(["sim", "--port", "0"], stdout.fileno())
        try:
            with served("127.0.0.1", "-p", f"{sim.port}") as screen:
                yield _Stage(sim, log, screen)
        finally:
            sim.close()


async def _measured(
    attack: Callable[[], Coroutine[None, None, None]], client: HonestClient, seconds: float
) -> RoundTrips:
    """Measure the honest client while an attack goes on."""
    stopping = False

    async def go_on() -> None:
        while not stopping:
            await attack()

    task = asyncio.create_task(go_on(), name="attack")
    try:
        return await asyncio.to_thread(client.measure, seconds)
    finally:
        stopping = True
        await task


async def _attack(stage: _Stage, client: HonestClient, requests: int, silent: int, seconds: float) -> Outcome:
    watch = MemoryWatch(stage.screen.popen.pid)
    try:
        viewer = await stage.connect()
        children = stage.screen.children()
        quiet = await asyncio.to_thread(client.measure, seconds)
        writers = await _keep_silent(stage.screen, silent)
        attacked = await _measured(lambda: _ask(stage.screen, requests), client, seconds)
        halt = {each: await asyncio.to_thread(halt_delay, stage.sim.port, each) for each in ("tcp", "udp")}
        halt["browser"] = await stage.halt(viewer)
        page = await stage.load_again()
        assert page < PAGE_LIMIT, f"the page took {page:.1f} s"
        assert stage.screen.children() == children, "a request that was refused has started a screen"
        watch.sample()
        for writer in writers:
            writer.close()
        await viewer.leaves()
    finally:
        watch.close()
    assert "Traceback" not in stage.screen.said, stage.screen.said[-3000:]
    return Outcome("foreign origins", quiet, attacked, halt, watch.peak)


def foreign_origins(requests: int, silent: int, seconds: float) -> Outcome:
    """Attack a served screen.

    Args:
        requests: sent again and again, so many at a time.
        silent: connections that stay open without a request.
        seconds: how long the honest client of the simulator is measured, each time.

    Raises:
        AssertionError: a request was answered, a limit was exceeded, or the viewer was held up.
    """
    with _stage() as stage:
        client = HonestClient(stage.sim.port, "udp")
        try:
            outcome = asyncio.run(_attack(stage, client, requests, silent, seconds))
        finally:
            client.close()
    print(outcome.line, flush=True)
    outcome.check()
    return outcome


def main() -> None:
    """Run the attack at full size."""
    hard = resource.getrlimit(resource.RLIMIT_NOFILE)[1]
    resource.setrlimit(resource.RLIMIT_NOFILE, (min(hard, 8192) if hard > 0 else 8192, hard))
    foreign_origins(requests=300, silent=2000, seconds=10.0)


if __name__ == "__main__":
    main()
