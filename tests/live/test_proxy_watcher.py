"""The watcher of a proxy: what it holds after many clients have come and gone, and what it tells of them."""

from __future__ import annotations

import gc
import json
import time
from collections import Counter
from collections.abc import Iterator, Sequence
from functools import lru_cache
from multiprocessing.connection import Connection
from pathlib import Path
from types import SimpleNamespace
from typing import cast

import pytest

from bcapscope.analysis import finding_collector, report_data
from bcapscope.analysis.slave import controller_state, session_detector
from bcapscope.capture import socket_recording
from bcapscope.capture.capture_file import open_capture
from bcapscope.live import proxy_watcher
from bcapscope.live.proxy_options import ProxyOptions, TrafficFormat, ViewOptions, WatcherSubscriber
from bcapscope.live.proxy_recorder import ProxyRecorder
from bcapscope.live.proxy_watcher import ProxyWatcher, RecorderTask
from bcapscope.live.recorder import Recorder
from bcapscope.live.terminal_writer import TerminalWriter
from bcapscope.live.watcher_priority import WatcherUrgency
from bcapscope.messages import Message
from bcapscope.protocol.codec.arguments import Argument
from bcapscope.protocol.codec.frame import encode_frame
from bcapscope.protocol.codec.frame_template import FrameTemplate
from bcapscope.protocol.codec.variant import VT, Variant
from bcapscope.proxy.ring_buffer import (
    RING_OVERHEAD,
    RelayCounter,
    RingReader,
    RingRecord,
    RingRecordKind,
    RingWriter,
)
from bcapscope.render import frame_line
from bcapscope.render.escape import printable
from bcapscope.traffic.filter.field_table import RecordKind
from tests.cli.run import run
from tests.english import encoded, english

MS = 1_000_000
TEXT = Variant(VT.BSTR, "")

FEW = 80
LATEST = (
    (report_data, "MAX_TIMELINES"),
    (report_data, "MAX_SESSIONS"),
    (finding_collector, "MAX_CALLS"),
    (controller_state, "MAX_CALLS"),
    (session_detector, "MAX_SESSIONS"),
    (frame_line, "MAX_TEMPLATES"),
)
"""Where much is kept of the latest clients: less of it is filled by few of them."""


class Silent(TerminalWriter):
    """Keeps what it is to show."""

    def __init__(self) -> None:
        self.lines = 0
        self.shown: list[bytes | str] = []
        self.told: list[str] = []
        self.shows_status = False

    def write_lines(self, lines: Sequence[bytes | str]) -> None:
        self.lines += len(lines)
        self.shown += lines

    def write_message(self, text: str) -> None:
        self.told.append(text)

    def show(self, message: Message) -> None:
        self.told.append(printable(english(message)))


class Chain:
    """Ring, watcher and recorder, without the relay and the processes."""

    def __init__(
        self,
        record: Path | None,
        shown: RecordKind | None,
        form: TrafficFormat = TrafficFormat.LINE,
        subscriber: WatcherSubscriber | None = None,
    ) -> None:
        memory = memoryview(bytearray(RING_OVERHEAD + (1 << 20)))
        self.ring = RingWriter(memory)
        self.screen = Silent()
        options = ProxyOptions(record, None, ViewOptions(shown, form), "never")
        recorder_task = self._recorder = None
        if record is not None:
            self._recorder = ProxyRecorder(
                Recorder(record, lambda message: self.screen.write_message(str(message))),
                keeps_packet_numbers=subscriber is not None,
            )
            recorder_task = RecorderTask(RingReader(memory, ahead=True), self._recorder)
        self._reader = RingReader(memory)
        self._watcher = ProxyWatcher(self._reader, options, self.screen, recorder_task, subscriber)
        self.now = time.time_ns()

    def look(self) -> None:
        """Let it take all that there is."""
        while self._reader.bytes_waiting:
            self._watcher.poll()
        self._watcher.poll()

    def end(self) -> None:
        """Let it find that the relay has ended."""
        self._watcher.run(cast(Connection, Ended()))
        if self._recorder is not None:
            self._recorder.close()

    def say(self, client: int, up: bool, raw: bytes) -> None:
        self.now += MS
        assert self.ring.write_record(up, client, self.now, self.now + 1000, raw)

    def meet(self, client: int, transport: str) -> None:
        ends = [["10.0.0.2", 1024 + client % 60_000], ["10.0.0.3", 5008], ["10.0.0.3", 9], ["10.0.0.1", 5007]]
        self.ring.counts[RelayCounter.CLIENTS] += 1
        self.ring.write_required(
            RingRecordKind.CLIENT_OPENED, client, json.dumps([transport, *ends]).encode(), self.now
        )

    def session(self, client: int, transport: str) -> None:
        """Let a client connect, send a few set points, and vanish in slave mode."""
        self.meet(client, transport)
        for serial, (function, arguments, values) in enumerate(calls(client), 1):
            self.say(client, True, encode_frame(serial, 0, function, arguments))
            self.say(client, False, encode_frame(serial, 0, 0, values))
        self.say(client, True, b"no frame")
        self.ring.write_required(RingRecordKind.CLIENT_CLOSED, client, encoded("reset"), self.now)


