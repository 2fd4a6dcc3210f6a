"""The captures that ship with the project: what the script makes, and what the index says of them."""

from __future__ import annotations

from collections import Counter
from itertools import pairwise
from pathlib import Path

import pytest

from bcapscope.capture.capture_file import open_capture
from bcapscope.capture.packet_decoder import PacketDecoder
from bcapscope.player.arm_limits import SIMULATED_ARM
from bcapscope.player.preflight import run_preflight
from bcapscope.player.resampling import resample
from bcapscope.player.trajectory_reader import read_trajectories
from bcapscope.protocol.codec.frame import Frame, Malformed
from bcapscope.simulator.kinematics import HOME, pose_of
from bcapscope.traffic.observation import SERVER_PORT, Direction, Observation, Transport
from tests.dumps import packets_in
from tests.samples.catalogue import SAMPLES, files
from tests.samples.guide import DUMPS

PERIOD = 0.008
FOLDER = Path(__file__).parents[1] / "captures"
MADE = files()
WAYS = [sample.name for sample in SAMPLES if sample.name.endswith((".csv", ".yaml"))]
CAPTURES = [sample.name for sample in SAMPLES if not sample.name.endswith((".txt", ".csv", ".yaml"))]
DAMAGED = {"damaged-dumps.pcap", "malformed.pcapng", "tcp-gap.pcap"}


def observe(name: str) -> tuple[list[Observation], PacketDecoder]:
    """Read a sample."""
    observer = PacketDecoder()
    with open_capture(FOLDER / name) as capture:
        return list(observer.decode(capture)), observer


def frames(name: str) -> list[tuple[Direction, Frame]]:
    """Return the frames of a sample that has nothing else."""
    found = []
    for seen in observe(name)[0]:
        assert isinstance(seen.item, Frame)
        found.append((seen.flow.direction, seen.item))
    return found


def test_nothing_else_is_there() -> None:
    assert {path.name for path in FOLDER.iterdir()} == MADE.keys()


@pytest.mark.parametrize("name", MADE)
def test_bytes_are_those_of_the_script(name: str) -> None:
    assert (FOLDER / name).read_bytes() == MADE[name], "run python -m tests.samples"


@pytest.mark.parametrize("name", MADE)
def test_is_small(name: str) -> None:
    assert len(MADE[name]) < 100_000


@pytest.mark.parametrize("name", sorted(set(CAPTURES) - DAMAGED))
def test_sound_samples_have_no_problem(name: str) -> None:
    observations, observer = observe(name)
    assert observations
    assert [seen.item for seen in observations if seen.item.problems] == []
    assert all(talk.server_evidence == SERVER_PORT for talk in observer.conversations)
    times = [seen.time for seen in observations]
    assert times == sorted(times)


@pytest.mark.parametrize("name", WAYS)
def test_the_simulated_arm_can_go_each_way(name: str) -> None:
    (way,) = read_trajectories(FOLDER / name)
    if way.period != PERIOD:
        way = resample(way, PERIOD)
    preflight = run_preflight(way, PERIOD, SIMULATED_ARM, current_pose=pose_of(way.kind, HOME))
    assert preflight.is_playable
    found = {finding.check for finding in preflight.problems}
    assert found == ({"first-point"} if name == "half-circle-positions.csv" else set())


def test_the_session_is_whole() -> None:
    session = frames("slave-session.pcapng")
    commands = Counter(
        frame.arguments[1].variant.value
        for direction, frame in session
        if direction is Direction.REQUEST and frame.code == 64
    )
    assert commands["slvMove"] == 240
    assert commands["slvChangeMode"] == 2
    answered = Counter(frame.code for direction, frame in session if direction is Direction.RESPONSE)
    assert answered == {0: 257, 0x900: 4}
    asked = [frame.serial for direction, frame in session if direction is Direction.REQUEST]
    assert asked == list(range(1, 258))


def test_set_points_come_every_8_ms_once_the_buffer_is_full() -> None:
    replies = [
        seen.time
        for seen in observe("slave-session.pcapng")[0]
        if seen.flow.direction is Direction.RESPONSE and len(seen.item.raw) == 106
    ]
    gaps = [(b - a) / 1e6 for a, b in pairwise(replies[3:])]
    assert len(replies) == 240
    assert all(7.9 < gap < 8.1 for gap in gaps)


def test_the_retry_story() -> None:
    story = [(direction, frame.serial, frame.reserved) for direction, frame in frames("retry-story.pcapng")]
    ask, answer = Direction.REQUEST, Direction.RESPONSE
    assert story == [
        (ask, 1232, 0),
        (ask, 1233, 1232),
        (ask, 1234, 1232),
        (ask, 1235, 1232),
        (answer, 1233, 1232),
        (answer, 1235, 1232),
    ]


def test_damaged_dumps_are_the_same_as_text_and_as_datagrams() -> None:
    printed = [bytes.fromhex(dump.printed) for dump in DUMPS]
    text = packets_in((FOLDER / "damaged-dumps.txt").read_text())
    assert [packet.data for packet in text] == printed
    assert [packet.direction is Direction.REQUEST for packet in text] == [dump.client for dump in DUMPS]
    assert [frame.raw for _, frame in frames("damaged-dumps.pcap")] == printed


def test_dumps_differ_from_the_frames_only_where_the_guide_is_damaged() -> None:
    damaged = [index for index, dump in enumerate(DUMPS) if bytes.fromhex(dump.printed) != dump.frame]
    assert damaged == [1, 2, *range(5, 13), 13, 15]


def test_tcp_loses_nothing() -> None:
    observations, observer = observe("tcp-segments.pcap")
    assert len(observations) == 24
    assert observer.counts.gaps == 0
    answer = observations[11]
    assert answer.time - answer.first_byte_time == 3_090_000


def test_a_gap_is_told_as_a_gap() -> None:
    observations, _ = observe("tcp-gap.pcap")
    holes = [seen.item.missing for seen in observations if isinstance(seen.item, Malformed)]
    assert holes == [0, 198, 0]
    whole = [seen.item.serial for seen in observations if isinstance(seen.item, Frame)]
    assert {42, 43, 44, 45} == set(whole)


def test_several_networks_in_one_capture() -> None:
    observations, observer = observe("two-robots.pcapng")
    assert len(observations) == 48
    assert {str(talk.server) for talk in observer.conversations} == {"192.168.0.1:5007", "[fd00:1::1]:5007"}
    observations, observer = observe("vlan-ipv6.pcap")
    assert {seen.flow.conversation.transport for seen in observations} == {Transport.TCP}
    assert observer.counts.not_bcap + observer.counts.not_ip == 3


SOUND_BUT_STRANGE = ("function 200", "not a number", "serial 0", "from a server")


def test_each_malformed_datagram_has_a_problem_or_a_hostile_string() -> None:
    observations, observer = observe("malformed.pcapng")
    troubled = {seen.packet for seen in observations if seen.item.problems}
    strings = set(range(1, 11))
    for packet, (comment,) in observer.comments.items():
        strange = comment.startswith(SOUND_BUT_STRANGE) or packet in strings
        assert (packet in troubled) is not strange, comment
