"""The proxy's control socket: a Unix socket for its owner only (mode 0600), or a port on loopback."""

from __future__ import annotations

import ipaddress
import math
import os
import socket
import stat
import time
from contextlib import suppress

from bcapscope.errors import BcapError
from bcapscope.messages import Message
from bcapscope.messages.os_errors import os_reason
from bcapscope.proxy.control_api import ControlApi
from bcapscope.proxy.control_messages import LONGEST_LINE, parse_endpoint
from bcapscope.proxy.poller import READ, WRITE, DescriptorWatcher
from bcapscope.traffic.observation import Endpoint
from bcapscope.transport.listening import allow_restart

MAX_CONNECTIONS = 16

_BACKLOG = 128

CONNECTS_WITHIN = 5.0
"""Maximum time in seconds to connect to a proxy's control socket, and to send a message."""

IDLE_AFTER = 10.0
"""A new control connection may replace a connection that has been idle for this time in seconds."""


class ControlError(BcapError):
    """The proxy cannot open its control socket at an address, or a client finds no proxy at an address."""


class ControlServer:
    """Accepts control connections, and passes each received line to the `ControlApi`."""

    def __init__(self, address: str, api: ControlApi, watcher: DescriptorWatcher) -> None:
        """Listen at `HOST:PORT` on loopback, or at the path of a Unix socket, or raise a `ControlError`."""
        self.api = api
        self.watcher = watcher
        self.connections: dict[int, _Connection] = {}
        self._path = "" if is_tcp_address(address) else address
        try:
            self._socket = _listen_at_path(address) if self._path else _listen_at_port(address)
        except (OSError, OverflowError) as error:
            reason = os_reason(error)
            raise ControlError(Message("control.cannot-listen", address=address, reason=reason)) from error
        self._socket.setblocking(False)
        self.address = self._path or str(Endpoint(*self._socket.getsockname()[:2]))
        watcher.watch(self._socket.fileno(), self._on_acceptable)

    def close(self) -> None:
        for connection in list(self.connections.values()):
            connection.close()
        self.watcher.unwatch(self._socket.fileno())
        self._socket.close()
        if self._path:
            with suppress(OSError):
                os.unlink(self._path)

    def _on_acceptable(self, _: int) -> None:
        try:
            sock, _address = self._socket.accept()
        except (BlockingIOError, ConnectionError):
            return
        except OSError:  # the client has to wait, for example until a file descriptor is free
            self.watcher.pause(self._socket.fileno())
            return
        if len(self.connections) >= MAX_CONNECTIONS and not self._close_idle_connection():
            sock.close()
            return
        sock.setblocking(False)
        self.connections[sock.fileno()] = _Connection(sock, self)

    def _close_idle_connection(self) -> bool:
        """Close the connection that has been idle longest. Return False if no connection is idle."""
        idle = min(self.connections.values(), key=lambda each: each.last_command_at)
        if time.monotonic() - idle.last_command_at < IDLE_AFTER:
            return False
        idle.close()
        return True


class _Connection:
    """A connected control client. `last_command_at` is in seconds; minus infinity before a command."""

    def __init__(self, sock: socket.socket, server: ControlServer) -> None:
        self._socket = sock
        self._descriptor = sock.fileno()
        self._server = server
        self._received = bytearray()
        self._backlog = bytearray()
        self._closes_after_send = False
        self.last_command_at = -math.inf
        server.watcher.watch(self._descriptor, self._on_ready)

    def close(self) -> None:
        if self._server.connections.pop(self._descriptor, None) is not None:
            self._server.watcher.unwatch(self._descriptor)
            self._socket.close()

    def _on_ready(self, _: int) -> None:
        """Answer at most one request, so that many requests neither delay traffic nor fill the memory."""
        try:
            if not self._backlog and (b"\n" in self._received or self._read()):
                self._answer_next_line()
            self._send()
        except BlockingIOError:
            return
        except OSError:
            self.close()

    def _read(self) -> bool:
        """Return whether a whole line has arrived."""
        data = self._socket.recv(1 << 16)
        self._received += data
        if not data or (b"\n" not in data and len(self._received) > LONGEST_LINE):
            self._closes_after_send = True
        return b"\n" in data

    def _answer_next_line(self) -> None:
        end = self._received.index(b"\n")
        line = bytes(self._received[:end])
        del self._received[: end + 1]
        if line.strip():
            self.last_command_at = time.monotonic()
            response, is_json = self._server.api.handle_line(line, time.monotonic_ns())
            self._backlog += response
            # Close if the line is not JSON: a web page can make a browser send HTTP and then malicious JSON.
            self._closes_after_send = not is_json

    def _send(self) -> None:
        with suppress(BlockingIOError):
            while self._backlog:
                del self._backlog[: self._socket.send(self._backlog)]
        if self._closes_after_send and not self._backlog:
            self.close()
        else:
            has_more = self._backlog or b"\n" in self._received
            self._server.watcher.change(self._descriptor, WRITE if has_more else READ)


def is_tcp_address(address: str) -> bool:
    """Return whether an address has the form ``HOST:PORT``; otherwise, the address is a path."""
    host, colon, port = address.rpartition(":")
    return bool(colon) and port.isdecimal() and "/" not in host and os.sep not in host


def connect_control(address: str, timeout: float = CONNECTS_WITHIN) -> socket.socket:
    """Connect to the control socket of a proxy. Raise a `ControlError` if the connection fails, for example
    because no proxy listens on `address`.
    """
    try:
        if is_tcp_address(address):
            return socket.create_connection(parse_endpoint(address), timeout)
        return _connect_unix(address, timeout)
    except (OSError, OverflowError) as error:
        raise ControlError(Message("control.no-proxy", address=address, reason=os_reason(error))) from error


def _connect_unix(path: str, timeout: float) -> socket.socket:
    sock = _unix_socket(path)
    try:
        sock.settimeout(timeout)
        sock.connect(path)
    except OSError:
        sock.close()
        raise
    return sock


def _listen_at_port(address: str) -> socket.socket:
    host, port = parse_endpoint(address)
    try:
        loopback = ipaddress.ip_address(host).is_loopback
    except ValueError:
        raise ControlError(Message("control.no-address", host=host)) from None
    if not loopback:
        raise ControlError(Message("control.not-loopback", host=host))
    family = socket.AF_INET6 if ":" in host else socket.AF_INET
    sock = socket.socket(family, socket.SOCK_STREAM)
    try:
        allow_restart(sock)
        sock.bind((host, port))
        sock.listen(_BACKLOG)
        return sock
    except (OSError, OverflowError):
        sock.close()
        raise


def _listen_at_path(path: str) -> socket.socket:
    sock = _unix_socket(path)
    try:
        _remove_stale_socket(path)
        before = os.umask(0o177)
        try:
            sock.bind(path)
        finally:
            os.umask(before)
        sock.listen(_BACKLOG)
        return sock
    except (OSError, ControlError):
        sock.close()
        raise


def _remove_stale_socket(path: str) -> None:
    """Remove the socket file of a proxy that was killed."""
    try:
        mode = os.lstat(path).st_mode
    except FileNotFoundError:
        return
    if not stat.S_ISSOCK(mode):
        raise ControlError(Message("control.no-socket", path=path))
    with _unix_socket(path) as probe:
        try:
            probe.connect(path)
        except OSError:
            os.unlink(path)
            return
    raise ControlError(Message("control.taken", path=path))


def _unix_socket(path: str) -> socket.socket:
    if not hasattr(socket, "AF_UNIX"):
        raise ControlError(Message("control.unsupported", path=path))
    return socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
