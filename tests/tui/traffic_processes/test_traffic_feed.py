"""The screen's side of the processes: they are started, heard, and ended."""

from __future__ import annotations

import threading
from collections.abc import Callable
from io import BytesIO
from pathlib import Path

import pytest

from bcapscope.tui.traffic_processes.process_messages import (
    NO_ANALYSIS,
    ReadJob,
    ReadProgress,
    SearchMatches,
    send_message,
)
from bcapscope.tui.traffic_processes.reader_process import TrafficReader
from bcapscope.tui.traffic_processes.traffic_feed import (
    FeedUpdate,
    SourceProblem,
    TrafficFeed,
    watcher_job,
)
from tests.cli.run import CAPTURES

LIMIT = 30.0


@pytest.fixture(autouse=True)
def cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setattr("platformdirs.user_cache_path", lambda *names, **more: tmp_path)
    return tmp_path


class Ear:
    """Hears what a feed tells, in its threads."""

    def __init__(self, feed: TrafficFeed) -> None:
        self.heard: list[FeedUpdate] = []
        self._news = threading.Condition()
        feed.subscribe(self.take)

    def take(self, update: FeedUpdate) -> None:
        with self._news:
            self.heard.append(update)
            self._news.notify_all()

    def wait(self, true: Callable[[FeedUpdate], bool]) -> None:
        with self._news:
            assert self._news.wait_for(lambda: any(map(true, self.heard)), LIMIT)


def ended(update: FeedUpdate) -> bool:
    return isinstance(update, ReadProgress) and update.ended


def test_a_feed_reads_searches_saves_and_leaves_nothing_behind(tmp_path: Path, cache: Path) -> None:
    feed = TrafficFeed(ReadJob(path=str(CAPTURES / "retry-story.pcapng")))
    ear = Ear(feed)
    ear.wait(ended)
    feed.progress = next(filter(ended, ear.heard))  # type: ignore[assignment]  # it is one
    assert feed.open_journal()
    assert feed.journal is not None
    assert feed.journal.refresh() == 6
    generation = feed.search("frame", "kind == response")
    ear.wait(
        lambda update: (
            isinstance(update, SearchMatches) and update.generation == generation and update.searched == 6
        )
    )
    wanted = feed.make_save_job(str(tmp_path / "new.pcapng"), {1: "x"})
    assert feed.save(wanted) == ""
    assert "exists" in feed.save(wanted)
    assert list(cache.glob("traffic-*")) != []
    feed.close()
    assert list(cache.glob("traffic-*")) == []


def test_what_was_told_before_anybody_listened_is_told_then() -> None:
    feed = TrafficFeed(ReadJob(path=str(CAPTURES / "retry-story.pcapng")))
    try:
        assert feed._reader is not None
        feed._reader.wait(LIMIT)
        ear = Ear(feed)
        ear.wait(ended)
    finally:
        feed.close()


class _Reports(BytesIO):
    """Reports of a watcher; `over` is set when all have been read."""

    def __init__(self) -> None:
        super().__init__()
        self.over = threading.Event()

    def close(self) -> None:
        self.over.set()
        super().close()


def test_of_what_nobody_listened_to_only_the_latest_is_kept(tmp_path: Path) -> None:
    reports = _Reports()
    for clients in range(3):
        send_message(reports, ReadProgress(clients=clients))
    send_message(reports, NO_ANALYSIS)
    send_message(reports, ReadProgress(ended=True))
    reports.seek(0)
    feed = TrafficFeed(watcher_job(tmp_path, tmp_path / "proxy.pcapng"), reports)
    try:
        assert reports.over.wait(LIMIT)
        assert Ear(feed).heard == [NO_ANALYSIS, ReadProgress(ended=True)]
    finally:
        feed.close()


def test_a_reader_that_dies_is_told_of() -> None:
    feed = TrafficFeed(ReadJob(path=str(CAPTURES / "retry-story.pcapng"), follow=True))
    try:
        ear = Ear(feed)
        assert feed._reader is not None
        feed._reader.kill()
        ear.wait(lambda update: isinstance(update, ReadProgress) and bool(update.problem))
    finally:
        feed.close()


def test_a_search_that_died_is_begun_anew() -> None:
    feed = TrafficFeed(ReadJob(path=str(CAPTURES / "retry-story.pcapng")))
    try:
        ear = Ear(feed)
        ear.wait(ended)
        feed.search("frame", "frame > 1")
        assert feed._searcher is not None
        feed._searcher.kill()
        feed._searcher.wait(LIMIT)
        generation = feed.search("frame", "frame > 2")
        ear.wait(lambda update: isinstance(update, SearchMatches) and update.generation == generation)
    finally:
        feed.close()


def test_a_source_that_ends_is_read_to_its_end_and_doubted_aloud() -> None:
    feed = TrafficFeed(ReadJob(path=str(CAPTURES / "retry-story.pcapng"), follow=True))
    try:
        ear = Ear(feed)
        feed.report_source_problem("The proxy ended: it was killed")
        feed.stop_reading()
        ear.wait(ended)
        assert SourceProblem("The proxy ended: it was killed") in ear.heard
        assert feed.open_journal()
        assert feed.journal is not None
        assert feed.journal.refresh() == 6
        feed.stop_reading()  # once more, when it has ended
    finally:
        feed.close()


def test_what_a_watcher_publishes_is_shown_and_searched_without_a_reader(tmp_path: Path) -> None:
    job = watcher_job(tmp_path, tmp_path / "proxy.pcapng")
    reports = BytesIO()
    read = ReadJob(folder=job.folder, path=str(CAPTURES / "retry-story.pcapng"))
    TrafficReader(read, reports, threading.Event(), threading.Event()).run()
    reports.seek(0)
    feed = TrafficFeed(job, reports)
    try:
        ear = Ear(feed)
        ear.wait(ended)
        assert feed._reader is None
        assert feed.is_live
        feed.stop_reading()
        assert feed.open_journal()
        assert feed.journal is not None
        assert feed.journal.refresh() == 6
        generation = feed.search("frame", "kind == response")
        ear.wait(lambda update: isinstance(update, SearchMatches) and update.generation == generation)
    finally:
        feed.close()
    assert tmp_path.exists()


def test_a_watcher_that_ends_without_a_word_has_ended(tmp_path: Path) -> None:
    job = watcher_job(tmp_path, tmp_path / "proxy.pcapng")
    feed = TrafficFeed(job, BytesIO())
    try:
        ear = Ear(feed)
        ear.wait(ended)
        assert ear.heard == [ReadProgress(ended=True, packets=job.path)]
    finally:
        feed.close()
