"""The process that watches a proxy: it records, decodes, shows and judges, and never holds the relay up.

It looks every few hundredths of a second at what the relay has written into the ring. When the relay ends,
or is killed, it takes what is left, closes the recording and sums up.
"""

from __future__ import annotations

import gc
import json
import shutil
import signal
import time
from collections.abc import Iterable
from multiprocessing.connection import Connection
from multiprocessing.shared_memory import SharedMemory

from bcapscope.analysis.diagnosis import Diagnosis
from bcapscope.analysis.rules.session_rules import QUIT_IN_SLAVE_MODE
from bcapscope.live.proxy_options import CLOSE_SESSIONS, READY, ProxyOptions
from bcapscope.live.proxy_recorder import ProxyRecorder
from bcapscope.live.proxy_view import ProxyView
from bcapscope.live.relay_figures import DelayStatistics, loss_lines, rates_text, totals_text
from bcapscope.live.standard_streams import choose_palette
from bcapscope.live.terminal_writer import TerminalWriter
from bcapscope.live.watcher_priority import WatcherUrgency, lower_priority, yield_function
from bcapscope.protocol.text_format import counted
from bcapscope.proxy.record_decoder import RecordDecoder
from bcapscope.proxy.ring_buffer import RelayCounter, RingReader, RingRecord, RingRecordKind
from bcapscope.proxy.session_closer import SessionCloser
from bcapscope.proxy.silence_monitor import SilenceMonitor
from bcapscope.render.escape import printable
from bcapscope.render.findings import FindingsRenderer
from bcapscope.traffic.call import Call, PairingResult
from bcapscope.traffic.conversation_pairing import RETRY_WITHIN_NS
from bcapscope.traffic.handle_tracker import HandleTracker
from bcapscope.traffic.observation import Conversation, Transport
from bcapscope.traffic.tracker import Tracker

POLL_INTERVAL = 0.025
"""Seconds between looks at the ring."""

_DECODE_FOR = 0.024
"""Seconds of decoding between two looks, in which what comes is not recorded."""

_MAY_WAIT_SHARE = 0.25
"""Share of the ring up to which others have most of the time for themselves though more comes than a spell is
enough for: a processor that is taken costs each round trip."""

_SHOWN_WITHIN_NS = 2_000_000_000
"""ns after which what passed is shown, whatever that costs; as long as there is a processor for it."""

_REST_FACTOR, _LONGEST_REST = 1.5, 0.075
"""How long that time is, as a multiple of what a look took, and s at most."""

_STATUS_EVERY_NS = 500_000_000
_DECODING_DELAY_NS = round(3 * POLL_INTERVAL * 1e9)
"""ns that something may have passed before it is seen here."""

_NICENESS = 10
_RECORDS_AT_ONCE = 128
"""Records that are shown together."""
_RECORDS_PER_YIELD = 32
"""Records that are recorded before others have their turn."""
_FRAMES_PER_YIELD = 4
"""Frames that are decoded before they have: to ask whether they wait takes a quarter of the time of one."""

_CATCHES_UP_WITHIN = 10.0
"""Seconds that what is left may take at the end to be decoded; all of it is recorded."""


def watch_relay(memory: str, relay: Connection, options: ProxyOptions) -> bool:
    """Watch a relay until it ends.

    Args:
        memory: name of the ring's.
        relay: over which it asks and is answered; its end is the relay's.
        options: what is to be done.

    Returns:
        Whether the recording, if one was requested, is complete.
    """
    _give_relay_priority()
    screen = TerminalWriter()
    recorder = None
    try:
        if options.record is not None:
            recorder = ProxyRecorder(options.record, options.ring, screen.write_message)
    except OSError as error:
        relay.send_bytes((error.strerror or str(error)).lower().encode())
        return False
    shared = SharedMemory(memory)
    assert shared.buf is not None
    reader = RingReader(shared.buf)
    ahead = RingReader(shared.buf, ahead=True)
    relay.send_bytes(READY)
    try:
        ProxyWatcher(
            reader, options, screen, None if recorder is None else RecorderTask(ahead, recorder)
        ).run(relay)
    finally:
        if recorder is not None:
            recorder.close()
        screen.close()
        has_lost = reader.counts[RelayCounter.UNWATCHED] > 0
        for end in (reader, ahead):
            end.release()
        shared.close()
    return recorder is None or not (recorder.failed or has_lost)


def _give_relay_priority() -> None:
    """Leave the processor, and the signals that the terminal sends, to the relay."""
    for name in ("SIGINT", "SIGHUP", "SIGTERM"):
        if hasattr(signal, name):
            signal.signal(getattr(signal, name), signal.SIG_IGN)
    lower_priority(_NICENESS)
    gc.freeze()


