"""The screen in a browser: who may open it, how many at a time, and how it ends."""

from __future__ import annotations

import asyncio
import signal
import socket
import subprocess
import sys
from collections.abc import Callable, Coroutine, Iterator
from functools import partial
from pathlib import Path
from typing import NamedTuple, TypeVar

import pytest

from bcapscope.cli.common.exit_codes import ExitCode
from tests.cli.proxying import Process
from tests.cli.run import CAPTURES, run, run_here
from tests.proxy.relaying import eventually

pytest.importorskip("textual_serve")

from bcapscope.tui.app import CLOSE_TIMEOUT
from bcapscope.tui.web.screen_process import ENDS_WITHIN
from tests.cli.served import WEBSOCKET, Served, Viewer, served, view

CAPTURE = CAPTURES / "retry-story.pcapng"
F5 = "\x1b[15~"

T = TypeVar("T")

linux = pytest.mark.skipif(sys.platform != "linux", reason="reads /proc")


@pytest.fixture(scope="module")
def screen() -> Iterator[Served]:
    with served(CAPTURE) as one:
        yield one


def test_a_port_that_is_taken_is_reported_with_a_way_out() -> None:
    with socket.create_server(("127.0.0.1", 0)) as taken:
        address = f"127.0.0.1:{taken.getsockname()[1]}"
        ran = run("tui", "--serve", "--serve-at", address)
    assert ran.code == ExitCode.UNREADABLE
    assert ran.err == (
        f"cannot listen on {address}: address already in use. Choose another port with --serve-at.\n"
    )


def test_a_missing_library_is_reported_with_how_to_install_it() -> None:
    source = "import sys; sys.modules['textual_serve'] = None; from bcapscope.cli import main; main()"
    done = subprocess.run(
        [sys.executable, "-c", source, "tui", "--serve"], capture_output=True, text=True, check=False
    )
    assert done.returncode == ExitCode.NOT_INSTALLED
    assert done.stderr == (
        "textual-serve is not installed. Install it with: pip install 'bcapscope[serve]'\n"
    )


@pytest.mark.parametrize("address", ["0.0.0.0:8000", "192.168.0.1:8000", "[::]:8000", "8.8.8.8:80"])
def test_only_loopback_is_served(address: str) -> None:
    ran = run_here("tui", "--serve", "--serve-at", address)
    assert ran.code == ExitCode.USAGE
    assert "is not loopback" in ran.err
    assert "ssh -L" in ran.err


@pytest.mark.parametrize("address", ["", "8000", "127.0.0.1", "robot:80", "127.0.0.1:x", "127.0.0.1:65536"])
def test_an_address_that_is_none_is_refused(address: str) -> None:
    ran = run_here("tui", "--serve", "--serve-at", address)
    assert ran.code == ExitCode.USAGE
    assert "such as 127.0.0.1:8000" in ran.err


@pytest.mark.parametrize("words", [("--viewers", "2"), ("--serve-at", "127.0.0.1:8001")])
def test_its_options_need_it(words: tuple[str, ...]) -> None:
    ran = run_here("tui", *words)
    assert ran.code == ExitCode.USAGE
    assert "add --serve" in ran.err


@pytest.mark.parametrize(
    "path", ["", "static/js/textual.js", "static/css/xterm.css", "ws", "busy", "nothing"]
)
@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("Origin", "https://evil.example"),
        ("Origin", "null"),
        ("Host", "evil.example"),
        ("Host", "localhost"),
        ("Cookie", ""),
        ("Cookie", "bcapscope=wrong"),
        ("Sec-Fetch-Site", "cross-site"),
    ],
)
def test_requests_from_elsewhere_get_403(screen: Served, path: str, name: str, value: str) -> None:
    headers = {"Cookie": screen.cookie, "Origin": screen.origin, **(WEBSOCKET if path == "ws" else {})}
    status, body, answer = screen.get(screen.base + path, {**headers, name: value})
    assert status == 403
    assert "Open the address that bcapscope printed" in body
    assert "Set-Cookie" not in answer
    assert not screen.children()


