"""The HTTP server of the served screen: a few pages and a websocket, all behind `web_gate`."""

from __future__ import annotations

import asyncio
import logging
import signal
import socket
from collections.abc import Awaitable, Callable, Sequence
from contextlib import suppress
from functools import partial
from typing import TypeVar

import aiohttp_jinja2
import jinja2
import orjson
from aiohttp import WSCloseCode, WSMessage, WSMsgType, web
from aiohttp.http import HttpProcessingError
from aiohttp.typedefs import Handler
from aiohttp.web_protocol import RequestHandler
from textual_serve.server import Server

from bcapscope.live.standard_streams import print_stderr
from bcapscope.render.escape import printable
from bcapscope.traffic.observation import Endpoint
from bcapscope.tui.web.screen_process import ENDS_WITHIN, NoSeat, ScreenProcess, ViewerSeats
from bcapscope.tui.web.web_gate import COOKIE, TOKEN, WebGate, WebRequest

PROVES_WITHIN = 10.0
"""Seconds in which one request on a new connection must pass the access check."""

MAX_UNPROVED = 64
"""Maximum number of connections that have not passed the access check yet. If one more connection arrives,
the server closes the oldest of these connections. One browser opens at most six connections.
"""

HEARTBEAT = 4.0
"""Seconds between two pings to a viewer, who must answer within half of this time."""

_LARGEST_MESSAGE = 1 << 20
"""Maximum size in bytes of a message from a page. The largest messages contain pasted text."""

_LARGEST_SIZE = 1000  # maximum number of columns, or of lines, of a screen

_BUSY_PATH = "/busy"

T = TypeVar("T")

_PAGE = """<!DOCTYPE html>
<html lang="en"><head><meta charset="utf-8">{head}<title>bcapscope</title></head>
<body style="background: #0c181f; color: #eee; font: 16px sans-serif; margin: 15vh auto; max-width: 34em">
{body}</body></html>
"""


