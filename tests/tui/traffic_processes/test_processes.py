"""Reading, judging, searching and saving, each as its process does it."""

from __future__ import annotations

import io
import os
import threading
import time
from array import array
from collections.abc import Iterator
from contextlib import contextmanager
from io import BytesIO
from itertools import repeat
from pathlib import Path
from typing import BinaryIO, cast

import pytest

from bcapscope.capture.call_store import CallStore
from bcapscope.capture.capture_file import open_capture
from bcapscope.capture.observation_store import ObservationStore
from bcapscope.capture.packet import Interface, Packet
from bcapscope.render.findings import diagnosis_summary as verdict_line
from bcapscope.traffic.call import Call
from bcapscope.traffic.call_verdict import CallVerdict, Outcome
from bcapscope.traffic.capture_point import CapturePoint
from bcapscope.traffic.filter.field_table import RecordKind
from bcapscope.tui.traffic_processes import reader_process as readings
from bcapscope.tui.traffic_processes import traffic_publisher
from bcapscope.tui.traffic_processes.process_messages import (
    ReadJob,
    ReadProgress,
    SaveJob,
    SearchMatches,
    SearchRequest,
    TrafficAnalysis,
    receive_messages,
    send_message,
)
from bcapscope.tui.traffic_processes.reader_process import TrafficReader
from bcapscope.tui.traffic_processes.save_process import save_packets
from bcapscope.tui.traffic_processes.search_process import TrafficSearch
from tests.analysis.scenes import HOME, ROBOT, Story
from tests.capture.test_rotating_recording import SmallDisk
from tests.cli.late_retry import late_retry
from tests.cli.run import CAPTURES, run
from tests.cli.test_capture_end import captured, in_slave_mode
from tests.samples.calls import r8s, text
from tests.tui.marks import strip_styles

LIMIT = 20.0


def read(folder: Path, path: Path, own: bool = False) -> list[ReadProgress | TrafficAnalysis]:
    """Read a capture as the process does and return what it tells."""
    reports = BytesIO()
    job = ReadJob(folder=str(folder), path=str(path), own_clients=own)
    TrafficReader(job, reports, threading.Event(), threading.Event()).run()
    return sent_reports(reports)


def sent_reports(reports: BytesIO) -> list[ReadProgress | TrafficAnalysis]:
    reports.seek(0)
    return list(
        receive_messages(
            reports, cast("type[ReadProgress | TrafficAnalysis]", ReadProgress | TrafficAnalysis)
        )
    )


def lines(folder: Path) -> tuple[int, int]:
    journal = ObservationStore(folder)
    calls = CallStore(folder, journal)
    try:
        return journal.refresh(), calls.refresh()
    finally:
        journal.close()
        calls.close()


@pytest.mark.parametrize("name", ["exchanges.pcap", "slave-mode-lost.pcapng"])
def test_what_is_read_is_what_the_command_line_tells(tmp_path: Path, name: str) -> None:
    path = CAPTURES / name
    verdict, end = read(tmp_path, path)[-2:]
    assert isinstance(end, ReadProgress)
    assert end.ended
    assert isinstance(verdict, TrafficAnalysis)
    frames = run("decode", path).lines
    calls = run("calls", path).lines
    assert lines(tmp_path) == (len(frames), len(calls))
    severities = [cause.severity for cause in verdict.findings]
    assert verdict_line(severities, verdict.examined) == run("diagnose", path).lines[-1]
    assert verdict.slave_sessions


@pytest.mark.parametrize(("own", "rules"), [(False, ["unclean-quit"]), (True, [])])
def test_a_session_of_our_own_that_is_idle_has_not_vanished(
    tmp_path: Path, own: bool, rules: list[str]
) -> None:
    """HALT has a line of its own, opened anew for the robot, and only that one speaks while nobody calls."""
    story = Story()
    tester, halt = story.client(50001), story.client(50002)
    tester.open()
    halt.open(50)
    halt.execute(45_000, "CurJnt")
    path = tmp_path / "capture.pcap"
    path.write_bytes(story.capture())
    verdict, _ = read(tmp_path, path, own)[-2:]
    assert isinstance(verdict, TrafficAnalysis)
    assert [cause.rule for cause in verdict.findings] == rules


