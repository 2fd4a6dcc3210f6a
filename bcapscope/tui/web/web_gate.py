"""Check whether a browser may open the screen that bcapscope serves. This module does no I/O.

The address that bcapscope prints contains a token. The page at this address sets a cookie and forwards to a
secret path. All other pages are below the secret path and need the cookie. Browsers send cookies to every
port of a host, and another port may belong to another user's server. Browsers send this cookie only to the
secret path, and no other server knows the secret path.
"""

from __future__ import annotations

import hmac
import secrets
from collections.abc import Sequence
from dataclasses import dataclass

from bcapscope.traffic.observation import Endpoint

COOKIE = "bcapscope"
TOKEN = "token"
"""Name of the token in the query of the printed address."""

_HTTP_PORT = 80
_NOT_FROM_OTHER_PAGES = ("", "none", "same-origin")
"""Accepted values of the header Sec-Fetch-Site: no header, a typed address, or a page of this server."""


@dataclass(frozen=True, slots=True)
class WebRequest:
    """The parts of an HTTP request that identify its sender; "" stands for a missing part."""

    path: str  # decoded, without the query
    hosts: Sequence[str]
    origins: Sequence[str] = ()
    fetch_site: str = ""  # header Sec-Fetch-Site
    token: str = ""
    cookie: str = ""
    is_websocket: bool = False


class WebGate:
    """Holds the secrets of one served screen, and checks whether a request contains these secrets."""

    def __init__(self, address: Endpoint) -> None:
        self.authority = str(address).removesuffix(f":{_HTTP_PORT}")  # as in the header Host
        self._token = secrets.token_urlsafe()
        self.origin = f"http://{self.authority}"
        self.entry_url = f"{self.origin}/?{TOKEN}={self._token}"
        self.base_path = f"/{secrets.token_urlsafe()}"  # secret path of all pages except the entry page
        self.cookie = secrets.token_urlsafe()

    def refusal_reason(self, request: WebRequest) -> str:
        """Return the reason why a request is refused; "" if the request is accepted."""
        if list(request.hosts) != [self.authority]:
            return f"this server answers only to {self.origin}"
        if list(request.origins) != [self.origin] and (request.origins or request.is_websocket):
            return "requests from other pages are refused"
        if request.path == "/" and not request.is_websocket:
            return (
                "" if _equal_in_constant_time(request.token, self._token) else "the token is missing or wrong"
            )
        # Compare both secrets even if the first is wrong, so that the response time does not show which
        # secret was right.
        below = _equal_in_constant_time(request.path[: len(self.base_path) + 1], f"{self.base_path}/")
        allowed = _equal_in_constant_time(request.cookie, self.cookie)
        if not below or not allowed:
            return "this browser has not opened the address with the token, or the server was restarted"
        if request.fetch_site not in _NOT_FROM_OTHER_PAGES:
            return "requests from other pages are refused"
        return ""


def _equal_in_constant_time(given: str, secret: str) -> bool:
    return hmac.compare_digest(given.encode("utf-8", "surrogatepass"), secret.encode())