class RecorderTask:
    """Records what the relay wrote, ahead of all that is made of it.

    Attributes:
        reader: reads for it; what it has read stays in the ring until it is decoded as well.
    """

    def __init__(self, reader: RingReader, recorder: ProxyRecorder) -> None:
        """Take a reader that is ahead of the watcher's, and what writes."""
        self.reader = reader
        self._recorder = recorder
        self._yield_cpu = yield_function(reader)

    def record_available(self) -> None:
        """Record what there is; the first look may only find how much that is."""
        until = self.reader.bytes_written
        while self.reader.position < until:
            self._recorder.add_records(self.reader.read_records(_RECORDS_PER_YIELD))
            self._yield_cpu()
        self._recorder.flush()


class ProxyWatcher:
    """Takes what the relay wrote, and does with it what is wished.

    What waits to be decoded waits in the ring, whose size is fixed. Who has gone is forgotten; beside the
    clients that are there, of whom the relay has a limit, it holds what tracker and diagnosis bound.
    """

    def __init__(
        self,
        reader: RingReader,
        options: ProxyOptions,
        terminal: TerminalWriter,
        recorder_task: RecorderTask | None = None,
    ) -> None:
        self._reader = reader
        self._options = options
        self._terminal = terminal
        self._recorder_task = recorder_task
        self._yield_cpu = yield_function(reader)
        self._written_before = self._decoded_until = 0
        self._colors = choose_palette(options.color)
        self._view = ProxyView(options.view, self._colors)
        self._record_decoder = RecordDecoder()
        self._tracker = Tracker()
        self._diagnosis = Diagnosis()
        self._handles = HandleTracker(max_ended=0)
        self._session_closer = SessionCloser(self._handles)
        self._silence_monitor = SilenceMonitor()
        self._delays = DelayStatistics()
        self._advice = ""
        self._has_sent_closing = False
        self._call_count = self._retry_count = 0
        self._next_status_at = self._status_shown_at = 0
        self._counts_before: tuple[int, ...] = ()

    def run(self, relay: Connection) -> None:
        """Watch until the relay is gone and all that it left is taken."""
        asked = False
        while True:
            rest = self.poll()
            try:
                if asked and not self._reader.bytes_waiting:
                    relay.send_bytes(self._closing_requests())
                    asked = False
                if relay.poll(rest):
                    said = relay.recv_bytes()
                    asked = said == CLOSE_SESSIONS
                    self._advice = self._advice if asked else said.decode()
            except (EOFError, OSError):
                break
        until = time.monotonic() + _CATCHES_UP_WITHIN
        while self._reader.bytes_waiting and time.monotonic() < until:
            self.poll()
        self._finish()

    def poll(self) -> float:
        """Take what the relay has written: record all of it, then decode, show and judge for a spell.

        Returns:
            Seconds that others may have for themselves before the next look.
        """
        began = time.monotonic()
        if self._recorder_task is not None:
            self._recorder_task.record_available()
        is_busy = self._decode()
        self._do_periodic_work()
        took = time.monotonic() - began
        return (
            min(max(POLL_INTERVAL, took * _REST_FACTOR), _LONGEST_REST)
            if not is_busy or self._may_rest()
            else 0
        )

    def _may_rest(self) -> bool:
        """Tell whether what was not decoded can wait: more comes, there is room and time, and no haste."""
        reader, before = self._reader, self._written_before
        self._written_before = reader.bytes_written
        if (
            self._written_before == before
            or reader.urgency >= WatcherUrgency.ALL
            or time.time_ns() - self._decoded_until > _SHOWN_WITHIN_NS
        ):
            return False
        return reader.fill_ratio < _MAY_WAIT_SHARE

    def _decode(self) -> bool:
        """Decode; tell whether the spell was too short."""
        until = time.monotonic() + _DECODE_FOR
        recorded = None if self._recorder_task is None else self._recorder_task.reader.position
        while records := self._reader.read_records(_RECORDS_AT_ONCE, recorded):
            self._decode_records(records)
            if time.monotonic() >= until:
                return True
        return False

    def _decode_records(self, records: list[RingRecord]) -> None:
        lines: list[str | bytes] = []
        for count, (seen, note) in enumerate(self._record_decoder.decode(records)):
            lines += self._view.frame_lines(seen, note)
            self._diagnosis.on_observation(seen)
            settled = self._tracker.observe(seen)
            if settled:
                lines += self._settled_lines(settled)
            if count % _FRAMES_PER_YIELD == 0:
                self._yield_cpu()
        self._terminal.write_lines(lines)
        self._decoded_until = records[-1].sent_at or records[-1].received_at
        self._delays.add_records(records)
        self._show_relay_messages(records)
        for conversation, why in self._record_decoder.pop_closed_clients():
            self._close_conversation(conversation, printable(why))

    def _show_relay_messages(self, records: Iterable[RingRecord]) -> None:
        for record in records:
            if record.kind is RingRecordKind.NOTICE:
                self._terminal.write_message(printable(record.data.decode("utf-8", "replace")))

    def _close_conversation(self, conversation: Conversation, why: str) -> None:
        """Settle the calls of a client that has gone, tell what it left behind, and forget it."""
        self._terminal.write_lines(self._settled_lines(self._tracker.close_conversation(conversation)))
        left = self._session_closer.remove_client(conversation)
        self._handles.close_conversation(conversation)
        self._diagnosis.on_conversation_closed(conversation)
        self._view.drop_conversation(conversation)
        if left and not (self._has_sent_closing and conversation.transport is Transport.UDP):  # that is told
            self._terminal.write_message(f"{conversation.client} is gone ({why}) while {left}")

    def _settled_lines(self, settled: Iterable[PairingResult]) -> list[str | bytes]:
        lines: list[str | bytes] = []
        for item in settled:
            subject = None
            if isinstance(item, Call):
                self._call_count += 1
                self._retry_count += item.retries
                subject = self._handles.on_call(item)
                self._session_closer.on_call(item)
            self._diagnosis.on_pairing_result(item)
            lines += self._view.call_lines(item, subject)
        return lines

    def _do_periodic_work(self) -> None:
        """Do what is due whether or not anything passes."""
        now = time.time_ns()
        color = self._colors
        if not self._reader.bytes_waiting:
            self._terminal.write_lines(self._settled_lines(self._tracker.expire(now - _DECODING_DELAY_NS)))
            heard = self._record_decoder.last_heard
            sending = (
                (each, heard[each]) for each in self._session_closer.clients_in_slave_mode() if each in heard
            )
            for sentence in self._silence_monitor.check(sending, now - _DECODING_DELAY_NS):
                self._terminal.write_message(
                    f"{color.problem}{QUIT_IN_SLAVE_MODE.severity}{color.reset} "
                    f"{QUIT_IN_SLAVE_MODE.id}: {sentence}"
                )
        for finding in self._diagnosis.new_findings():
            head = f"{color.problem}{finding.severity}{color.reset} {finding.rule}"
            self._terminal.write_message(f"{head}: {printable(finding.sentence)}")
        warning = self._delays.pop_warning()
        if warning:
            self._terminal.write_message("; ".join(filter(None, (warning, self._advice))))
        if now >= self._next_status_at:
            self._publish_status(now)

    def _publish_status(self, now: int) -> None:
        """Tell how it goes: the relay, for whoever asks it, and the terminal."""
        for place, figure in enumerate(self._delays.figures()):
            self._reader.figures[place] = figure
        self._next_status_at = now + _STATUS_EVERY_NS
        if self._terminal.shows_status:
            self._show_status(now)

    def _show_status(self, now: int) -> None:
        counts = tuple(self._reader.counts)
        seconds = (now - self._status_shown_at) / 1e9
        parts = [counted(self._call_count, "call"), f"{self._retry_count} retries"]
        parts += [
            rates_text(counts, self._counts_before, seconds),
            self._delays.status_text(),
            *loss_lines(counts),
        ]
        self._terminal.set_status(" · ".join(part for part in parts if part))
        self._counts_before, self._status_shown_at = counts, now

    def _closing_requests(self) -> bytes:
        """Return how the relay can end the sessions that are open: JSON, client and frames in hex."""
        # What was answered is over, though a late retry of it might still come.
        self._terminal.write_lines(
            self._settled_lines(self._tracker.expire(time.time_ns() + RETRY_WITHIN_NS))
        )
        self._has_sent_closing = True
        numbers = self._record_decoder.client_numbers
        goodbyes = []
        for farewell in self._session_closer.close_sequences():
            number = numbers.get(farewell.conversation)
            if number is not None:
                goodbyes.append((number, farewell.open_state, [each.hex() for each in farewell.requests]))
        return json.dumps(goodbyes).encode()

    def _skip_undecoded(self) -> None:
        """Pass over what there is no time for, but for what the relay tells."""
        if self._reader.bytes_waiting:
            self._terminal.write_message(
                "what passed last was not looked at, as it takes too long; a recording has it"
            )
        while self._reader.bytes_waiting:
            self._show_relay_messages(self._reader.read_records())

    def _finish(self) -> None:
        """Settle what is open and sum up."""
        while self._recorder_task is not None and self._recorder_task.reader.bytes_waiting:
            self._recorder_task.record_available()
        self._skip_undecoded()
        self._terminal.write_lines(self._settled_lines(self._tracker.close()))
        findings = self._diagnosis.finish()
        tell, counts = self._terminal.write_message, tuple(self._reader.counts)
        calls = f"{counted(self._call_count, 'call')}, {counted(self._retry_count, 'retry', 'retries')}"
        tell(f"{calls}; {totals_text(counts)}")
        for line in (*loss_lines(counts), *self._delays.summary_lines()):
            tell(line)
        if self._record_decoder.observation_count:
            width = shutil.get_terminal_size().columns
            for line in FindingsRenderer(self._colors, width).lines(findings, self._diagnosis.totals):
                tell(line)
