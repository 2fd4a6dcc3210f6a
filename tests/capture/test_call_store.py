"""Calls come back from disk as they settled."""

from __future__ import annotations

import tracemalloc
from collections.abc import Iterator, Sequence
from contextlib import ExitStack
from pathlib import Path
from typing import cast

import pytest

from bcapscope.capture.call_store import CallStore, CallStoreWriter
from bcapscope.capture.capture_file import open_capture
from bcapscope.capture.observation_store import ObservationStore, ObservationStoreWriter
from bcapscope.capture.packet_decoder import PacketDecoder
from bcapscope.render.call_text import CallRenderer
from bcapscope.traffic.call import Call, FrameObservation, PairingResult, StrayReply
from bcapscope.traffic.call_kind import RecentRequests
from bcapscope.traffic.call_verdict import CallVerdict
from bcapscope.traffic.handle_tracker import HandleTracker, TrackedObject
from bcapscope.traffic.joining.joined_observation import JoinedObservation
from bcapscope.traffic.joining.joiner import Joiner
from bcapscope.traffic.observation import Observation
from bcapscope.traffic.tracker import Tracker
from tests.cli.run import CAPTURES
from tests.samples.calls import MS, START, Datagrams, reply, request
from tests.samples.files import pcap
from tests.samples.legs import both_legs


@pytest.fixture
def stack() -> Iterator[ExitStack]:
    """Closes what a test opened."""
    with ExitStack() as opened:
        yield opened


def told(call: PairingResult, subject: TrackedObject | None) -> list[object]:
    """Return all that is said of a call."""
    lines: list[object] = list(CallRenderer().tree(call, subject))
    if isinstance(call, Call):
        lines += [
            call.verdict,
            call.outcome,
            call.reserved_usage,
            call.abandoned_at,
            call.no_reply_expected,
            call.skipped_handles,
            call.crossing_ns,
            call.unseen_serials,
            (call.may_go_on, call.was_overtaken, call.sure_until, call.is_at_controller),
            [seen.number for seen in call.stray_replies],
        ]
        lines.append(call.evicted)
        lines += [call.last_attempt.number, call.last_activity, call.rtt]
    return lines


def written(
    stack: ExitStack, folder: Path, path: Path
) -> tuple[CallStore, list[tuple[PairingResult, TrackedObject | None]]]:
    store, book = ObservationStoreWriter(folder), CallStoreWriter(folder)
    tracker, handles, call_kinds = Tracker(), HandleTracker(), RecentRequests()
    rows: list[tuple[PairingResult, TrackedObject | None]] = []

    def settle(settled: PairingResult) -> None:
        subject = handles.on_call(settled) if isinstance(settled, Call) else None
        rows.append((settled, subject))
        book.add(settled, subject)

    def observe(seen: Observation) -> Sequence[PairingResult]:
        return tracker.observe_joined(seen) if isinstance(seen, JoinedObservation) else tracker.observe(seen)

    with open_capture(path) as capture:
        decoder = PacketDecoder()
        joiner = Joiner(decoder.comments)
        for seen in decoder.decode(capture):
            store.add(seen, call_kinds.kind_of(seen))
            for each in joiner.add(seen):
                for settled in observe(each):
                    settle(settled)
            if not seen.number % 50:
                store.flush()
                book.flush()
    for seen in joiner.close():
        for settled in observe(seen):
            settle(settled)
    for settled in tracker.close():
        settle(settled)
    store.flush()
    book.flush()
    assert book.count == len(rows)
    store.close()
    book.close()
    reader = ObservationStore(folder)
    reader.refresh()
    calls = CallStore(folder, reader)
    stack.callback(reader.close)
    stack.callback(calls.close)
    assert calls.refresh() == len(calls) == len(rows)
    return calls, rows


@pytest.mark.parametrize("path", sorted(CAPTURES.glob("*.pcap*")), ids=lambda path: path.name)
def test_every_call_of_the_samples_comes_back(stack: ExitStack, tmp_path: Path, path: Path) -> None:
    calls, rows = written(stack, tmp_path, path)
    for index, (settled, subject) in enumerate(rows):
        row = calls.read_call(index)
        assert told(row.settled, row.subject) == told(settled, subject)
        frames = [event.observation.number for event in settled.frames] if isinstance(settled, Call) else []
        if isinstance(settled, StrayReply):
            frames = [settled.observation.number]
        assert {calls.index_of_frame(frame) for frame in frames} == {index}


