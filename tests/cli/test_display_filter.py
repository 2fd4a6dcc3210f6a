"""``--display-filter`` of `calls` and `diagnose`."""

from __future__ import annotations

import json
import re
import subprocess
from pathlib import Path

import pytest

from bcapscope.render.display_filter import display_filter
from tests.cli.run import CAPTURES, run_here
from tests.samples.calls import MS
from tests.samples.legs import both_ends
from tests.wireshark.tshark import needs_tshark

RETRIES, EXCHANGES = CAPTURES / "retry-story.pcapng", CAPTURES / "exchanges.pcap"


@pytest.mark.parametrize(
    ("packets", "expected"),
    [([7], "{7}"), ([3, 1, 2, 2], "{1..3}"), ([1, 3, 4, 9, 10, 11], "{1, 3..4, 9..11}")],
)
def test_successive_packets_are_a_range(packets: list[int], expected: str) -> None:
    assert display_filter(packets) == f"frame.number in {expected}"


def filters(*words: str | Path) -> list[str]:
    """Return what follows the label of each line with a display filter."""
    lines = run_here(*words, "--display-filter").lines
    return [line.strip().removeprefix("Wireshark") for line in lines if re.match(" *Wireshark[:,]", line)]


def test_calls_show_a_filter_below_each_call() -> None:
    assert filters("calls", RETRIES) == [": frame.number in {1..6}"]
    assert filters("calls", RETRIES, "--tree") == [": frame.number in {1..6}"]
    assert filters("calls", EXCHANGES, "-f", "call == 4") == [": frame.number in {6..7}"]


def test_several_captures_are_named() -> None:
    found = filters("calls", RETRIES, EXCHANGES, "-f", "command == slvGetMode")
    assert found == [", exchanges.pcap: frame.number in {3..4}"]


def test_both_places_of_a_call_have_a_filter(tmp_path: Path) -> None:
    paths = [tmp_path / "client.pcap", tmp_path / "controller.pcap"]
    for path, data in zip(paths, both_ends().poll(20).captures(90_000 * MS, 0.0), strict=True):
        path.write_bytes(data)
    found = filters("calls", *paths, "-f", "call == 2")
    assert found == [f", {path.name}: frame.number in {{3..4}}" for path in paths]


def test_findings_show_the_frames_that_prove_them() -> None:
    capture = CAPTURES / "slave-mode-lost.pcapng"
    records = [json.loads(line) for line in run_here("diagnose", "--json", capture).lines]
    expected = [display_filter(each["packet"] for each in record["packets"]) for record in records]
    assert filters("diagnose", capture) == [f": {each}" for each in expected]


@needs_tshark
def test_tshark_accepts_the_filters() -> None:
    capture = CAPTURES / "slave-mode-lost.pcapng"
    for found in filters("diagnose", capture)[:2]:
        argv = ["tshark", "-r", str(capture), "-Y", found.removeprefix(": ")]
        lines = subprocess.run(argv, capture_output=True, check=True).stdout.decode().splitlines()
        assert display_filter(int(line.split()[0]) for line in lines) == found.removeprefix(": ")


@pytest.mark.parametrize(
    "words",
    [("calls", "--json"), ("calls", "--csv"), ("calls", "-i", "lo"), ("diagnose", "--json")],
)
def test_other_formats_have_no_filter(words: tuple[str, ...]) -> None:
    done = run_here(*words, "--display-filter", *([] if "-i" in words else [EXCHANGES]))
    assert done.code == 2
    assert "--display-filter" in done.err
