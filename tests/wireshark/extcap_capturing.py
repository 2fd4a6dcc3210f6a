"""Clients of a proxy or simulator that captures for Wireshark, and what is left of it after its end."""

from __future__ import annotations

import socket
import subprocess
import time
from contextlib import ExitStack
from itertools import count
from pathlib import Path

from bcapscope.protocol.codec.frame import encode_frame
from bcapscope.protocol.codec.variant import VT, Variant
from tests.proxy.relaying import eventually

PATIENCE = 30.0
_REPLY_WITHIN = 0.3


def free_port() -> int:
    """Return a port that is free for UDP and TCP."""
    while True:
        with socket.create_server(("127.0.0.1", 0)) as server:
            port: int = server.getsockname()[1]
            if is_free(port, socket.SOCK_DGRAM):
                return port


def is_free(port: int, *kinds: int) -> bool:
    """Return whether one can listen on the port."""
    with ExitStack() as opened:
        for kind in kinds or (socket.SOCK_DGRAM, socket.SOCK_STREAM):
            own = opened.enter_context(socket.socket(socket.AF_INET, kind))
            own.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, kind == socket.SOCK_STREAM)
            try:
                own.bind(("127.0.0.1", port))
            except OSError:
                return False
    return True


def call_over_udp(port: int, serial: int) -> bool:
    """Start a service; return whether a reply came. A proxy that is starting drops requests."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as client:
        client.settimeout(_REPLY_WITHIN)
        client.connect(("127.0.0.1", port))
        try:
            client.send(encode_frame(serial, serial, 1, [Variant(VT.BSTR, ",WDT=400")]))
            return bool(client.recv(2048))
        except OSError:  # nobody listens yet, or nobody answers
            return False


def wait_for_reply(port: int) -> None:
    """Call until the server replies."""
    eventually(lambda: call_over_udp(port, 7), "a reply")


def call_until_ended(capture: subprocess.Popen[str], port: int) -> None:
    """Make one call after the other until the capture ends."""
    until = time.monotonic() + PATIENCE
    for serial in count(1):
        if capture.poll() is not None:
            return
        assert time.monotonic() < until, "the capture did not end"
        call_over_udp(port, serial % 60_000)


def processes_with(text: str) -> list[int]:
    """Return the processes whose command line contains the text."""
    found = []
    for path in Path("/proc").glob("[0-9]*/cmdline"):
        try:
            line = path.read_bytes()
        except OSError:  # the process has just ended
            continue
        if text.encode() in line and b"bcapscope" in line:
            found.append(int(path.parent.name))
    return found
