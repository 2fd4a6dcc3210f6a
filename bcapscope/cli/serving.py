"""What commands that listen for clients share: who can reach them, the log, the capture, the end."""

from __future__ import annotations

import gc
import ipaddress
import signal
import sys
import time
from collections.abc import Callable
from types import FrameType

from bcapscope.capture.recording import Address, Recording
from bcapscope.cli.exits import Exit
from bcapscope.cli.output import narrate
from bcapscope.render.service import report_line
from bcapscope.simulator.conversation import Report
from bcapscope.simulator.server import Server, serve
from bcapscope.simulator.simulator import Peer

_ENDS = [getattr(signal, name) for name in ("SIGTERM", "SIGHUP") if hasattr(signal, name)]


def reach(host: str) -> str:
    """Say in half a sentence who can reach what listens on an address."""
    address = ipaddress.ip_address(host.partition("%")[0])
    if address.is_loopback:
        return "only this machine reaches it"
    whom = "every network of this machine" if address.is_unspecified else f"the network of {host}"
    return f"everyone on {whom} reaches it"


def serve_in_order(
    server: Server, log: Log, take: Callable[[int], None] | None = None, watched: list[int] | None = None
) -> None:
    """Serve until Ctrl-C or another signal that ends programs, then close everything.

    Args:
        server: that listens.
        log: of the calls.
        take: called with each of `watched` that can be read.
        watched: file descriptors; `take` may change it.
    """
    end_in_order()
    # What was loaded so far stays: looking through it for garbage again and again would cost milliseconds.
    gc.collect()
    gc.freeze()
    try:
        serve(server, log.idle, take or _ignore, watched or [])
    except KeyboardInterrupt:
        pass
    finally:
        server.close()


def end_in_order() -> None:
    """Let signals that end programs do as Ctrl-C does, so that all is let go of."""
    for number in _ENDS:
        signal.signal(number, _terminate)


def _terminate(number: int, frame: FrameType | None) -> None:
    raise KeyboardInterrupt


def _ignore(descriptor: int) -> None:
    """Take no notice."""


class Tap:
    """Writes a capture; when that fails, the command goes on without."""

    def __init__(self, path: str) -> None:
        try:
            # Each packet is in the file at once, so that a kill loses none.
            self._recording: Recording | None = Recording(open(path, "xb", buffering=0))  # noqa: SIM115 - close() ends it
        except OSError as error:
            narrate(f"{path} cannot be written: {error.strerror or error}")
            sys.exit(Exit.UNWRITABLE)
        self._path = path

    def datagram(self, source: Address, target: Address, data: bytes, time: int) -> None:
        """Write a UDP datagram."""
        if self._recording:
            self._try(lambda recording: recording.datagram(source, target, data, time))

    def segment(self, source: Address, target: Address, data: bytes, time: int) -> None:
        """Write bytes of a TCP connection."""
        if self._recording:
            self._try(lambda recording: recording.segment(source, target, data, time))

    def ended(self, client: Address, server: Address) -> None:
        """Forget a TCP connection."""
        if self._recording:
            self._recording.ended(client, server)

    def _try(self, write: Callable[[Recording], None]) -> None:
        try:
            if self._recording:
                write(self._recording)
        except OSError as error:
            self._recording = None
            narrate(f"{self._path} is not written any more: {error.strerror or error}")


class Log:
    """Lines for stdout, made when the client has its answer, written at the latest after `_PATIENCE`."""

    _PATIENCE = 20_000_000

    def __init__(self, wanted: bool) -> None:
        self.calls = 0
        self._wanted = wanted
        self._told: list[tuple[Peer, Report] | str] = []
        self._lines: list[str] = []
        self._written = 0

    def take(self, peer: Peer, report: Report) -> None:
        """Note a call."""
        self.calls += 1
        if self._wanted:
            self._told.append((peer, report))

    def note(self, text: str) -> None:
        """Note something that is no call."""
        if self._wanted:
            self._told.append(f"# {text}")

    def idle(self) -> None:
        """Make the lines of what was told; write if the last time is long ago."""
        self._make()
        if self._lines and time.monotonic_ns() - self._written > self._PATIENCE:
            self.flush()

    def flush(self) -> None:
        """Write what there is."""
        self._make()
        self._written = time.monotonic_ns()
        if self._lines:
            lines, self._lines = self._lines, []
            sys.stdout.write("\n".join(lines) + "\n")
            sys.stdout.flush()

    def _make(self) -> None:
        told, self._told = self._told, []
        self._lines += [each if isinstance(each, str) else report_line(*each) for each in told]
