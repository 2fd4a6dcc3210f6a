"""The process that watches a proxy. The watcher records, decodes, displays and diagnoses the traffic, and
never delays the relay.

Every few hundredths of a second, the watcher reads the new records in the ring. When the relay ends or is
killed, the watcher reads the remaining records, closes the recording and prints a summary.
"""

from __future__ import annotations

import gc
import shutil
import signal
import time
from collections.abc import Iterable
from multiprocessing.connection import Connection
from multiprocessing.shared_memory import SharedMemory

import msgspec

from bcapscope.analysis.diagnosis import Diagnosis
from bcapscope.analysis.rules.rule_table import RULES
from bcapscope.errors import FileWriteError
from bcapscope.live.proxy_options import (
    CLOSE_SESSIONS,
    READY,
    ClosingRequests,
    ProxyOptions,
    WatcherSubscriber,
)
from bcapscope.live.proxy_recorder import ProxyRecorder
from bcapscope.live.proxy_view import ProxyView
from bcapscope.live.recorder import Recorder
from bcapscope.live.relay_figures import DelayStatistics, losses, rates, totals
from bcapscope.live.relayed_traffic import RelayedTraffic
from bcapscope.live.standard_streams import choose_palette
from bcapscope.live.terminal_writer import TerminalWriter
from bcapscope.live.watcher_priority import WatcherUrgency, lower_priority, yield_function
from bcapscope.messages import Message, MessageFormatter
from bcapscope.messages.message_codec import decode_message, encode_message
from bcapscope.messages.os_errors import os_reason
from bcapscope.messages.places import Count, joined_clauses
from bcapscope.proxy.ring_buffer import RelayCounter, RingReader, RingRecord, RingRecordKind
from bcapscope.proxy.session_closer import SessionCloser
from bcapscope.proxy.silence_monitor import SilenceMonitor
from bcapscope.render.escape import printable
from bcapscope.render.findings import FindingsRenderer, finding_sentence, words_for
from bcapscope.traffic.handle_tracker import HandleTracker
from bcapscope.traffic.observation import Conversation, Observation, Transport
from bcapscope.traffic.pairing_windows import RETRY_WITHIN_NS
from bcapscope.traffic.pipeline import Pipeline
from bcapscope.traffic.slave_mode_tracker import SlaveModeTracker

POLL_INTERVAL = 0.025
"""Usual time in seconds between two polls of the ring."""

_DECODE_FOR = 0.024
"""Maximum time in seconds for decoding between two polls, because nothing is recorded meanwhile."""

_MAY_WAIT_SHARE = 0.25
"""While less than this share of the ring is filled, the watcher may pause and leave records undecoded.
Without pauses, the watcher would keep a processor busy, and each round trip through the proxy would take
longer.
"""

_SHOWN_WITHIN_NS, _PUBLISHED_WITHIN_NS = 2_000_000_000, 200_000_000
"""Maximum age in ns of undecoded traffic. While undecoded traffic is older, the watcher does not pause. The
first value applies without a subscriber, and the second value with a subscriber.
"""

_REST_FACTOR, _LONGEST_REST = 1.5, 0.075
"""The pause after a poll: its length relative to the duration of the poll, and its maximum in seconds."""

_STATUS_EVERY_NS = 500_000_000
_DECODING_DELAY_NS = round(3 * POLL_INTERVAL * 1e9)
"""Assumed maximum time in ns between the arrival of a datagram and its decoding by the watcher."""

_NICENESS = 10
_RECORDS_AT_ONCE = 128
"""Maximum number of records that the watcher decodes before it displays them."""
_RECORDS_PER_YIELD = 32
"""Number of records that the watcher writes to the recording before it yields the processor."""
_FRAMES_PER_YIELD = 4
"""Number of frames that the watcher decodes before it yields the processor (`sched_yield`). The watcher does
not yield after each frame, because yielding takes a quarter of the time that decoding a frame takes.
"""

_CATCHES_UP_WITHIN = 10.0
"""Maximum time in seconds to decode the remaining records at the end. Recording has no time limit."""


