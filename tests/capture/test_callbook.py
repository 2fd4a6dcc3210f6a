"""Calls come back from disk as they settled."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import ExitStack
from pathlib import Path

import pytest

from bcapscope.capture.callbook import Callbook, CallbookWriter
from bcapscope.capture.file import open_capture
from bcapscope.capture.journal import Journal, JournalWriter
from bcapscope.capture.observer import Observer
from bcapscope.render.call import CallRenderer
from bcapscope.traffic.exchange import Exchange, Settled, Stray
from bcapscope.traffic.handles import Handles, Thing
from bcapscope.traffic.question import Questions
from bcapscope.traffic.tracker import Tracker
from tests.cli.run import CAPTURES


@pytest.fixture
def stack() -> Iterator[ExitStack]:
    """Closes what a test opened."""
    with ExitStack() as opened:
        yield opened


def told(call: Settled, subject: Thing | None) -> list[object]:
    """Return all that is said of a call."""
    lines: list[object] = list(CallRenderer().tree(call, subject))
    if isinstance(call, Exchange):
        lines += [call.verdict, call.outcome, call.habits, call.gone_on, call.silent, call.skipped_handles]
        lines.append(call.let_go)
        lines += [call.last.number, call.activity, call.rtt]
    return lines


def written(
    stack: ExitStack, folder: Path, path: Path
) -> tuple[Callbook, list[tuple[Settled, Thing | None]]]:
    journal, book = JournalWriter(folder), CallbookWriter(folder)
    tracker, handles, questions = Tracker(), Handles(), Questions()
    rows: list[tuple[Settled, Thing | None]] = []

    def settle(settled: Settled) -> None:
        subject = handles.follow(settled) if isinstance(settled, Exchange) else None
        rows.append((settled, subject))
        book.add(settled, subject)

    with open_capture(path) as capture:
        for seen in Observer().observe(capture):
            journal.add(seen, questions.about(seen))
            for settled in tracker.observe(seen):
                settle(settled)
            if not seen.number % 50:
                journal.flush()
                book.flush()
    for settled in tracker.close():
        settle(settled)
    journal.flush()
    book.flush()
    assert book.count == len(rows)
    journal.close()
    book.close()
    reader = Journal(folder)
    reader.refresh()
    calls = Callbook(folder, reader)
    stack.callback(reader.close)
    stack.callback(calls.close)
    assert calls.refresh() == len(calls) == len(rows)
    return calls, rows


@pytest.mark.parametrize("path", sorted(CAPTURES.glob("*.pcap*")), ids=lambda path: path.name)
def test_every_call_of_the_samples_comes_back(stack: ExitStack, tmp_path: Path, path: Path) -> None:
    calls, rows = written(stack, tmp_path, path)
    for index, (settled, subject) in enumerate(rows):
        row = calls.row(index)
        assert told(row.settled, row.subject) == told(settled, subject)
        frames = [event.seen.number for event in settled.events] if isinstance(settled, Exchange) else []
        if isinstance(settled, Stray):
            frames = [settled.seen.number]
        assert {calls.row_of(frame) for frame in frames} == {index}


def test_frames_that_belong_to_no_call_yet(stack: ExitStack, tmp_path: Path) -> None:
    calls, _ = written(stack, tmp_path, CAPTURES / "retry-story.pcapng")
    assert calls.row_of(7) is None
    assert calls.row_of(10**9) is None


@pytest.mark.parametrize("index", [-1, 1])
def test_rows_that_are_not_there(stack: ExitStack, tmp_path: Path, index: int) -> None:
    calls, _ = written(stack, tmp_path, CAPTURES / "retry-story.pcapng")
    with pytest.raises(IndexError):
        calls.row(index)


def test_links_are_seen_when_they_were_written_later(stack: ExitStack, tmp_path: Path) -> None:
    calls, rows = written(stack, tmp_path, CAPTURES / "exchanges.pcap")
    assert calls.row_of(1) == 0
    with (tmp_path / "links").open("r+b") as file:
        file.write(len(rows).to_bytes(4, "little"))
    assert calls.row_of(1) == 0
    calls.refresh()
    assert calls.row_of(1) == len(rows) - 1
