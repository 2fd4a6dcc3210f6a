"""The process in which the scripts run: it receives orders from the proxy, and sends the scripts' answers."""

from __future__ import annotations

import ctypes
import faulthandler
import gc
import os
import signal
import socket
import sys
from collections.abc import Sequence
from contextlib import suppress

from bcapscope.proxy.addons import AddonRunner, load_addons
from bcapscope.proxy.script_protocol import (
    FrameUnpacker,
    ScriptError,
    ScriptOrder,
    ScriptsLoaded,
    ScriptStatement,
    ScriptsUnusable,
    pack,
    wire_sentence,
)

_PR_SET_PDEATHSIG = 1
_READ = 1 << 16


def main(
    descriptor: int | None, traces: int | None, parent: int, paths: Sequence[str], megabytes: int
) -> None:
    """Run scripts until the proxy with the process id `parent` ends. `descriptor` is the socket to the proxy;
    None on Windows, where the process reads a description of the socket from standard input. On SIGUSR1, the
    process writes its current script line to the file descriptor `traces`, unless `traces` is None.
    """
    proxy = _shared_socket() if descriptor is None else socket.socket(fileno=descriptor)
    try:
        _isolate(traces, parent, megabytes)
        _run(proxy, paths)
    # A script has closed the socket or used up the memory. The proxy reports the end of the process.
    except (OSError, MemoryError):
        proxy.detach()
        sys.exit(1)


def _run(proxy: socket.socket, paths: Sequence[str]) -> None:
    try:
        addons = AddonRunner([addon for path in paths for addon in load_addons(path)])
    except ScriptError as error:
        _send_statement(proxy, ScriptsUnusable(wire_sentence(error.message)))
        return
    _send_statement(proxy, ScriptsLoaded(addons.hooks))
    gc.collect()
    gc.freeze()  # garbage collection of the loaded objects would delay messages
    orders: FrameUnpacker[ScriptOrder] = FrameUnpacker(ScriptOrder)
    while data := proxy.recv(_READ):
        orders.feed_bytes(data)
        while (order := orders.next_frame()) is not None:
            _send_statement(proxy, addons.execute(order))


def _send_statement(proxy: socket.socket, statement: ScriptStatement) -> None:
    proxy.sendall(pack(statement))


def _isolate(traces: int | None, parent: int, megabytes: int) -> None:
    """Limit the memory of this process. On Linux, let the system kill this process when the proxy ends. If
    `traces` is not None, write the script line that is being executed to this file descriptor after a SIGUSR1
    signal or a crash.
    """
    if sys.platform == "linux":
        ctypes.CDLL(None).prctl(_PR_SET_PDEATHSIG, signal.SIGKILL)
        if os.getppid() != parent:  # the proxy had already ended before prctl took effect
            sys.exit()
    _limit_memory(megabytes << 20)
    if traces is not None:
        faulthandler.enable(traces, all_threads=False)
        faulthandler.register(signal.SIGUSR1, traces, all_threads=False)
    # Flush each line, as Python does for sys.stderr, so that text printed before a kill is not lost.
    if sys.stdout is not None:
        sys.stdout.reconfigure(line_buffering=True)  # type: ignore[union-attr] # still the original


def _limit_memory(size: int) -> None:
    if sys.platform == "win32":
        return
    import resource  # noqa: PLC0415 - Windows has no such module

    # On Linux, RLIMIT_DATA counts writable memory; RLIMIT_AS also counts memory that is only reserved.
    kind = resource.RLIMIT_DATA if sys.platform == "linux" else resource.RLIMIT_AS
    with suppress(ValueError, OSError):
        resource.setrlimit(kind, (size, size))


def _shared_socket() -> socket.socket:
    return socket.fromshare(sys.stdin.buffer.read())  # type: ignore[attr-defined,no-any-return]  # there only