def test_calls_through_a_proxy_come_back_with_both_legs(stack: ExitStack, tmp_path: Path) -> None:
    legs = both_legs()
    legs.lost = {3: "request", 5: "reply"}
    path, folder = tmp_path / "legs.pcapng", tmp_path / "store"
    path.write_bytes(legs.poll(20).recording())
    folder.mkdir()
    calls, rows = written(stack, folder, path)
    assert len(rows) == 20
    verdicts = set()
    for index, (settled, subject) in enumerate(rows):
        row = calls.read_call(index)
        assert told(row.settled, row.subject) == told(settled, subject)
        assert isinstance(settled, Call)
        assert isinstance(row.settled, Call)
        verdicts.add(row.settled.verdict)
        for event, same in zip(settled.frames, row.settled.frames, strict=True):
            seen, back = event.observation, same.observation
            assert isinstance(seen, JoinedObservation)
            assert isinstance(back, JoinedObservation)
            assert (back.note, back.is_missed, back.delay) == (seen.note, seen.is_missed, seen.delay)
            assert {calls.index_of_frame(each.number) for each in seen.sightings()} == {index}
        near, leg = settled.conversation, row.settled.conversation.controller_leg
        assert leg is not None
        assert near.controller_leg is not None
        assert leg.server == near.controller_leg.server
    assert verdicts == {CallVerdict.ANSWERED, CallVerdict.REQUEST_LOST, CallVerdict.REPLY_LOST}


def test_calls_with_unseen_attempts_come_back(stack: ExitStack, tmp_path: Path) -> None:
    network = Datagrams()
    network.up(START, request(20, 0, "Service_Stop"))
    network.down(START + 8 * MS, reply(21, 0))
    network.up(START + 200 * MS, request(22, 20, "Service_Stop"))
    network.down(START + 201 * MS, reply(22, 0))
    network.up(START + 210 * MS, request(23, 0, "Service_Stop"))
    network.down(START + 211 * MS, reply(24, 0))
    path, folder = tmp_path / "unseen.pcap", tmp_path / "store"
    path.write_bytes(pcap(network.packets))
    folder.mkdir()
    calls, rows = written(stack, folder, path)
    verdicts = []
    for index, (settled, subject) in enumerate(rows):
        row = calls.read_call(index)
        if isinstance(row.settled, Call):
            assert told(row.settled, row.subject) == told(settled, subject)
            verdicts.append(row.settled.verdict)
    assert verdicts == [CallVerdict.REPLY_LOST, CallVerdict.NOT_CAPTURED]


def test_frames_that_belong_to_no_call_yet(stack: ExitStack, tmp_path: Path) -> None:
    calls, _ = written(stack, tmp_path, CAPTURES / "retry-story.pcapng")
    assert calls.index_of_frame(7) is None
    assert calls.index_of_frame(10**9) is None


@pytest.mark.parametrize("index", [-1, 1])
def test_rows_that_are_not_there(stack: ExitStack, tmp_path: Path, index: int) -> None:
    calls, _ = written(stack, tmp_path, CAPTURES / "retry-story.pcapng")
    with pytest.raises(IndexError):
        calls.read_call(index)


def test_links_are_seen_when_they_were_written_later(stack: ExitStack, tmp_path: Path) -> None:
    calls, rows = written(stack, tmp_path, CAPTURES / "exchanges.pcap")
    assert calls.index_of_frame(1) == 0
    with (tmp_path / "links").open("r+b") as file:
        file.write(len(rows).to_bytes(4, "little"))
    assert calls.index_of_frame(1) == 0
    calls.refresh()
    assert calls.index_of_frame(1) == len(rows) - 1


def test_memory_does_not_grow_with_frame_numbers(stack: ExitStack, tmp_path: Path) -> None:
    """A proxy that is watched for days numbers hundreds of millions of frames."""
    rows = CallStoreWriter(tmp_path)
    stack.callback(rows.close)
    with open_capture(CAPTURES / "exchanges.pcap") as capture:
        reply = next(seen for seen in PacketDecoder().decode(capture) if seen.flow.direction == "response")
    tracemalloc.start()
    stack.callback(tracemalloc.stop)
    for number in range(1, 40_000_001, 200_000):
        rows.add(
            StrayReply(cast(FrameObservation, reply._replace(number=number)), None, may_answer_evicted=False),
            None,
        )
        rows.flush()
    assert tracemalloc.get_traced_memory()[1] < 1_000_000
    ObservationStoreWriter(tmp_path).close()
    observations = ObservationStore(tmp_path)
    stack.callback(observations.close)
    calls = CallStore(tmp_path, observations)
    stack.callback(calls.close)
    assert [calls.index_of_frame(number) for number in (1, 2, 200_001, 39_800_001)] == [0, None, 1, 199]