@pytest.mark.parametrize(
    "path", ["/", "/?token=", "/?token=wrong", "/ws", "/static/js/textual.js", "/download/x"]
)
def test_without_the_token_there_is_nothing(screen: Served, path: str) -> None:
    assert screen.get(path)[0] == 403
    assert screen.get(path, WEBSOCKET | {"Origin": screen.origin})[0] == 403


def test_the_token_does_not_replace_the_cookie(screen: Served) -> None:
    query = screen.entrance.partition("?")[2]
    assert screen.get(f"{screen.base}?{query}")[0] == 403
    assert screen.get(f"{screen.base}ws?{query}", WEBSOCKET | {"Origin": screen.origin})[0] == 403


def test_responses_are_neither_stored_nor_framed_nor_referred_to(screen: Served) -> None:
    entrance = screen.entrance.removeprefix(screen.origin)
    for path in (entrance, screen.base, f"{screen.base}static/js/textual.js", "/elsewhere"):
        headers = screen.get(path, {"Cookie": screen.cookie})[2]
        assert headers["Cache-Control"] == "no-store"
        assert headers["Referrer-Policy"] == "no-referrer"
        assert "frame-ancestors 'none'" in headers["Content-Security-Policy"]
    assert "HttpOnly" in screen.get(entrance)[2]["Set-Cookie"]
    assert "SameSite=Strict" in screen.get(entrance)[2]["Set-Cookie"]
    assert f"Path={screen.base[:-1]}" in screen.get(entrance)[2]["Set-Cookie"]


def test_no_request_is_logged(screen: Served) -> None:
    screen.get("/?token=secret-of-nobody")
    assert "secret-of-nobody" not in screen.said
    assert screen.said.count("token=") == 1


def test_nonsense_causes_no_traceback(screen: Served) -> None:
    host, port = screen.authority.split(":")
    for data in (
        b"\x16\x03\x01\x02",
        b"GET / HTTP/9.9\r\n\r\n",
        b"GET http://[ HTTP/1.1\r\n\r\n",
        b"A" * 100_000,
    ):
        with socket.create_connection((host, int(port))) as client:
            client.settimeout(30)
            client.sendall(data + b"\r\n\r\n")
            client.shutdown(socket.SHUT_WR)
            while client.recv(65536):
                pass
    assert "Traceback" not in screen.said


def _run(watching: Coroutine[None, None, T]) -> T:
    """Run what viewers do; an end that does not come fails where it was waited for."""
    return asyncio.run(asyncio.wait_for(watching, 80))


async def _happens(test: Callable[[], object], what: str) -> None:
    await asyncio.to_thread(eventually, test, what)


@linux
def test_a_second_viewer_is_sent_away_with_the_reason(screen: Served) -> None:
    async def watch() -> None:
        first = await view(screen)
        await first.sees(b"retry-story.pcapng")
        second = await view(screen)
        await second.over()
        assert second.told == [["open_url", {"url": f"{screen.base}busy", "new_tab": False}]]
        assert second.websocket.close_code == 1013
        assert len(screen.children()) == 1
        await second.leaves()
        await first.leaves()

    _run(watch())
    status, page, _ = screen.get(f"{screen.base}busy", {"Cookie": screen.cookie})
    assert status == 503
    assert "Another viewer is connected" in page


@linux
def test_a_page_that_is_loaded_again_finds_its_seat_free(screen: Served) -> None:
    async def watch() -> None:
        before = await view(screen)
        await before.sees(b"retry-story.pcapng")
        after = asyncio.create_task(view(screen))  # browsers may connect before they disconnect
        await before.leaves()
        await (await after).sees(b"retry-story.pcapng")
        assert len(screen.children()) == 1
        await (await after).leaves()
        await _happens(lambda: not screen.children(), "the end of the screen")

    _run(watch())


@linux
def test_a_viewer_that_does_not_answer_loses_the_seat(screen: Served) -> None:
    async def watch() -> None:
        gone = await view(screen, answers_pings=False)
        await gone.over()
        await gone.leaves()
        await _happens(lambda: not screen.children(), "the end of the screen")

    _run(watch())


@linux
def test_a_screen_that_is_quit_closes_the_page(screen: Served) -> None:
    async def watch() -> None:
        viewer = await view(screen)
        await viewer.sees(b"retry-story.pcapng")
        await viewer.presses("\x11")
        await viewer.over()
        await viewer.leaves()

    _run(watch())
    eventually(lambda: not screen.children(), "the end of the screen")


