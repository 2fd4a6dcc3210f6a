"""Calls of the captures that ship, and of recordings of DENSO's own libraries where they are at hand."""

from __future__ import annotations

from collections import Counter
from pathlib import Path

import pytest

from bcapscope.capture.capture_file import open_capture
from bcapscope.capture.packet_decoder import PacketDecoder
from bcapscope.protocol.codec.frame import Frame
from bcapscope.traffic.call import Call, PairingResult
from bcapscope.traffic.call_verdict import CallVerdict, Outcome
from bcapscope.traffic.handle_tracker import HandleTracker
from bcapscope.traffic.observation import Observation
from bcapscope.traffic.reserved_field import ReplyReserved, ReservedConvention, ReservedFieldUsage
from bcapscope.traffic.tracker import Tracker
from tests.shared_folder import SHARED
from tests.traffic.playbook import calls_of, strays_of, summaries

SAMPLES = Path(__file__).parents[2] / "captures"
RECORDINGS = SHARED / "captures"
NAMES = sorted(path.name for path in SAMPLES.glob("*.pcap*"))


def observe(path: Path) -> list[Observation]:
    with open_capture(path) as capture:
        return list(PacketDecoder().decode(capture))


def track(observations: list[Observation]) -> list[PairingResult]:
    tracker = Tracker()
    settled = [item for seen in observations for item in tracker.observe(seen)]
    return [*settled, *tracker.close()]


def frames_in(settled: list[PairingResult]) -> list[int]:
    """List the number of every frame of every call and stray, sorted."""
    return sorted(
        seen.number
        for item in settled
        for seen in (
            [event.observation for event in item.frames] if isinstance(item, Call) else [item.observation]
        )
    )


def recorded(name: str) -> list[Observation]:
    if not (RECORDINGS / name).exists():
        pytest.skip(f"{RECORDINGS / name} is not here")
    return observe(RECORDINGS / name)


@pytest.mark.parametrize("name", NAMES)
def test_every_frame_of_a_sample_is_in_one_call(name: str) -> None:
    observations = observe(SAMPLES / name)
    frames = [seen.number for seen in observations if isinstance(seen.item, Frame)]
    assert frames_in(track(observations)) == frames


def test_the_retry_story_is_one_call() -> None:
    settled = track(observe(SAMPLES / "retry-story.pcapng"))
    assert summaries(settled) == ["1: >1 >>2 >>3 >>4 late<5 <6 answered, reply late"]
    (call,) = calls_of(settled)
    assert call.serials == (1232, 1233, 1234, 1235)
    assert call.convention is ReservedConvention.SEED


def test_a_session_without_a_fault_is_clean() -> None:
    handles = HandleTracker()
    calls = calls_of(track(observe(SAMPLES / "slave-session.pcapng")))
    for call in calls:
        handles.on_call(call)
    assert {call.verdict for call in calls} == {CallVerdict.ANSWERED}
    assert all(session.is_clean for session in handles.sessions())


@pytest.mark.interop
@pytest.mark.parametrize(
    ("name", "habits"),
    [
        ("udp_clean.pcap", ReservedFieldUsage(ReservedConvention.OWN, ReplyReserved.ZERO)),
        ("tcp.pcapng", ReservedFieldUsage(ReservedConvention.TCP0, ReplyReserved.UNKNOWN)),
    ],
)
def test_a_recording_without_loss(name: str, habits: ReservedFieldUsage) -> None:
    observations = recorded(name)
    settled = track(observations)
    calls = calls_of(settled)
    assert frames_in(settled) == [seen.number for seen in observations]
    assert strays_of(settled) == []
    assert len(calls) == 2010
    assert {(call.verdict, call.retries, call.reserved_usage) for call in calls} == {
        (CallVerdict.ANSWERED, 0, habits)
    }
    handles = HandleTracker()
    things = Counter(thing and thing.label for thing in map(handles.on_call, calls))
    assert things["Arm"] == 2003
    (session,) = handles.sessions()
    assert [thing.label for thing in session.unreleased] == ["I1"]


@pytest.mark.interop
def test_a_recording_with_loss_shows_what_the_client_tried_again() -> None:
    observations = recorded("udp_loss.pcapng")
    settled = track(observations)
    calls = calls_of(settled)
    assert frames_in(settled) == [seen.number for seen in observations]
    assert len(calls) == 2010
    assert {call.outcome for call in calls} == {Outcome.ANSWERED}
    assert {call.convention for call in calls} == {ReservedConvention.OWN}
    # the client numbers every datagram and puts the first one's serial into its retries
    frames = [seen.item for seen in observations if seen.flow.direction == "request"]
    again = sum(isinstance(frame, Frame) and frame.serial != frame.reserved for frame in frames)
    assert sum(call.retries for call in calls) == again == 473
    twice = [call for call in calls if call.verdict is CallVerdict.EXECUTED_TWICE]
    assert [(call.number, call.retries, call.skipped_handles) for call in twice] == [(3, 4, 2)]
