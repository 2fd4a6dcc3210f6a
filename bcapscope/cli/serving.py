"""What commands that answer clients share: who can reach them, the log, the capture, the end.

Nothing that they tell holds up an answer: lines, sentences and the capture are written by threads of their
own, and what there is no time for is counted.
"""

from __future__ import annotations

import ipaddress
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import closing, contextmanager, suppress
from pathlib import Path

from bcapscope.cli.exits import Exit
from bcapscope.cli.output import narrate
from bcapscope.cli.recorder import Recorder, open_capture
from bcapscope.cli.screen import Screen
from bcapscope.cli.signals import awaited_ends, end_in_order
from bcapscope.player.realtime import undisturbed
from bcapscope.render.service import reason_line, report_line
from bcapscope.simulator.conversation import Report
from bcapscope.simulator.listening import ListenError
from bcapscope.simulator.server import Answerer, Server, serve
from bcapscope.simulator.simulator import Peer


def reach(host: str) -> str:
    """Say in half a sentence who can reach what listens on an address."""
    address = ipaddress.ip_address(host.partition("%")[0])
    if address.is_loopback:
        return "only this machine reaches it"
    whom = "every network of this machine" if address.is_unspecified else f"the network of {host}"
    return f"everyone on {whom} reaches it"


def _ignore(descriptor: int) -> None:
    """Take no notice."""


class Serving:
    """A server of a command, with all that is told of it, from its start to its end.

    Attributes:
        log: of the calls.
        tell: writes a sentence to stderr, and waits for nobody.
    """

    def __init__(self, *, quiet: bool, record: str | None) -> None:
        """Get ready.

        Args:
            quiet: no line a call.
            record: file that keeps what passes.
        """
        self._screen = Screen()
        self.tell = self._screen.tell
        self.log = Log(not quiet, self._screen)
        self._record = record
        self._recorder: Recorder | None = None

    @contextmanager
    def listen(self, answerer: Answerer, host: str, port: int) -> Iterator[Server]:
        """Listen; what is done with the server ends in order with Ctrl-C or a signal that ends programs.

        Raises:
            FileRefused: the capture cannot be written.
        """
        end_in_order()
        try:
            server = Server(answerer, host, port)
        except ListenError as error:
            narrate(f"{error}")
            sys.exit(Exit.UNREADABLE)
        with closing(server):
            if self._record is not None:
                self._recorder = Recorder(open_capture(Path(self._record)), self._record, self.tell)
                server.tap = self._recorder
            with suppress(KeyboardInterrupt):
                yield server

    def serve(
        self, server: Server, take: Callable[[int], None] = _ignore, watched: list[int] | None = None
    ) -> None:
        """Serve until interrupted, with real-time priority where the system gives it.

        A controller keeps its 8 ms: beside six busy processes on two processors three plays of five were
        ended by a simulator without it that found their set points too late.

        Args:
            server: that listens.
            take: called with each of `watched` that can be read.
            watched: file descriptors; `take` may change it.
        """
        watched = [] if watched is None else watched
        with awaited_ends() as end, undisturbed(collecting=True):

            def take_or_end(descriptor: int) -> None:
                if descriptor == end.fileno():
                    raise KeyboardInterrupt
                take(descriptor)

            watched.append(end.fileno())
            serve(server, self._idle, take_or_end, watched)

    def end(self, summary: str) -> None:
        """Write what is left, and the summary; exit if the capture lacks something."""
        self.log.flush()
        complete = self._recorder is None or self._recorder.close()
        self.tell(summary)
        self._screen.close()
        if not complete:
            sys.exit(Exit.UNWRITABLE)

    def _idle(self) -> bool:
        self.log.idle()
        return self._recorder is not None and self._recorder.idle()


class Log:
    """Lines for stdout, made when the client has its answer, handed on at the latest after `_PATIENCE`.

    Reasons of refusals go to stderr, also where no line per call is wanted.
    """

    _PATIENCE = 20_000_000

    def __init__(self, wanted: bool, screen: Screen) -> None:
        self.calls = 0
        self._wanted = wanted
        self._screen = screen
        self._told: list[tuple[Peer, Report] | str] = []
        self._lines: list[str] = []
        self._written = 0

    def take(self, peer: Peer, report: Report) -> None:
        """Note a call."""
        self.calls += 1
        if report.answer.reason:
            self._screen.tell(reason_line(peer, report))
        if self._wanted:
            self._told.append((peer, report))

    def note(self, text: str) -> None:
        """Note something that is no call."""
        if self._wanted:
            self._told.append(f"# {text}")

    def idle(self) -> None:
        """Make the lines of what was told; hand them on if the last time is long ago."""
        self._make()
        if self._lines and time.monotonic_ns() - self._written > self._PATIENCE:
            self.flush()

    def flush(self) -> None:
        """Hand on what there is."""
        self._make()
        self._written = time.monotonic_ns()
        if self._lines:
            self._screen.show(self._lines)
            self._lines = []

    def _make(self) -> None:
        if self._told:
            told, self._told = self._told, []
            self._lines += [each if isinstance(each, str) else report_line(*each) for each in told]