@linux
def test_as_many_viewers_as_allowed_have_screens_of_their_own() -> None:
    async def watch(screen: Served) -> None:
        viewers = [await view(screen) for _ in range(2)]
        for each in viewers:
            await each.sees(b"retry-story.pcapng")
        assert len(screen.children()) == 2
        third = await view(screen)
        await third.over()
        for each in (*viewers, third):
            await each.leaves()

    with served(CAPTURE, "--viewers", "2") as screen:
        _run(watch(screen))
        page = screen.get(f"{screen.base}busy", {"Cookie": screen.cookie})[1]
        assert "2 viewers are connected" in page


@linux
def test_messages_that_make_no_sense_change_nothing(screen: Served) -> None:
    async def watch() -> None:
        viewer = await view(screen)
        await viewer.sees(b"retry-story.pcapng")
        for text in ("", "[", "{}", "[]", "[1]", '["stdin", 1]', '["resize", {}]', "[" * 5000, '["quit"]'):
            await viewer.websocket.send_str(text)
        await viewer.websocket.send_json(["resize", {"width": 10**9, "height": -1}])
        await viewer.websocket.send_bytes(b"\xff")
        await viewer.websocket.send_json(["ping", "5"])
        async with asyncio.timeout(30):
            while ["pong", "5"] not in viewer.told:
                await asyncio.sleep(0.01)
        await viewer.leaves()

    _run(watch())
    assert "Traceback" not in screen.said


class Simulated(NamedTuple):
    """A simulator, and the file where it logs calls."""

    port: int
    log: Path

    def has_logged(self, text: str) -> bool:
        """Tell whether a call was logged."""
        return text in self.log.read_text()

    def is_released(self) -> bool:
        """Tell whether every client that came has released its robot and gone."""
        calls = self.log.read_text()
        return calls.count("Service_Start") == calls.count("Service_Stop") and "Robot_Release" in calls


@pytest.fixture
def sim(tmp_path: Path) -> Iterator[Simulated]:
    log = tmp_path / "calls"
    with log.open("wb") as stdout:
        process = Process(["sim", "--port", "0"], stdout.fileno())
    yield Simulated(process.port, log)
    process.close()


async def _connected(screen: Served, sim: Simulated) -> Viewer:
    """Open the Tester, have it connect to the simulator, and wait until it has a robot."""
    viewer = await view(screen)
    await viewer.sees(b"not connected")
    await viewer.presses(F5)
    await _happens(lambda: sim.has_logged("Controller_GetRobot"), "the connection")
    return viewer


@linux
@pytest.mark.parametrize("how", ["leaves", "vanishes"])
def test_when_the_viewer_goes_the_robot_is_released(sim: Simulated, how: str) -> None:
    async def watch(screen: Served) -> None:
        viewer = await _connected(screen, sim)
        await getattr(viewer, how)()
        await _happens(sim.is_released, "the release of the robot")

    with served("127.0.0.1", "-p", f"{sim.port}") as screen:
        _run(watch(screen))
        eventually(lambda: not screen.children(), "the end of the screen")


@linux
@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM, signal.SIGKILL])
def test_when_the_server_ends_the_robot_is_released(sim: Simulated, number: signal.Signals) -> None:
    async def watch(screen: Served) -> list[int]:
        viewer = await _connected(screen, sim)
        children = screen.children()
        code = await asyncio.to_thread(screen.end, number)
        assert code == (-number if number == signal.SIGKILL else 0)
        await viewer.over()
        await viewer.leaves()
        return children

    with served("127.0.0.1", "-p", f"{sim.port}") as screen:
        children = _run(watch(screen))
        eventually(sim.is_released, "the release of the robot")
        for pid in children:
            eventually(partial(_is_over, pid), "the end of the screen")


def _is_over(pid: int) -> bool:
    return not Path(f"/proc/{pid}").exists()


def test_a_screen_has_longer_to_end_than_it_gives_itself() -> None:
    assert ENDS_WITHIN > CLOSE_TIMEOUT
