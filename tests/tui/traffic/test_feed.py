"""The screen's side of the processes: they are started, heard, and ended."""

from __future__ import annotations

import threading
from collections.abc import Callable
from pathlib import Path

import pytest

from bcapscope.tui.traffic.feed import Doubt, Feed, News
from bcapscope.tui.traffic.report import Matches, Progress
from tests.cli.run import CAPTURES

LIMIT = 30.0


@pytest.fixture(autouse=True)
def cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setattr("platformdirs.user_cache_path", lambda *names, **more: tmp_path)
    return tmp_path


class Ear:
    """Hears what a feed tells, in its threads."""

    def __init__(self, feed: Feed) -> None:
        self.heard: list[News] = []
        self._news = threading.Condition()
        feed.attach(self.take)

    def take(self, told: News) -> None:
        with self._news:
            self.heard.append(told)
            self._news.notify_all()

    def wait(self, true: Callable[[News], bool]) -> None:
        with self._news:
            assert self._news.wait_for(lambda: any(map(true, self.heard)), LIMIT)


def ended(told: News) -> bool:
    return isinstance(told, Progress) and told.ended


def test_a_feed_reads_searches_saves_and_leaves_nothing_behind(tmp_path: Path, cache: Path) -> None:
    feed = Feed(path=str(CAPTURES / "retry-story.pcapng"))
    ear = Ear(feed)
    ear.wait(ended)
    feed.progress = next(filter(ended, ear.heard))  # type: ignore[assignment]  # it is one
    assert feed.open()
    assert feed.journal is not None
    assert feed.journal.refresh() == 6
    generation = feed.ask("frame", "kind == response")
    ear.wait(lambda told: isinstance(told, Matches) and told.generation == generation and told.searched == 6)
    wanted = feed.saving(str(tmp_path / "new.pcapng"), {1: "x"})
    assert feed.save(wanted) == ""
    assert "exists" in feed.save(wanted)
    assert list(cache.glob("traffic-*")) != []
    feed.close()
    assert list(cache.glob("traffic-*")) == []


def test_what_was_told_before_anybody_listened_is_told_then() -> None:
    feed = Feed(path=str(CAPTURES / "retry-story.pcapng"))
    try:
        feed._reader.wait(LIMIT)
        ear = Ear(feed)
        ear.wait(ended)
    finally:
        feed.close()


def test_a_reader_that_dies_is_told_of() -> None:
    feed = Feed(path=str(CAPTURES / "retry-story.pcapng"), follow=True)
    try:
        ear = Ear(feed)
        feed._reader.kill()
        ear.wait(lambda told: isinstance(told, Progress) and bool(told.trouble))
    finally:
        feed.close()


def test_a_search_that_died_is_begun_anew() -> None:
    feed = Feed(path=str(CAPTURES / "retry-story.pcapng"))
    try:
        ear = Ear(feed)
        ear.wait(ended)
        feed.ask("frame", "frame > 1")
        assert feed._searcher is not None
        feed._searcher.kill()
        feed._searcher.wait(LIMIT)
        generation = feed.ask("frame", "frame > 2")
        ear.wait(lambda told: isinstance(told, Matches) and told.generation == generation)
    finally:
        feed.close()


def test_a_source_that_ends_is_read_to_its_end_and_doubted_aloud() -> None:
    feed = Feed(path=str(CAPTURES / "retry-story.pcapng"), follow=True)
    try:
        ear = Ear(feed)
        feed.doubt("The proxy has ended: it was killed")
        feed.stop()
        ear.wait(ended)
        assert Doubt("The proxy has ended: it was killed") in ear.heard
        assert feed.open()
        assert feed.journal is not None
        assert feed.journal.refresh() == 6
        feed.stop()  # once more, when it has ended
    finally:
        feed.close()
