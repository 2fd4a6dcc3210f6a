"""What was observed comes back from disk as it was."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import ExitStack
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from bcapscope.capture import journal as journals
from bcapscope.capture.file import open_capture
from bcapscope.capture.journal import Journal, JournalWriter, to_bytes, to_text
from bcapscope.capture.observer import Observer
from bcapscope.protocol.frame import Frame, Problem
from bcapscope.traffic.getters import Told
from bcapscope.traffic.observation import Conversation, Direction, Endpoint, Flow, Observation, Transport
from bcapscope.traffic.question import Questions
from tests.cli.run import CAPTURES
from tests.render.scenes import scenes


@pytest.fixture
def stack() -> Iterator[ExitStack]:
    """Closes what a test opened."""
    with ExitStack() as opened:
        yield opened


def texts(told: Told) -> tuple[object, ...]:
    """Return all that an observation says; flows are compared by what they say."""
    seen, question, comments = told
    conversation = seen.flow.conversation
    ends = (seen.flow.src, seen.flow.dst, conversation.transport, conversation.side_known_by)
    return (seen._replace(flow=None), type(seen.item), seen.item.problems, ends, question, comments)  # type: ignore[arg-type]


def written(stack: ExitStack, folder: Path, told: list[Told]) -> Journal:
    writer = JournalWriter(folder)
    for seen, question, comments in told:
        writer.add(seen, question, comments)
    writer.flush()
    assert writer.count == len(told)
    writer.close()
    journal = Journal(folder)
    stack.callback(journal.close)
    assert journal.refresh() == len(journal) == len(told)
    return journal


@pytest.mark.parametrize("path", sorted(CAPTURES.glob("*.pcap*")), ids=lambda path: path.name)
def test_every_sample_comes_back(stack: ExitStack, tmp_path: Path, path: Path) -> None:
    observer, questions = Observer(), Questions()
    with open_capture(path) as capture:
        told = [
            Told(seen, questions.about(seen), observer.comments.get(seen.packet, ()))
            for seen in observer.observe(capture)
        ]
    journal = written(stack, tmp_path, told)
    for number in reversed(range(1, len(told) + 1)):
        assert texts(journal.told(number)) == texts(told[number - 1])
        assert journal.time(number) == told[number - 1].seen.time


def test_hostile_strings_come_back(stack: ExitStack, tmp_path: Path) -> None:
    told = [Told(seen, question, ("\ud800\x1b[2J",)) for seen, question in scenes()]
    journal = written(stack, tmp_path, told)
    for number, each in enumerate(told, 1):
        assert texts(journal.told(number)) == texts(each)


def test_frames_of_a_flow_share_it(stack: ExitStack, tmp_path: Path) -> None:
    with open_capture(CAPTURES / "slave-session.pcapng") as capture:
        told = [Told(seen, None) for seen in Observer().observe(capture)]
    journal = written(stack, tmp_path, told)
    assert journal.told(1).seen.flow is journal.told(3).seen.flow
    assert journal.told(1).seen.flow.conversation is journal.told(2).seen.flow.conversation


def test_more_conversations_than_are_kept(
    stack: ExitStack, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(journals, "MOST_FLOWS", 3)
    item = Frame(bytes.fromhex("0110000000010000000100000000 0004".replace(" ", "")))
    told = []
    for number in range(1, 41):
        client = Endpoint("10.0.0.2", 40_000 + number % 10)
        flow = Flow(Conversation(client, Endpoint("fd00::1%é", 5007), Transport.TCP, "x"), Direction.REQUEST)
        told.append(Told(Observation(number, number, number, flow, item, number), None))
    journal = written(stack, tmp_path, told)
    assert [texts(journal.told(number)) for number in range(1, 41)] == [texts(each) for each in told]


@pytest.mark.parametrize("number", [-1, 0, 2])
def test_numbers_that_are_not_there(stack: ExitStack, tmp_path: Path, number: int) -> None:
    seen, question = next(iter(scenes()))
    journal = written(stack, tmp_path, [Told(seen, question)])
    with pytest.raises(IndexError):
        journal.told(number)


def test_note_of_the_capture_stays_with_the_frame(stack: ExitStack, tmp_path: Path) -> None:
    seen, question = next(iter(scenes()))
    note = Problem(3, "cut", "the capture kept 3")
    noted = seen._replace(item=Frame(seen.item.raw, note))
    journal = written(stack, tmp_path, [Told(noted, question)])
    assert journal.told(1).seen.item.problems[-1] == note


@given(st.text(st.characters()))
def test_any_text_is_kept(text: str) -> None:
    assert to_text(to_bytes(text)) == text


def test_there_is_no_journal_yet(tmp_path: Path) -> None:
    with pytest.raises(FileNotFoundError):
        Journal(tmp_path)
