"""``bcapscope slave`` from the outside."""

from __future__ import annotations

import json
import unicodedata
from collections.abc import Callable
from pathlib import Path

import pytest

from bcapscope.capture.capture_file import open_capture
from bcapscope.cli.common.exit_codes import ExitCode
from tests.capture.packets import pcap_header, pcap_record
from tests.cli.run import CAPTURES, run_here
from tests.shared_folder import SHARED

SESSION, LOST = CAPTURES / "slave-session.pcapng", CAPTURES / "slave-mode-lost.pcapng"
ALL = sorted([*CAPTURES.glob("*.pcap"), *CAPTURES.glob("*.pcapng")])
RECORDINGS = SHARED / "captures"


@pytest.mark.parametrize("path", [SESSION, LOST], ids=lambda path: path.stem)
def test_text(path: Path, golden: Callable[[str, bytes], None]) -> None:
    done = run_here("slave", path, "--window", "0.5")
    assert done.code == ExitCode.OK
    golden(f"slave-{path.stem}.txt", done.out.encode())
    assert all(unicodedata.normalize("NFC", line) == line and len(line) <= 100 for line in done.lines)


@pytest.mark.parametrize("path", ALL, ids=lambda path: path.name)
def test_every_sample(path: Path) -> None:
    text, data = run_here("slave", path), run_here("slave", path, "--json")
    assert (text.code, data.code) == (ExitCode.OK, ExitCode.OK)
    stays = [json.loads(line) for line in data.lines]
    assert [f"Slave-mode session {stay['stay']}" for stay in stays] == [
        line.split("  ")[0] for line in text.lines if line.startswith("Slave-mode session ")
    ]
    assert ("no slave-mode session found" in text.err) == (not stays)


@pytest.mark.parametrize("command", [["slave"], ["extract", "-o", "never.csv"]])
def test_of_what_could_not_be_read_nothing_is_said(command: list[str], tmp_path: Path) -> None:
    path = tmp_path / "none.pcap"
    done = run_here(*command, path)
    assert done.code == ExitCode.UNREADABLE
    assert done.err == f"{path}: cannot be opened: no such file or directory\n"


def test_json_of_a_whole_stay() -> None:
    (line,) = run_here("slave", SESSION, "--json").lines
    stay = json.loads(line)
    assert '"entered":1700000002.078421639,' in line
    assert (stay["client"], stay["robot"], stay["began_before_capture"]) == ("192.168.0.10:50001", 2, False)
    assert (stay["mode"]["value"], stay["mode"]["kind"], stay["mode"]["generation"]) == (514, "mode 2", "RC8")
    assert (stay["exit"]["reason"], stay["exit"]["frames"]) == ("left", [507, 508])
    assert (stay["set_points"]["sent"], stay["set_points"]["refused"]) == (240, [])
    assert stay["timing"]["cycle_ms"]["p50"] == pytest.approx(8, abs=0.01)
    assert sum(count for _, _, count in stay["timing"]["cycle_ms"]["bins"]) == 239
    assert stay["clock"]["unit"] == "us"
    assert abs(stay["clock"]["drift_ppm"]) < 5
    assert stay["motion"]["lag_cycles"] == pytest.approx(4.25, abs=0.1)
    assert stay["motion"]["axes"][0]["axis"] == "J1"
    assert stay["buffer"]["predicted_empty"] == 0


def test_json_of_a_stay_that_was_lost() -> None:
    (line,) = run_here("slave", LOST, "--json").lines
    stay = json.loads(line)
    assert (stay["exit"]["reason"], stay["exit"]["hresult"]) == ("error", 0x84201482)
    assert stay["set_points"]["after_end"] == 2
    (empty,) = stay["buffer"]["predicted_empty_list"]
    assert (empty["after_frame"], empty["before_frame"], empty["moving"]) == (61, 63, True)
    assert stay["buffer"]["reported_underflow_frames"] == [64]
    assert [gap["request_frame"] for gap in stay["timing"]["gap_list"]] == [63]


def test_a_filter_chooses_set_points() -> None:
    (line,) = run_here("slave", SESSION, "--json", "-f", "latency > 5ms").lines
    stay = json.loads(line)
    assert (stay["set_points"]["sent"], stay["exit"]["reason"]) == (236, "left")
    none = run_here("slave", SESSION, "-f", "latency > 5s")
    assert (none.out, none.code) == ("", ExitCode.OK)
    assert "no set point matches the filter" in none.err


def test_colours_on_request() -> None:
    plain, coloured = run_here("slave", LOST), run_here("slave", LOST, "--color", "always")
    assert "\x1b" not in plain.out
    assert "\x1b[31m" in coloured.out


@pytest.mark.interop
@pytest.mark.parametrize(
    ("name", "port", "retries"),
    [("udp_clean.pcap", 15007, 0), ("udp_loss.pcapng", 15008, 467), ("tcp.pcapng", 15007, 0)],
)
def test_recordings_of_the_official_libraries(name: str, port: int, retries: int) -> None:
    path = RECORDINGS / name
    if not path.exists():
        pytest.skip(f"{path} is missing")
    (line,) = run_here("slave", path, "--json", "-p", str(port)).lines
    stay = json.loads(line)
    counts = stay["set_points"]
    assert (counts["sent"], counts["accepted"], counts["unanswered"]) == (2000, 2000, 0)
    assert counts["retries"] == retries
    assert (stay["mode"]["value"], stay["exit"]["reason"]) == (0x202, "left")
    assert stay["motion"]["read"] == stay["motion"]["returned"] == 2000
    assert stay["timing"]["cycle_ms"]["count"] == 1999


def test_jitter_is_the_distance_of_a_cycle_from_the_period(tmp_path: Path) -> None:
    help_ = " ".join(run_here("slave", "--help").out.split())
    assert "If the period is 8 ms, a cycle time of 10 ms has a jitter of 2 ms" in help_
    steady = tmp_path / "steady.pcap"
    with open_capture(SESSION) as capture:
        points = [packet for packet in capture if b"s\x00l\x00v\x00M\x00o\x00v\x00e" in packet[1]]
    records = (pcap_record(data, 0, 10_000 * number) for number, (_, data, *_) in enumerate(points[:50]))
    steady.write_bytes(pcap_header() + b"".join(records))
    (line,) = run_here("slave", steady, "--json").lines
    timing = json.loads(line)["timing"]
    assert (timing["grid_ms"], timing["cycle_ms"]["p50"], timing["jitter_ms"]["p50"]) == (8.0, 10.0, 2.0)