def watch_relay(memory: str, relay: Connection, options: ProxyOptions) -> bool:
    """Watch a relay until it closes its end of the pipe. Return False if the recording is incomplete."""
    _give_relay_priority()
    screen = TerminalWriter(MessageFormatter(options.view.language))
    recorder = subscriber = None
    try:
        if options.open_subscriber is not None:
            subscriber = options.open_subscriber()
        if options.record is not None:
            recorder = ProxyRecorder(
                Recorder(options.record, screen.show, options.ring),
                keeps_packet_numbers=subscriber is not None,
            )
    except (FileWriteError, OSError) as error:
        reason = error.reason if isinstance(error, FileWriteError) else os_reason(error)
        relay.send_bytes(encode_message(reason))
        return False
    shared = SharedMemory(memory)
    assert shared.buf is not None
    reader = RingReader(shared.buf)
    ahead = RingReader(shared.buf, ahead=True)
    relay.send_bytes(READY)
    try:
        ProxyWatcher(
            reader, options, screen, None if recorder is None else RecorderTask(ahead, recorder), subscriber
        ).run(relay)
    finally:
        is_complete = recorder is None or recorder.close()
        screen.close()
        has_lost = reader.counts[RelayCounter.UNWATCHED] > 0
        for end in (reader, ahead):
            end.release()
        shared.close()
    return recorder is None or (is_complete and not has_lost)


def _give_relay_priority() -> None:
    for name in ("SIGINT", "SIGHUP", "SIGTERM"):
        if hasattr(signal, name):
            signal.signal(getattr(signal, name), signal.SIG_IGN)
    lower_priority(_NICENESS)
    gc.freeze()


class RecorderTask:
    """Records the relay's traffic. Each record stays in the ring until the watcher has decoded the record."""

    def __init__(self, reader: RingReader, recorder: ProxyRecorder) -> None:
        self.reader = reader
        self.next_packet_numbers = recorder.next_packet_numbers
        self._recorder = recorder
        self._yield_cpu = yield_function(reader)

    def record_available(self) -> None:
        """Write the complete records in the ring to the recording."""
        until = self.reader.bytes_written
        while self.reader.position < until and (records := self.reader.read_records(_RECORDS_PER_YIELD)):
            self._recorder.add_records(records)
            self._yield_cpu()
        self._recorder.flush()


