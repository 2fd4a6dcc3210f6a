"""Code for all commands that serve clients: reachability, log, recording and shutdown.

Output never delays a reply: separate threads write the log, the messages and the recording. Output that
cannot be written in time is dropped and counted.
"""

from __future__ import annotations

import ipaddress
import time
from collections.abc import Callable, Iterator
from contextlib import closing, contextmanager, suppress
from pathlib import Path

from bcapscope.live.background_recorder import BackgroundRecorder
from bcapscope.live.end_signals import end_signal_socket, interrupt_on_end_signals
from bcapscope.live.recorder import Recorder
from bcapscope.live.terminal_writer import TerminalWriter
from bcapscope.messages import ENGLISH_WORDS, Message, MessageFormatter
from bcapscope.player.realtime import realtime_priority
from bcapscope.render.simulator_log import call_log_line, refusal_line
from bcapscope.simulator.call_executor import CallReport
from bcapscope.simulator.simulator import Peer
from bcapscope.simulator.simulator_server import ControllerModel, SimulatorServer, serve


def reachability(host: str) -> Message:
    """Return a clause that says which computers can reach a server at this address."""
    address = ipaddress.ip_address(host.partition("%")[0])
    if address.is_loopback:
        return Message("listen.reach.machine")
    return Message("listen.reach.all" if address.is_unspecified else "listen.reach.network", host=host)


class ServerRunner:
    def __init__(self, *, quiet: bool, record: Path | None, words: MessageFormatter = ENGLISH_WORDS) -> None:
        self._terminal = TerminalWriter(words)
        self.print_message = self._terminal.write_message
        self.log = ServerCallLog(not quiet, self._terminal, words)
        self._recording_path = record
        self._recorder: BackgroundRecorder | None = None

    @contextmanager
    def listen(self, answerer: ControllerModel, host: str, port: int) -> Iterator[SimulatorServer]:
        """Listen for clients. Ctrl-C, SIGTERM and SIGHUP end the `with` block gracefully.

        Raises SimulatorListenError, or FileWriteError if the recording cannot be written.
        """
        interrupt_on_end_signals()
        with closing(SimulatorServer(answerer, host, port)) as server:
            if self._recording_path is not None:
                recorder = Recorder(self._recording_path, self._terminal.show)
                server.tap = self._recorder = BackgroundRecorder(recorder)
            with suppress(KeyboardInterrupt):
                yield server

    def serve(
        self,
        server: SimulatorServer,
        on_readable: Callable[[int], None] = lambda descriptor: None,
        watched: list[int] | None = None,
    ) -> None:
        """Serve clients until a signal arrives, with real-time priority if the operating system grants it.

        The simulated controller must keep its cycle of 8 ms. In a test with six busy processes on two
        processors, three of five runs of `play` failed without real-time priority.

        `on_readable` gets each readable descriptor of `watched`, and may change `watched`.
        """
        watched = [] if watched is None else watched
        with end_signal_socket() as end, realtime_priority(collect_garbage=True):

            def take_or_end(descriptor: int) -> None:
                if descriptor == end.fileno():
                    raise KeyboardInterrupt
                on_readable(descriptor)

            watched.append(end.fileno())
            serve(server, self._on_idle, take_or_end, watched)

    def close(self, summary: str) -> bool:
        """Write the remaining log lines and the summary. Return whether the recording is complete."""
        self.log.flush()
        complete = self._recorder is None or self._recorder.close()
        self.print_message(summary)
        self._terminal.close()
        return complete

    def _on_idle(self) -> bool:
        self.log.flush_if_due()
        return self._recorder is not None and self._recorder.on_idle()


class ServerCallLog:
    """Writes log lines to stdout. Each line is formatted after the reply, and written within about
    `_FLUSH_AFTER_NS`. The reason of a refusal is printed to stderr, even if calls are not logged.
    """

    _FLUSH_AFTER_NS = 20_000_000

    def __init__(self, wanted: bool, terminal: TerminalWriter, words: MessageFormatter) -> None:
        self.call_count = 0
        self._wanted = wanted
        self._words = words
        self._terminal = terminal
        self._pending: list[tuple[Peer, CallReport] | str] = []
        self._lines: list[str] = []
        self._flushed_at = 0

    def on_call(self, peer: Peer, report: CallReport) -> None:
        self.call_count += 1
        if report.result.reason:
            self._terminal.write_message(refusal_line(peer, report))
        if self._wanted:
            self._pending.append((peer, report))

    def add_note(self, note: Message) -> None:
        if self._wanted:
            self._pending.append(f"# {self._words.text(note)}")

    def flush_if_due(self) -> None:
        self._format_pending()
        if self._lines and time.monotonic_ns() - self._flushed_at > self._FLUSH_AFTER_NS:
            self.flush()

    def flush(self) -> None:
        self._format_pending()
        self._flushed_at = time.monotonic_ns()
        if self._lines:
            self._terminal.write_lines(self._lines)
            self._lines = []

    def _format_pending(self) -> None:
        if self._pending:
            pending, self._pending = self._pending, []
            self._lines += [
                each if isinstance(each, str) else call_log_line(*each, self._words) for each in pending
            ]
