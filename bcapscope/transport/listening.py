"""Prepare sockets that listen for connections."""

from __future__ import annotations

import socket
import sys


def allow_restart(listener: socket.socket) -> None:
    """Let a TCP listener bind to a port on which old connections are not yet gone from the system's tables.

    On Windows, a listener can bind to such a port without any option. The option SO_REUSEADDR would let other
    programs take over the port.
    """
    if sys.platform != "win32":
        listener.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