class WebServer:
    """Serves the screen of one command to viewers who know the address."""

    def __init__(self, argv: Sequence[str], listening: socket.socket, viewers: int) -> None:
        """`listening` is a socket that listens on a loopback address; `run` closes the socket. `viewers` is
        the maximum number of viewers. Each viewer gets a separate screen process.
        """
        address = Endpoint(*listening.getsockname()[:2])
        self.gate = WebGate(address)
        self._argv = tuple(argv)
        self._listening = listening
        self._viewers = viewers
        self._seats = ViewerSeats(viewers)
        self._websockets: set[web.WebSocketResponse] = set()
        self._connections: WebConnections | None = None
        # textual-serve only renders the page. bcapscope handles access control, screen processes and logging.
        self._pages = Server("", address.host, address.port, "bcapscope", self.gate.origin)

    async def run(self, on_listening: Callable[[], None]) -> None:
        """Serve until SIGINT or SIGTERM, then end every screen process cleanly."""
        runner = web.AppRunner(
            self._application(),
            access_log=None,  # the access log would contain the token
            logger=_one_line_logger(),
            shutdown_timeout=ENDS_WITHIN + 5,
        )
        await runner.setup()
        try:
            assert runner.server is not None
            self._connections = WebConnections(runner.server)
            loop = asyncio.get_running_loop()
            server = await loop.create_server(self._connections, sock=self._listening)
            try:
                on_listening()
                await _wait_for_end_signal()
            finally:
                server.close()
        finally:
            await runner.cleanup()

    def _application(self) -> web.Application:
        below = web.Application()
        aiohttp_jinja2.setup(below, loader=jinja2.FileSystemLoader(self._pages.templates_path))
        below.add_routes(
            [
                web.get("/", self._pages.handle_index, name="index"),
                web.get("/ws", self._serve_viewer, name="websocket"),
                web.get(_BUSY_PATH, self._busy_page),
                web.static("/static", self._pages.statics_path, name="static"),
            ]
        )
        application = web.Application(middlewares=[self._check_request])
        application.router.add_get("/", self._entry_page)
        application.add_subapp(self.gate.base_path, below)
        application.on_response_prepare.append(self._add_headers)
        application.on_shutdown.append(self._close_viewers)
        return application

    @web.middleware
    async def _check_request(self, request: web.Request, handler: Handler) -> web.StreamResponse:
        reason = self.gate.refusal_reason(
            WebRequest(
                path=request.path,
                hosts=request.headers.getall("Host", ()),
                origins=request.headers.getall("Origin", ()),
                fetch_site=request.headers.get("Sec-Fetch-Site", ""),
                token=request.query.get(TOKEN, ""),
                cookie=request.cookies.get(COOKIE, ""),
                is_websocket="Upgrade" in request.headers,
            )
        )
        if reason:
            return web.Response(
                status=403,
                text=f"403: {reason}. Open the address that bcapscope printed.\n",
                headers={"Connection": "close"},
            )
        if self._connections is not None:
            self._connections.mark_proved(request.protocol)
        return await handler(request)

    async def _add_headers(self, request: web.Request, response: web.StreamResponse) -> None:
        own = f"'self' ws://{self.gate.authority}"  # some browsers do not accept 'self' for websockets
        response.headers.update(
            {
                "Cache-Control": "no-store",
                "Referrer-Policy": "no-referrer",
                "X-Content-Type-Options": "nosniff",
                "X-Frame-Options": "DENY",
                "Cross-Origin-Opener-Policy": "same-origin",
                "Cross-Origin-Resource-Policy": "same-origin",
                "Content-Security-Policy": (
                    "default-src 'none'; script-src 'self' 'unsafe-inline'; "
                    "style-src 'self' 'unsafe-inline'; "
                    f"img-src 'self' data:; font-src 'self'; connect-src {own}; "
                    "base-uri 'none'; form-action 'none'; frame-ancestors 'none'"
                ),
            }
        )

    async def _entry_page(self, request: web.Request) -> web.Response:
        """Set the cookie and send the browser to the secret path, so that the address bar loses the token.
        With an HTTP redirect, the browser would send no cookie after a click on a link in another page.
        """
        head = f'<meta http-equiv="refresh" content="0; url={self.gate.base_path}/">'
        body = f'<p><a style="color: #9cf" href="{self.gate.base_path}/">Open the screen</a></p>'
        response = _page(body, head)
        response.set_cookie(
            COOKIE, self.gate.cookie, path=self.gate.base_path, httponly=True, samesite="Strict"
        )
        return response

    async def _busy_page(self, request: web.Request) -> web.Response:
        others = "Another viewer is" if self._viewers == 1 else f"{self._viewers} viewers are"
        return _page(
            f"<h1>{others} connected</h1>"
            "<p>Each viewer gets a separate screen, and only one screen can control the robot at a time. "
            "Close the other page, then try again. <code>--viewers</code> allows more viewers.</p>"
            f'<p><a style="color: #9cf" href="{self.gate.base_path}/">Try again</a></p>',
            status=503,
        )

    async def _serve_viewer(self, request: web.Request) -> web.WebSocketResponse:
        websocket = web.WebSocketResponse(heartbeat=HEARTBEAT, max_msg_size=_LARGEST_MESSAGE)
        await websocket.prepare(request)
        self._websockets.add(websocket)
        try:
            async with self._seats.taken():
                size = (
                    _number(request.query.get("width", ""), 80),
                    _number(request.query.get("height", ""), 24),
                )
                await self._run_screen(websocket, size)
        except NoSeat:
            busy_page = {"url": f"{self.gate.base_path}{_BUSY_PATH}", "new_tab": False}
            await _send(websocket.send_json, ["open_url", busy_page])
            await websocket.close(code=WSCloseCode.TRY_AGAIN_LATER, message=b"another viewer is connected")
        finally:
            self._websockets.discard(websocket)
        return websocket

    async def _run_screen(self, websocket: web.WebSocketResponse, size: tuple[int, int]) -> None:
        if websocket.closed:
            return
        write_bytes, write_str = partial(_send, websocket.send_bytes), partial(_send, websocket.send_str)
        screen = ScreenProcess(self._argv, write_bytes, write_str, websocket.close)
        await screen.start(*size)

        async def close_after_end() -> None:
            await screen.wait_until_ended()
            await websocket.close()

        over = asyncio.create_task(close_after_end(), name="end of a screen")
        try:
            async for message in websocket:
                await _handle_page_event(message, screen, websocket)
        finally:
            over.cancel()
            self._seats.ending += 1
            try:
                await screen.stop()
            finally:
                self._seats.ending -= 1

    async def _close_viewers(self, application: web.Application) -> None:
        closing = (each.close(code=WSCloseCode.GOING_AWAY) for each in self._websockets)
        await asyncio.gather(*closing)


