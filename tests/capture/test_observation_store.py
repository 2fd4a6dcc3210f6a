"""What was observed comes back from disk as it was."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import ExitStack
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from bcapscope.capture import observation_store as journals
from bcapscope.capture.capture_file import open_capture
from bcapscope.capture.observation_store import (
    ObservationStore,
    ObservationStoreWriter,
    decode_text,
    encode_text,
)
from bcapscope.capture.packet_decoder import PacketDecoder
from bcapscope.protocol.codec.frame import Frame
from bcapscope.traffic.call_kind import RecentRequests
from bcapscope.traffic.filter.getters import AnnotatedFrame
from bcapscope.traffic.observation import (
    SERVER_PORT,
    Conversation,
    Direction,
    Endpoint,
    Flow,
    Observation,
    Transport,
)
from tests.cli.run import CAPTURES
from tests.render.scenes import scenes
from tests.samples.problems import problem_of


@pytest.fixture
def stack() -> Iterator[ExitStack]:
    """Closes what a test opened."""
    with ExitStack() as opened:
        yield opened


def texts(told: AnnotatedFrame) -> tuple[object, ...]:
    """Return all that an observation says; flows are compared by what they say."""
    seen, question, comments = told
    conversation = seen.flow.conversation
    ends = (seen.flow.src, seen.flow.dst, conversation.transport, conversation.server_evidence)
    return (seen._replace(flow=None), type(seen.item), seen.item.problems, ends, question, comments)  # type: ignore[arg-type]


def written(stack: ExitStack, folder: Path, told: list[AnnotatedFrame]) -> ObservationStore:
    writer = ObservationStoreWriter(folder)
    for seen, question, comments in told:
        writer.add(seen, question, comments)
    writer.flush()
    assert writer.count == len(told)
    writer.close()
    store = ObservationStore(folder)
    stack.callback(store.close)
    assert store.refresh() == len(store) == len(told)
    return store


@pytest.mark.parametrize("path", sorted(CAPTURES.glob("*.pcap*")), ids=lambda path: path.name)
def test_every_sample_comes_back(stack: ExitStack, tmp_path: Path, path: Path) -> None:
    observer, call_kinds = PacketDecoder(), RecentRequests()
    with open_capture(path) as capture:
        told = [
            AnnotatedFrame(seen, call_kinds.kind_of(seen), observer.comments.get(seen.packet, ()))
            for seen in observer.decode(capture)
        ]
    store = written(stack, tmp_path, told)
    for number in reversed(range(1, len(told) + 1)):
        assert texts(store.read_frame(number)) == texts(told[number - 1])
        assert store.time_of(number) == told[number - 1].observation.time


def test_hostile_strings_come_back(stack: ExitStack, tmp_path: Path) -> None:
    told = [AnnotatedFrame(seen, question, ("\ud800\x1b[2J",)) for seen, question in scenes()]
    store = written(stack, tmp_path, told)
    for number, each in enumerate(told, 1):
        assert texts(store.read_frame(number)) == texts(each)


def test_frames_of_a_flow_share_it(stack: ExitStack, tmp_path: Path) -> None:
    with open_capture(CAPTURES / "slave-session.pcapng") as capture:
        told = [AnnotatedFrame(seen, None) for seen in PacketDecoder().decode(capture)]
    store = written(stack, tmp_path, told)
    assert store.read_frame(1).observation.flow is store.read_frame(3).observation.flow
    assert (
        store.read_frame(1).observation.flow.conversation is store.read_frame(2).observation.flow.conversation
    )


def test_more_conversations_than_are_kept(
    stack: ExitStack, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(journals, "MAX_FLOWS", 3)
    item = Frame(bytes.fromhex("0110000000010000000100000000 0004".replace(" ", "")))
    told = []
    for number in range(1, 41):
        client = Endpoint("10.0.0.2", 40_000 + number % 10)
        flow = Flow(
            Conversation(client, Endpoint("fd00::1%é", 5007), Transport.TCP, SERVER_PORT), Direction.REQUEST
        )
        told.append(AnnotatedFrame(Observation(number, number, number, flow, item, number), None))
    store = written(stack, tmp_path, told)
    assert [texts(store.read_frame(number)) for number in range(1, 41)] == [texts(each) for each in told]


@pytest.mark.parametrize("number", [-1, 0, 2])
def test_numbers_that_are_not_there(stack: ExitStack, tmp_path: Path, number: int) -> None:
    seen, question = next(iter(scenes()))
    store = written(stack, tmp_path, [AnnotatedFrame(seen, question)])
    with pytest.raises(IndexError):
        store.read_frame(number)


def test_note_of_the_capture_stays_with_the_frame(stack: ExitStack, tmp_path: Path) -> None:
    seen, question = next(iter(scenes()))
    note = problem_of(3, "cut", "the capture kept 3")
    noted = seen._replace(item=Frame(seen.item.raw, note))
    store = written(stack, tmp_path, [AnnotatedFrame(noted, question)])
    assert store.read_frame(1).observation.item.problems[-1] == note


@given(st.text(st.characters()))
def test_any_text_is_kept(text: str) -> None:
    assert decode_text(encode_text(text)) == text


def test_there_is_no_journal_yet(tmp_path: Path) -> None:
    with pytest.raises(FileNotFoundError):
        ObservationStore(tmp_path)