class ProxyWatcher:
    """Reads the relay's records from the ring. Decodes, displays and diagnoses the traffic.

    Memory is limited: undecoded records wait in the ring, and all subscribers limit their data.
    """

    def __init__(
        self,
        reader: RingReader,
        options: ProxyOptions,
        terminal: TerminalWriter,
        recorder_task: RecorderTask | None = None,
        subscriber: WatcherSubscriber | None = None,
    ) -> None:
        self._reader = reader
        self._terminal = terminal
        self._recorder_task = recorder_task
        self._subscriber = subscriber
        self._shown_within_ns = _SHOWN_WITHIN_NS if subscriber is None else _PUBLISHED_WITHIN_NS
        self._yield_cpu = yield_function(reader)
        self._written_before = self._decoded_until = 0
        self._colors = choose_palette(options.color)
        self._view = ProxyView(options.view, self._colors)
        self._diagnosis = Diagnosis() if subscriber is None else subscriber.diagnosis
        self._slave_mode = SlaveModeTracker()
        handles = HandleTracker(max_ended=0)
        self._session_closer = SessionCloser(handles, self._slave_mode)
        self._pipeline = Pipeline(
            self._session_closer,
            *((self._diagnosis,) if subscriber is None else subscriber.subscribers),
            self._view,
            handles=handles,
            slave_mode=self._slave_mode,
        )
        self._traffic = RelayedTraffic(self._pipeline, self._show_frame)
        self._decoder = self._traffic.decoder
        self._silence_monitor = SilenceMonitor()
        self._delays = DelayStatistics()
        self._words = MessageFormatter(options.view.language)
        self._advice: Message | None = None
        self._has_sent_closing = False
        self._next_status_at = self._status_shown_at = 0
        self._counts_before: tuple[int, ...] = ()

    def run(self, relay: Connection) -> None:
        must_close = False
        while True:
            rest = self.poll()
            try:
                if must_close and not self._reader.bytes_waiting:
                    relay.send_bytes(self._closing_requests())
                    must_close = False
                if relay.poll(rest):
                    message = relay.recv_bytes()
                    must_close = message == CLOSE_SESSIONS
                    self._advice = self._advice if must_close else decode_message(message)
            except (EOFError, OSError):
                break
        until = time.monotonic() + _CATCHES_UP_WITHIN
        while self._reader.bytes_waiting and time.monotonic() < until:
            self.poll()
        self._finish()

    def poll(self) -> float:
        """Record traffic, then decode for at most `_DECODE_FOR`. Return the seconds until the next poll."""
        began = time.monotonic()
        if self._recorder_task is not None:
            self._recorder_task.record_available()
        is_busy = self._decode()
        self._do_periodic_work()
        took = time.monotonic() - began
        if is_busy and not self._may_rest():
            return 0
        return min(max(POLL_INTERVAL, took * _REST_FACTOR), _LONGEST_REST)

    def _may_rest(self) -> bool:
        """Return whether new traffic arrives, the ring has space, and no undecoded record is too old."""
        reader, before = self._reader, self._written_before
        self._written_before = reader.bytes_written
        if (
            self._written_before == before
            or reader.urgency >= WatcherUrgency.ALL
            or time.time_ns() - self._decoded_until > self._shown_within_ns
        ):
            return False
        return reader.fill_ratio < _MAY_WAIT_SHARE

    def _decode(self) -> bool:
        """Decode for at most `_DECODE_FOR` seconds. Return True if undecoded records remain."""
        until = time.monotonic() + _DECODE_FOR
        recorded = None if self._recorder_task is None else self._recorder_task.reader.position
        while records := self._reader.read_records(_RECORDS_AT_ONCE, recorded):
            self._decode_records(records)
            if time.monotonic() >= until:
                return True
        return False

    def _decode_records(self, records: list[RingRecord]) -> None:
        for count, (seen, note) in enumerate(self._decoder.decode(records, self._packets_of(records))):
            self._traffic.add(seen, note)
            if count % _FRAMES_PER_YIELD == 0:
                self._yield_cpu()
        self._write_lines()
        self._decoded_until = records[-1].sent_at or records[-1].received_at
        self._delays.add_records(records)
        self._show_relay_messages(records)
        for conversation, why in self._decoder.pop_closed_clients():
            self._close_conversation(conversation, why)

    def _show_frame(self, seen: Observation, note: Message | None) -> None:
        self._view.add_frame(seen, note)
        if self._subscriber is not None:
            self._subscriber.on_frame(seen, "" if note is None else self._words.text(note))

    def _packets_of(self, records: list[RingRecord]) -> list[int] | None:
        if self._subscriber is None or self._recorder_task is None:
            return None
        return self._recorder_task.next_packet_numbers(len(records))

    def _show_relay_messages(self, records: Iterable[RingRecord]) -> None:
        for record in records:
            if record.kind is RingRecordKind.NOTICE:
                self._terminal.show(decode_message(record.data))

    def _write_finding(self, severity: str, rule: str, sentence: str) -> None:
        head = f"{self._colors.problem}{severity}{self._colors.reset} {rule}"
        self._terminal.write_message(f"{head}: {printable(sentence)}")

    def _close_conversation(self, conversation: Conversation, why: Message) -> None:
        self._traffic.close_conversation(conversation)
        self._write_lines()
        left = self._session_closer.pop_left_open(conversation)
        # After the watcher has sent the closing requests, the relay reports which UDP sessions were closed.
        is_reported = self._has_sent_closing and conversation.transport is Transport.UDP
        if left is not None and not is_reported:
            client = str(conversation.client)
            self._terminal.show(Message("session.left-open", client=client, reason=why, state=left))

    def _write_lines(self) -> None:
        self._terminal.write_lines(self._view.lines)
        self._view.lines = []

    def _do_periodic_work(self) -> None:
        now = time.time_ns()
        if not self._reader.bytes_waiting:
            self._traffic.expire(now - _DECODING_DELAY_NS)
            self._write_lines()
            heard = self._decoder.last_heard
            sending = (
                (each, heard[each]) for each in self._slave_mode.clients_in_slave_mode() if each in heard
            )
            for sentence in self._silence_monitor.check(sending, self._traffic.analysed_until):
                rule, text = RULES["quit-in-slave-mode"], self._words.text(sentence)
                self._write_finding(rule.severity, rule.id, text)
        words = words_for(self._words, self._diagnosis.totals())
        for finding in self._diagnosis.new_findings():
            self._write_finding(finding.severity, finding.rule, finding_sentence(finding, words))
        warning = self._delays.pop_warning()
        if warning is not None:
            advice = () if self._advice is None else (self._advice,)
            self._write_clauses((warning, *advice))
        if self._subscriber is not None:
            self._subscriber.report_if_due(self._reader.counts[RelayCounter.CLIENTS])
        if now >= self._next_status_at:
            self._publish_status(now)

    def _publish_status(self, now: int) -> None:
        for place, figure in enumerate(self._delays.figures()):
            self._reader.figures[place] = figure
        self._next_status_at = now + _STATUS_EVERY_NS
        if self._terminal.shows_status:
            self._show_status(now)

    def _show_status(self, now: int) -> None:
        counts = tuple(self._reader.counts)
        seconds = (now - self._status_shown_at) / 1e9
        parts = (
            self._call_totals(),
            rates(counts, self._counts_before, seconds),
            self._delays.status(),
            *losses(counts),
        )
        self._terminal.set_status(" · ".join(self._words.text(part) for part in parts if part is not None))
        self._counts_before, self._status_shown_at = counts, now

    def _call_totals(self) -> Message:
        calls, retries = self._view.call_count, self._view.retry_count
        return Message("relay.calls", calls=Count(calls, "call"), retries=Count(retries, "retry"))

    def _write_clauses(self, clauses: Iterable[Message]) -> None:
        message = joined_clauses(clauses)
        if message is not None:
            self._terminal.show(message)

    def _closing_requests(self) -> bytes:
        # Do not wait for further retries of answered calls: complete the calls now.
        self._traffic.flush()
        self._pipeline.expire(time.time_ns() + RETRY_WITHIN_NS)
        self._write_lines()
        self._has_sent_closing = True
        numbers = self._decoder.client_numbers
        return msgspec.json.encode(
            [
                ClosingRequests(
                    numbers[each.conversation],
                    b"" if each.open_state is None else encode_message(each.open_state),
                    each.requests,
                )
                for each in self._session_closer.close_sequences()
                if each.conversation in numbers
            ]
        )

    def _skip_undecoded(self) -> None:
        """Skip the records that were not decoded in time, but still print the messages from the relay."""
        if self._reader.bytes_waiting:
            self._terminal.show(Message("watcher.skipped"))
        while self._reader.bytes_waiting:
            self._show_relay_messages(self._reader.read_records())

    def _finish(self) -> None:
        while self._recorder_task is not None and self._recorder_task.reader.bytes_waiting:
            self._recorder_task.record_available()
        self._skip_undecoded()
        self._traffic.flush()
        self._pipeline.finish()
        self._write_lines()
        if self._subscriber is not None:
            self._subscriber.close(self._decoded_until)
        findings = self._diagnosis.findings()
        counts = tuple(self._reader.counts)
        self._write_clauses((self._call_totals(), *totals(counts)))
        for message in (*losses(counts), *self._delays.summary()):
            self._terminal.show(message)
        if self._decoder.observation_count:
            width = shutil.get_terminal_size().columns
            renderer = FindingsRenderer(self._colors, width, words=self._words)
            for line in renderer.lines(findings, self._diagnosis.totals()):
                self._terminal.write_message(line)