@pytest.mark.parametrize("goes_on_for", [500, 2_000, 11_000])
def test_packets_of_other_protocols_tell_the_screen_too_how_long_a_capture_goes_on(
    tmp_path: Path, goes_on_for: float
) -> None:
    path = tmp_path / "capture.pcap"
    path.write_bytes(captured(in_slave_mode(), goes_on_for))
    verdict = read(tmp_path, path)[-2]
    assert isinstance(verdict, TrafficAnalysis)
    severities = [cause.severity for cause in verdict.findings]
    assert verdict_line(severities, verdict.examined) == run("diagnose", path).lines[-1]
    session_lines = [strip_styles(line) for line in verdict.slave_sessions]
    assert session_lines == run("slave", path).lines[: len(session_lines)]


def test_damage_and_missing_files_are_told(tmp_path: Path) -> None:
    cut = tmp_path / "cut.pcapng"
    cut.write_bytes((CAPTURES / "slave-session.pcapng").read_bytes()[:-10])
    for name, path, why in (("a", cut, "the capture ends inside"), ("b", tmp_path / "none", "no such file")):
        (tmp_path / name).mkdir()
        *_, end = read(tmp_path / name, path)
        assert isinstance(end, ReadProgress)
        assert why in end.problem
    assert lines(tmp_path / "a")[0] == 517


