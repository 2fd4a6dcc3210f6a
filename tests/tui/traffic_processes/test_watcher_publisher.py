"""What the watcher of a proxy hands to the screen."""

from __future__ import annotations

import errno
import io
import os
import threading
import time
from pathlib import Path
from typing import Any, BinaryIO, cast

import pytest

from bcapscope.capture.call_store import CallStore
from bcapscope.capture.capture_file import open_capture
from bcapscope.capture.observation_store import ObservationStore, ObservationStoreWriter
from bcapscope.capture.packet_decoder import PacketDecoder
from bcapscope.protocol.codec.frame import encode_frame
from bcapscope.traffic.call import Call
from bcapscope.traffic.call_verdict import CallVerdict
from bcapscope.traffic.filter.field_table import RecordKind
from bcapscope.tui.traffic_processes import traffic_publisher
from bcapscope.tui.traffic_processes.process_messages import (
    NO_ANALYSIS,
    ReadJob,
    ReadProgress,
    TrafficAnalysis,
    receive_messages,
)
from bcapscope.tui.traffic_processes.watcher_publisher import ReportSender, WatcherPublisher
from tests.english import encoded
from tests.live.test_proxy_watcher import MS, Chain

REPORT = cast("type[ReadProgress | TrafficAnalysis]", ReadProgress | TrafficAnalysis)


class Sent(io.RawIOBase):
    """Keeps what is sent."""

    def __init__(self) -> None:
        self.data = io.BytesIO()

    def write(self, data: Any) -> int:
        return self.data.write(data)

    def reports(self) -> list[ReadProgress | TrafficAnalysis]:
        self.data.seek(0)
        return list(receive_messages(self.data, REPORT))


@pytest.fixture(autouse=True)
def at_once(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(traffic_publisher, "ANALYSIS_INTERVAL", 0.0)
    monkeypatch.setattr(traffic_publisher, "FLUSH_INTERVAL", 0.0)


def published(folder: Path) -> tuple[Chain, Sent]:
    """Return a watcher that records and publishes, and its reports."""
    sent = Sent()
    job = ReadJob(folder=str(folder), path=str(folder / "all.pcapng"), follow=True)
    publisher = WatcherPublisher(job, ReportSender(sent))
    return Chain(folder / "all.pcapng", RecordKind.FRAME, subscriber=publisher), sent


@pytest.mark.parametrize("transport", ["udp", "tcp"])
def test_the_screen_gets_what_it_would_read_in_the_recording(transport: str, tmp_path: Path) -> None:
    chain, sent = published(tmp_path)
    for client in range(1, 5):
        chain.session(client, transport)
        chain.look()
    chain.end()
    journal = ObservationStore(tmp_path)
    calls = CallStore(tmp_path, journal)
    shown = [journal.read_frame(number).observation for number in range(1, journal.refresh() + 1)]
    with open_capture(tmp_path / "all.pcapng") as capture:
        recorded = list(PacketDecoder(interface_prefix="clients of ").decode(capture))
    found, wanted = (
        [(seen.item.raw, seen.time, seen.packet, seen.flow.direction) for seen in traffic]
        for traffic in (shown, recorded)
    )
    assert sorted(found) == sorted(wanted)
    assert len(found) == 4 * 19
    assert calls.refresh() == 4 * 9
    calls.close()
    journal.close()
    *_, analysis, end = sent.reports()
    assert isinstance(analysis, TrafficAnalysis)
    assert (analysis.examined.frames, analysis.examined.clients) == (4 * 19, 4)
    assert analysis.findings
    assert analysis.slave_sessions
    assert analysis.statistics
    assert end == ReadProgress(ended=True, clients=4, packets=str(tmp_path / "all.pcapng"))


def test_nothing_is_reported_before_the_first_client(tmp_path: Path) -> None:
    chain, sent = published(tmp_path)
    chain.look()
    assert not sent.reports()
    chain.end()
    assert not sent.reports()


def test_files_that_cannot_be_written_are_reported_and_the_watcher_goes_on(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    chain, sent = published(tmp_path)
    chain.session(1, "udp")
    chain.look()

    def full(_: ObservationStoreWriter) -> None:
        raise OSError(errno.ENOSPC, "No space left on device")

    with monkeypatch.context() as patch:
        patch.setattr(ObservationStoreWriter, "flush", full)
        chain.session(2, "udp")
        chain.look()
    chain.session(3, "udp")
    chain.look()
    chain.end()
    *_, end = sent.reports()
    assert end == ReadProgress(
        ended=True, problem="no space left on device", clients=2, packets=str(tmp_path / "all.pcapng")
    )
    with open_capture(tmp_path / "all.pcapng") as capture:
        assert len(list(PacketDecoder(interface_prefix="clients of ").decode(capture))) == 3 * 19


def test_a_screen_that_stands_still_delays_nothing_and_gets_the_latest() -> None:
    out, into = os.pipe()
    sender = ReportSender(io.FileIO(into, "wb"))
    big = TrafficAnalysis((), NO_ANALYSIS.examined, ["x" * 1000] * 1000, [])
    began = time.monotonic()
    for number in range(1000):
        sender.send(ReadProgress(clients=number))
        sender.send(big)
    sender.send(ReadProgress(ended=True))
    assert time.monotonic() - began < 5
    found: list[ReadProgress | TrafficAnalysis] = []
    with cast(BinaryIO, os.fdopen(out, "rb")) as reports:
        thread = threading.Thread(target=lambda: found.extend(receive_messages(reports, REPORT)))
        thread.start()
        sender.close()
        sender._stream.close()
        thread.join(20)
    assert found[-1] == ReadProgress(ended=True)
    assert found[-2] == big
    assert len(found) < 100


def test_a_screen_that_has_gone_ends_the_sending() -> None:
    out, into = os.pipe()
    os.close(out)
    with io.FileIO(into, "wb") as stream:
        sender = ReportSender(stream)
        sender.send(ReadProgress())
        sender.close()
        assert not sender._thread.is_alive()


def test_the_screen_gets_the_replies_that_a_rule_dropped(tmp_path: Path) -> None:
    chain, _ = published(tmp_path)
    chain.meet(1, "udp")
    request, retry, reply = encode_frame(1, 0, 2), encode_frame(2, 1, 2), encode_frame(2, 0, 0)
    chain.say(1, True, request)
    chain.now += MS
    dropped = encode_frame(1, 0, 0)
    assert chain.ring.write_record(False, 1, chain.now, 0, dropped, note=encoded("lossy: dropped"))
    chain.say(1, True, retry)
    chain.say(1, False, reply)
    chain.end()
    journal = ObservationStore(tmp_path)
    calls = CallStore(tmp_path, journal)
    frames = [journal.read_frame(number) for number in range(1, journal.refresh() + 1)]
    calls.refresh()
    call = calls.read_call(0).settled
    calls.close()
    journal.close()
    assert sorted(each.observation.item.raw for each in frames) == sorted([request, retry, reply, dropped])
    (lost,) = [each.observation.number for each in frames if each.observation.item.raw == dropped]
    assert frames[lost - 1].comments == ("lossy: dropped",)
    assert isinstance(call, Call)
    assert call.verdict is CallVerdict.REPLY_LOST
    assert [(each.number, each.item.raw) for each in call.lost_replies] == [(lost, dropped)]
    assert [(seen.note, seen.was_lost_between) for seen in call.joined_frames if seen.note] == [
        ("lossy: dropped", True)
    ]
