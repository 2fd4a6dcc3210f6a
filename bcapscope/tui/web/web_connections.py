"""Limits connections to the served screen, so that clients without the secret cannot exhaust the server."""

from __future__ import annotations

import asyncio

from aiohttp import web
from aiohttp.web_protocol import RequestHandler

PROVES_WITHIN = 10.0
"""Maximum time in seconds that a connection may last without a request that passes the gate."""

MAX_UNPROVED = 64
"""Maximum number of connections that have not passed the gate; the oldest is closed first.

A browser opens at most six connections.
"""


class WebConnections:
    """Creates the protocol object of each connection, and ends connections without the secret."""

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
        """Keep a connection, because one of its requests has passed the gate."""
        timer = self._unproved.pop(handler, None)
        if timer is not None:
            timer.cancel()

    def _abort(self, handler: RequestHandler) -> None:
        self._unproved.pop(handler).cancel()
        if handler.transport is not None:
            handler.transport.abort()