async def _send(send: Callable[[T], Awaitable[None]], data: T) -> None:
    with suppress(ConnectionError):
        await send(data)


async def _handle_page_event(
    message: WSMessage, screen: ScreenProcess, websocket: web.WebSocketResponse
) -> None:
    if message.type is not WSMsgType.TEXT:
        return
    try:
        event = orjson.loads(message.data)
    except orjson.JSONDecodeError:
        return
    match event:
        case ["stdin", str(keys)]:
            await screen.send_bytes(keys.encode())
        case ["resize", {"width": int(width), "height": int(height)}]:
            await screen.set_terminal_size(_bounded(width), _bounded(height))
        case ["ping", str(when)]:
            await _send(websocket.send_json, ["pong", when])
        case ["blur", *_]:
            await screen.blur()
        case ["focus", *_]:
            await screen.focus()


def _number(text: str, otherwise: int) -> int:
    is_number = text.isascii() and text.isdecimal() and len(text) <= 4
    return _bounded(int(text)) if is_number else otherwise


def _bounded(size: int) -> int:
    return max(1, min(size, _LARGEST_SIZE))


def _page(body: str, head: str = "", status: int = 200) -> web.Response:
    return web.Response(status=status, text=_PAGE.format(head=head, body=body), content_type="text/html")


async def _wait_for_end_signal() -> None:
    arrived = asyncio.Event()
    with suppress(NotImplementedError):
        for number in (signal.SIGINT, signal.SIGTERM):
            asyncio.get_running_loop().add_signal_handler(number, arrived.set)
    await arrived.wait()


class _OneLineHandler(logging.Handler):
    def emit(self, record: logging.LogRecord) -> None:
        error = record.exc_info[1] if record.exc_info else None
        if not isinstance(error, HttpProcessingError):
            print_stderr(printable(f"{record.getMessage()}: {error}" if error else record.getMessage()))


def _one_line_logger() -> logging.Logger:
    """Log each error of the server in one line, without the token. Do not log errors of clients."""
    for name in ("aiohttp", "asyncio", "textual-serve"):
        logger = logging.getLogger(name)
        logger.handlers = [_OneLineHandler(logging.WARNING)]
        logger.propagate = False
    return logging.getLogger("aiohttp")


class WebConnections:
    """Creates each connection's protocol object; closes connections that pass no access check in time."""

    def __init__(self, server: web.Server) -> None:
        self._server = server
        self._unproved: dict[RequestHandler, asyncio.TimerHandle] = {}

    def __call__(self) -> RequestHandler:
        if len(self._unproved) >= MAX_UNPROVED:
            self._abort(next(iter(self._unproved)))
        handler = self._server()
        loop = asyncio.get_running_loop()
        self._unproved[handler] = loop.call_later(PROVES_WITHIN, self._abort, handler)
        return handler

    def mark_proved(self, handler: RequestHandler) -> None:
        """Keep a connection open."""
        timer = self._unproved.pop(handler, None)
        if timer is not None:
            timer.cancel()

    def _abort(self, handler: RequestHandler) -> None:
        self._unproved.pop(handler).cancel()
        if handler.transport is not None:
            handler.transport.abort()