def test_a_growing_capture_is_judged_again_and_again(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(traffic_publisher, "ANALYSIS_INTERVAL", 0.0)
    monkeypatch.setattr(traffic_publisher, "FLUSH_INTERVAL", 0.0)
    data = (CAPTURES / "retry-story.pcapng").read_bytes()
    path = tmp_path / "growing.pcapng"
    path.write_bytes(data[: len(data) // 2])
    (tmp_path / "journal").mkdir()
    reports, ended = BytesIO(), threading.Event()
    job = ReadJob(folder=str(tmp_path / "journal"), path=str(path), follow=True)
    reading = TrafficReader(job, reports, ended, threading.Event())
    thread = threading.Thread(target=reading.run)
    thread.start()
    try:
        _wait(lambda: 0 < lines(tmp_path / "journal")[0] < 6)
        with path.open("ab") as file:
            file.write(data[len(data) // 2 :])
        _wait(lambda: lines(tmp_path / "journal")[0] == 6)
        assert thread.is_alive()
    finally:
        ended.set()
        thread.join(LIMIT)
    found = sent_reports(reports)
    assert isinstance(found[-1], ReadProgress)
    assert found[-1].ended
    assert len({verdict.examined for verdict in found if isinstance(verdict, TrafficAnalysis)}) >= 2


class _OverSoon(threading.Event):
    """Is set as soon as somebody waits for it."""

    def wait(self, timeout: float | None = None) -> bool:
        self.set()
        return super().wait(timeout)


def test_what_is_open_in_a_capture_of_long_ago_is_not_given_up_for_its_age(tmp_path: Path) -> None:
    story = in_slave_mode()
    story.talkers[0].ask(200, "Robot_Execute", ROBOT, text("slvMove"), r8s(*HOME))
    path, reports = tmp_path / "capture.pcap", BytesIO()
    path.write_bytes(captured(story, 100))
    job = ReadJob(folder=str(tmp_path), path=str(path), follow=True)
    TrafficReader(job, reports, _OverSoon(), threading.Event()).run()
    verdict = sent_reports(reports)[-2]
    assert isinstance(verdict, TrafficAnalysis)
    severities = [cause.severity for cause in verdict.findings]
    assert verdict_line(severities, verdict.examined) == run("diagnose", path).lines[-1]
    journal = ObservationStore(tmp_path)
    calls = CallStore(tmp_path, journal)
    journal.refresh()
    last = calls.read_call(calls.refresh() - 1).settled
    assert isinstance(last, Call)
    assert last.outcome is Outcome.CAPTURE_ENDED
    calls.close()
    journal.close()


def test_nothing_more_is_read_when_nothing_more_is_wanted(tmp_path: Path) -> None:
    unwanted, reports = threading.Event(), BytesIO()
    unwanted.set()
    job = ReadJob(folder=str(tmp_path), path=str(CAPTURES / "slave-session.pcapng"))
    TrafficReader(job, reports, threading.Event(), unwanted).run()
    assert lines(tmp_path)[0] == readings._BATCH_MASK + 1


def test_what_is_there_when_its_source_ends_is_read_to_the_end(tmp_path: Path) -> None:
    ended, reports = threading.Event(), BytesIO()
    ended.set()
    job = ReadJob(folder=str(tmp_path), path=str(CAPTURES / "slave-session.pcapng"), follow=True)
    TrafficReader(job, reports, ended, threading.Event()).run()
    assert lines(tmp_path)[0] == 518


def _wait(true: object) -> None:
    assert callable(true)
    end = time.monotonic() + LIMIT
    while not true():
        assert time.monotonic() < end
        time.sleep(0.01)


@pytest.fixture
def journal(tmp_path: Path) -> Path:
    read(tmp_path, CAPTURES / "slave-session.pcapng")
    return tmp_path


_OPEN: list[BinaryIO] = []
"""Pipes that stay open as long as the threads that write into them, which is to the end of the process."""


class _Search:
    """A search in a thread, with pipes as its process has them."""

    def __init__(self, folder: Path) -> None:
        answers_out, answers_in = os.pipe()
        self.answers = os.fdopen(answers_out, "rb")
        _OPEN.append(self.answers)
        self._written = os.fdopen(answers_in, "wb")
        self.searching = TrafficSearch(folder, self._written)
        self.thread = threading.Thread(target=self.searching.run, daemon=True)
        self.thread.start()

    def ask(self, generation: int, kind: str, expression: str) -> None:
        self.searching.requests.put(SearchRequest(generation, kind, expression))

    def found(self, generation: int, there: int) -> list[int]:
        rows = array("I")
        for message in receive_messages(self.answers, SearchMatches):
            if message.generation == generation:
                rows.frombytes(message.rows)
                if message.searched == there:
                    return list(rows)
        raise AssertionError("the search ended")


@pytest.fixture
def search(journal: Path) -> Iterator[_Search]:
    made = _Search(journal)
    yield made
    made.ask(0, "frame", "")


@pytest.mark.filterwarnings("ignore::ResourceWarning")  # the process ends with its job
@pytest.mark.filterwarnings("ignore::pytest.PytestUnraisableExceptionWarning")
@pytest.mark.parametrize(
    ("kind", "there", "command", "expression"),
    [
        ("frame", 518, "decode", "command == Motor or hresult != S_OK"),
        ("frame", 518, "decode", "serial > 250"),
        ("call", 257, "calls", "latency > 30ms"),
        ("call", 257, "calls", 'command ~ "slv"'),
    ],
)
def test_the_search_finds_what_the_command_line_finds(
    search: _Search, kind: str, there: int, command: str, expression: str
) -> None:
    search.ask(1, RecordKind.FRAME, "length > 0")
    search.ask(2, kind, expression)
    wanted = run(command, CAPTURES / "slave-session.pcapng", "-f", expression).lines
    assert search.found(2, there) == [int(line.split()[0]) for line in wanted]


@pytest.mark.filterwarnings("ignore::ResourceWarning")  # the process ends with its job
@pytest.mark.filterwarnings("ignore::pytest.PytestUnraisableExceptionWarning")
def test_what_is_asked_again_is_not_told_twice(search: _Search) -> None:
    search.ask(1, RecordKind.CALL, "latency > 30ms")
    found = search.found(1, 257)
    search.ask(2, RecordKind.FRAME, "serial > 250")
    generations = []
    for message in receive_messages(search.answers, SearchMatches):
        generations.append(message.generation)
        if message.generation == 2:
            break
    assert found
    assert generations == [2]


@pytest.mark.filterwarnings("ignore::ResourceWarning")
def test_saving_makes_a_new_file_only(tmp_path: Path) -> None:
    source, target = CAPTURES / "retry-story.pcapng", tmp_path / "new.pcapng"
    assert save_packets(SaveJob(str(source), str(target), {2: "why?"}, 4)) is None
    with open_capture(target) as capture:
        found = [packet[4] for packet in capture]
    assert len(found) == 4
    assert [number for number, comments in enumerate(found, 1) if "why?" in comments] == [2]
    before = target.read_bytes()
    assert "exists" in str(save_packets(SaveJob(str(source), str(target), {})))
    assert target.read_bytes() == before
    assert "no such file" in str(save_packets(SaveJob(str(source), str(tmp_path / "no" / "a"), {})))
    assert "cannot be opened" in str(save_packets(SaveJob(str(tmp_path / "none"), str(tmp_path / "b"), {})))


def test_messages_come_through_a_pipe_that_gives_little_at_a_time() -> None:
    class Slow(io.RawIOBase):
        def __init__(self, data: bytes) -> None:
            self.rest = data

        def read(self, size: int = -1) -> bytes:
            data, self.rest = self.rest[: min(size, 3)], self.rest[min(size, 3) :]
            return data

    stream = BytesIO()
    asks = [SearchRequest(1, "frame", "軸 == 1"), SearchRequest(2, "call", "")]
    for ask in asks:
        send_message(stream, ask)
    assert list(receive_messages(Slow(stream.getvalue()), SearchRequest)) == asks


def test_a_live_capture_on_a_full_disk_ends_with_a_reason_and_a_whole_packet(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    @contextmanager
    def endless(_: str) -> Iterator[_Endless]:
        yield _Endless()

    SmallDisk(tmp_path, 5_000, monkeypatch)
    monkeypatch.setattr(readings, "open_live_capture", endless)
    live = readings._LiveCapture("eth0", tmp_path / readings.LIVE_FILE)
    live.start(threading.Event())
    _wait(lambda: live.problem is not None)
    assert str(live.problem) == "the packets cannot be stored: no space left on device"
    with open_capture(live.path) as capture:
        assert 5 < len(list(capture)) < 20


class _Endless:
    """A live capture that never ends."""

    lost = 0

    def __iter__(self) -> Iterator[Packet]:
        return repeat((1, bytes(400), 400, Interface(1, "eth0"), ()))


@pytest.mark.parametrize(
    ("taken_at", "verdict"),
    [(None, CallVerdict.CANNOT_TELL), (CapturePoint.CLIENT, CallVerdict.REPLY_LOST)],
)
def test_the_place_of_the_capture_decides_whether_a_reply_was_lost(
    tmp_path: Path, taken_at: CapturePoint | None, verdict: CallVerdict
) -> None:
    job = ReadJob(folder=str(tmp_path), path=str(late_retry(tmp_path)), taken_at=taken_at)
    inbox = BytesIO()
    send_message(inbox, job)
    inbox.seek(0)
    (received,) = receive_messages(inbox, ReadJob)
    TrafficReader(received, BytesIO(), threading.Event(), threading.Event()).run()
    journal = ObservationStore(tmp_path)
    calls = CallStore(tmp_path, journal)
    try:
        journal.refresh(), calls.refresh()
        settled = calls.read_call(0).settled
        assert isinstance(settled, Call)
        assert settled.verdict is verdict
    finally:
        journal.close()
        calls.close()


@pytest.mark.parametrize(
    "message",
    [
        ReadJob(path="a\udc80.pcapng", taken_at=CapturePoint.CLIENT),
        SaveJob("a\udc80.pcapng", "b\udcff.pcapng", {1: "two\nlines", 20: "\ud83d"}),
        ReadProgress(1, 2, packets="a\udc80.pcapng"),
        SearchMatches(1, bytes(range(256)) * 1000, 7),
    ],
    ids=lambda message: type(message).__name__,
)
def test_a_message_arrives_as_it_was_sent(message: object) -> None:
    """A name of a file need not be UTF-8, and rows may be any bytes."""
    pipe = BytesIO()
    for _ in range(2):
        send_message(pipe, message)
    cut = BytesIO(pipe.getvalue()[:-1])
    pipe.seek(0)
    assert list(receive_messages(pipe, type(message))) == [message, message]
    assert list(receive_messages(cut, type(message))) == [message]
