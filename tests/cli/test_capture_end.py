"""Where a capture goes on with other packets, what never came is told from what may yet come."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from tests.analysis.scenes import HOME, ROBOT, Story
from tests.cli.run import run
from tests.samples.calls import MS, r8s, text
from tests.samples.files import Packet, pcap

ARP = bytes.fromhex("ffffffffffff 0200c0a8000a 0806 0001 0800 0604 0001") + bytes(20)


def captured(story: Story, goes_on_for: float) -> bytes:
    """Return a capture in which, so many ms after the last frame, a packet of another protocol passes."""
    packets = [packet for talker in story.talkers for packet in talker.network.packets]
    end = max(packet.time for packet in packets) + round(goes_on_for * MS)
    return pcap([*packets, Packet(end, ARP)], nanoseconds=True)


def in_slave_mode() -> Story:
    story = Story()
    story.client().drive(10)
    return story


@pytest.fixture
def path(tmp_path: Path) -> Path:
    return tmp_path / "capture.pcap"


@pytest.mark.parametrize(("goes_on_for", "reason"), [(500, "capture ended"), (2_000, "silent")])
def test_a_stay_whose_set_points_stop(path: Path, goes_on_for: float, reason: str) -> None:
    path.write_bytes(captured(in_slave_mode(), goes_on_for))
    (line,) = run("slave", path, "--json").lines
    assert json.loads(line)["exit"]["reason"] == reason


@pytest.mark.parametrize(("goes_on_for", "rules"), [(1_000, []), (11_000, ["quit-in-slave-mode"])])
def test_slave_mode_that_was_left_on(path: Path, goes_on_for: float, rules: list[str]) -> None:
    path.write_bytes(captured(in_slave_mode(), goes_on_for))
    assert [json.loads(line)["rule"] for line in run("diagnose", path, "--json").lines] == rules


@pytest.mark.parametrize(("goes_on_for", "outcome"), [(170_000, "capture_ended"), (190_000, "unanswered")])
def test_a_call_without_a_reply(path: Path, goes_on_for: float, outcome: str) -> None:
    """The official server answers after three minutes or never."""
    story = in_slave_mode()
    story.talkers[0].ask(200, "Robot_Execute", ROBOT, text("slvMove"), r8s(*HOME))
    path.write_bytes(captured(story, goes_on_for))
    last = json.loads(run("calls", path, "--json").lines[-1])
    assert last["outcome"] == outcome


@pytest.mark.parametrize(("goes_on_for", "stopped"), [(1, False), (2_000, True)])
def test_a_client_that_gave_up(path: Path, goes_on_for: float, stopped: bool) -> None:
    story = Story()
    client = story.client()
    client.open()
    first = client.ask(50, "Robot_Execute", ROBOT, text("slvMove"), r8s(*HOME))
    for number in range(1, 4):
        client.ask(50 + 16 * number, "Robot_Execute", ROBOT, text("slvMove"), r8s(*HOME), reserved=first)
    path.write_bytes(captured(story, goes_on_for))
    sentences = [json.loads(line)["sentence"] for line in run("diagnose", path, "--json").lines]
    assert (
        any("sent nothing more in the remaining 2 s of the capture" in each for each in sentences) is stopped
    )