def calls(client: int) -> Iterator[tuple[int, tuple[Variant, ...], tuple[Variant, ...]]]:
    yield 1, (TEXT,), ()
    yield 3, (TEXT, TEXT, TEXT, TEXT), (Variant(VT.I4, client),)
    yield 7, (Variant(VT.I4, client), Variant(VT.BSTR, "Arm"), TEXT), (Variant(VT.I4, client + 1),)
    robot = Variant(VT.I4, client + 1)
    yield 64, (robot, Variant(VT.BSTR, "slvChangeMode"), Variant(VT.I4, 0x102)), ()
    for number in range(5):
        pose = Variant.array(VT.R8, (float(number), 0.0, 90.0, 0.0, 90.0, 0.0, 0.0, 0.0))
        yield 64, (robot, Variant(VT.BSTR, "slvMove"), pose), ()


def held() -> Counter[str]:
    """Count the objects of ours that are there; of forms of frames as many are kept as `layout` says."""
    gc.collect()
    found = (type(each) for each in gc.get_objects())
    return Counter(
        f"{kind.__module__}.{kind.__name__}"
        for kind in found
        if str(kind.__module__).startswith("bcapscope.") and kind not in (FrameTemplate, Variant, Argument)
    )


@pytest.mark.parametrize(
    ("transport", "shown", "form"),
    [("udp", RecordKind.FRAME, TrafficFormat.LINE), ("tcp", RecordKind.CALL, TrafficFormat.JSON)],
    ids=["udp", "tcp"],
)
def test_clients_that_have_gone_are_forgotten_with_all_that_they_hold(
    transport: str, shown: RecordKind, form: TrafficFormat, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for module, most in LATEST:
        monkeypatch.setattr(module, most, 16)
    header = socket_recording._datagram_header.__wrapped__
    monkeypatch.setattr(socket_recording, "_datagram_header", lru_cache(16)(header))
    others = held()  # what tests before this one have left
    chain = Chain(tmp_path / "all.pcapng", shown, form)

    def come_and_go(clients: range) -> Counter[str]:
        for client in clients:
            chain.session(client, transport)
            if client % 8 == 0:
                chain.look()
        chain.look()
        chain.screen.told.clear()
        chain.screen.shown.clear()
        return held()

    # After the first ones all that is kept of the latest few, and of forms of frames, is filled.
    few, many = come_and_go(range(1, FEW + 1)), come_and_go(range(FEW + 1, 2 * FEW + 1))
    grown = {name: (few[name], count) for name, count in many.items() if count > few[name] * 1.05 + 16}
    assert grown == {}
    many -= others
    assert sum(many.values()) < 7_000, many.most_common(9)
    assert chain.screen.lines >= 2 * FEW * 9
    chain.end()


class Records(list[RingRecord]):
    """A recorder that keeps the records instead of writing them."""

    def add_records(self, records: Sequence[RingRecord]) -> None:
        self += records

    def next_packet_numbers(self, count: int) -> list[int]:
        return list(range(count))

    def flush(self) -> None:
        pass


def test_new_records_wait_for_the_next_poll() -> None:
    memory = memoryview(bytearray(RING_OVERHEAD + (1 << 20)))
    ring, records = RingWriter(memory), Records()
    task = RecorderTask(RingReader(memory, ahead=True), cast(ProxyRecorder, records))
    assert ring.write_record(True, 1, MS, MS, b"first")
    task.record_available()
    assert records == []
    assert ring.write_record(True, 1, MS, MS, b"second")
    task.record_available()
    assert [record.data for record in records[:1]] == [b"first"]
    task.record_available()
    assert [record.data for record in records] == [b"first", b"second"]


class Ended:
    """The relay's end of the link, when the relay has ended."""

    def poll(self, seconds: float) -> bool:
        raise EOFError


def test_what_there_is_no_time_for_at_the_end_is_recorded_and_what_is_told_is_told(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(proxy_watcher, "_CATCHES_UP_WITHIN", 0.0)
    chain = Chain(tmp_path / "all.pcapng", RecordKind.FRAME)
    for client in range(1, 21):
        chain.session(client, "udp")
    chain.ring.write_required(RingRecordKind.NOTICE, 0, encoded("fault loss: injected 7 times"), chain.now)
    chain.end()
    assert "fault loss: injected 7 times" in chain.screen.told
    assert any("the latest traffic was not shown, because" in text for text in chain.screen.told)
    with open_capture(str(tmp_path / "all.pcapng")) as capture:
        assert sum(1 for _ in capture) == 20 * (2 * 18 + 2)


def test_a_client_that_vanishes_in_slave_mode_is_told() -> None:
    chain = Chain(None, None)
    chain.session(1, "tcp")
    chain.look()
    told = [text for text in chain.screen.told if "is gone" in text]
    assert told == ["10.0.0.2:1025 is gone (reset) while slave mode is on"]


@pytest.mark.parametrize(("kind", "how"), [(RingRecordKind.RESET, "reset"), (RingRecordKind.END, "closed")])
def test_a_controller_that_hangs_up_is_named_live_as_in_the_recording(
    kind: RingRecordKind, how: str, tmp_path: Path
) -> None:
    path = tmp_path / "all.pcapng"
    chain = Chain(path, None)
    chain.meet(1, "tcp")
    for serial, (function, arguments, values) in enumerate(calls(1), 1):
        chain.say(1, True, encode_frame(serial, 0, function, arguments))
        chain.say(1, False, encode_frame(serial, 0, 0, values))
    chain.ring.write_required(kind, 1, b"", chain.now + MS)
    chain.ring.write_required(kind, 1, b"", 0, sent_at=chain.now + 2 * MS)
    chain.ring.write_required(RingRecordKind.CLIENT_CLOSED, 1, encoded("why"), chain.now + 3 * MS)
    chain.look()
    told = [text for text in chain.screen.told if f"10.0.0.1:5007 {how} the connection" in text]
    assert len(told) == 1
    chain.end()
    summed_up = [text for text in chain.screen.told if "controller-hung-up" in text]
    assert len(summed_up) == 2  # as it arose, and at the end
    for server in ("10.0.0.1:5007", "10.0.0.3:5008"):
        found = run("diagnose", path, "--filter", f"server == '{server}'").out
        assert f"{server} {how} the connection" in " ".join(found.split())


def test_others_have_a_tick_for_themselves_while_more_comes_but_not_once_all_is_there(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(proxy_watcher, "_DECODE_FOR", 0.0)
    clock = SimpleNamespace(monotonic=lambda: 0.0, time_ns=time.time_ns)  # decoding takes no time
    monkeypatch.setattr(proxy_watcher, "time", clock)
    chain = Chain(None, None)
    chain.meet(1, "udp")

    def rest_after(*, more: bool) -> float:
        if more:
            chain.say(1, True, encode_frame(1, 0, 1, (TEXT,)))
        return chain._watcher.poll()

    rests = [rest_after(more=more) for more in (True, True, True, False)]
    assert rests == [proxy_watcher.POLL_INTERVAL, proxy_watcher.POLL_INTERVAL, proxy_watcher.POLL_INTERVAL, 0]
    assert rest_after(more=False) == proxy_watcher.POLL_INTERVAL  # there was nothing to do
    rest_after(more=True)
    chain.ring.urgency = WatcherUrgency.ALL
    assert rest_after(more=True) == 0
    chain.ring.urgency = WatcherUrgency.NONE
    assert rest_after(more=True) == proxy_watcher.POLL_INTERVAL
    chain.now -= 3000 * MS  # what comes is shown that late
    assert rest_after(more=True) == proxy_watcher.POLL_INTERVAL
    assert rest_after(more=True) == 0


def test_a_client_that_falls_silent_in_slave_mode_is_told_as_a_finding() -> None:
    chain = Chain(None, None)
    chain.now -= 10_000 * MS
    chain.meet(1, "udp")
    for serial, (function, arguments, values) in enumerate(calls(1), 1):
        chain.say(1, True, encode_frame(serial, 0, function, arguments))
        chain.say(1, False, encode_frame(serial, 0, 0, values))
    chain.look()
    chain.look()
    told = [text for text in chain.screen.told if "quit-in-slave-mode" in text]
    assert len(told) == 1, chain.screen.told
    assert "10.0.0.2:1025 has sent nothing for " in told[0]
