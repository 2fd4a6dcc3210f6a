"""Commands that read several captures, or a folder of captures."""

from __future__ import annotations

import gzip
import json
import os
import random
import struct
import subprocess
import sys
import threading
from pathlib import Path

import pytest

from bcapscope.capture.capture_file import open_capture
from bcapscope.capture.packet import Packet
from bcapscope.cli.common.exit_codes import ExitCode
from tests.capture.packets import enhanced, interface, pcap_header, section
from tests.cli.run import CAPTURES, run, run_here

LOST = CAPTURES / "slave-mode-lost.pcapng"
PARTS = ("a.pcap", "b.pcap.gz", "c.pcapng", "d.pcap")
"""Four files in the order of time, in three formats."""


def packets_of(path: Path) -> list[Packet]:
    with open_capture(path) as capture:
        return list(capture)


def as_pcap(packets: list[Packet]) -> bytes:
    """Write packets with their times in ns, as Ethernet."""
    head = pcap_header(1, magic=0xA1B23C4D)
    records = (
        struct.pack("<IIII", *divmod(time, 10**9), len(data), size) + data for time, data, size, *_ in packets
    )
    return head + b"".join(records)


def as_two_sections(packets: list[Packet]) -> bytes:
    """Write packets as pcapng with two sections, with times in µs."""
    half = len(packets) // 2
    head = section() + interface()
    return b"".join(
        head + b"".join(enhanced(data, time // 1000) for time, data, *_ in part)
        for part in (packets[:half], packets[half:])
    )


@pytest.fixture
def night(tmp_path: Path) -> Path:
    """A folder with one capture in four files of different formats, and with files that are no captures."""
    packets = packets_of(LOST)
    folder = tmp_path / "night"
    folder.mkdir()
    (folder / "a.pcap").write_bytes(as_pcap(packets[:20]))
    (folder / "b.pcap.gz").write_bytes(gzip.compress(as_pcap(packets[20:40])))
    (folder / "c.pcapng").write_bytes(as_two_sections(packets[40:60]))
    (folder / "d.pcap").write_bytes(as_pcap(packets[60:]))
    return folder


@pytest.mark.parametrize("seed", range(4))
def test_files_are_read_in_the_order_of_their_packets(night: Path, seed: int) -> None:
    paths = [night / name for name in PARTS]
    ordered = run_here("diagnose", *paths)
    random.Random(seed).shuffle(paths)
    mixed = run_here("diagnose", *paths)
    assert mixed == ordered
    assert mixed.err == "70 frames in 70 packets\n"


def test_the_findings_are_those_of_the_whole_capture(night: Path) -> None:
    whole = [json.loads(line) for line in run_here("diagnose", LOST, "--json").lines]
    parts = sorted(night.iterdir(), reverse=True)
    split = [json.loads(line) for line in run_here("diagnose", *parts, "--json").lines]
    for finding in (*whole, *split):
        del finding["packets"]
    assert split == whole


def test_a_folder_stands_for_its_captures(night: Path) -> None:
    (night / "notes.txt").write_text("the robot stopped at ten")
    (night / "empty.pcap").write_bytes(b"")
    (night / ".d.pcap.x7Fq").write_bytes((night / "d.pcap").read_bytes())  # a copy that rsync makes
    (night / "older").mkdir()
    (night / "older" / "z.pcap").write_bytes((night / "a.pcap").read_bytes())
    (night / "letter.gz").write_bytes(gzip.compress(b"Dear Sir"))
    done = run_here("diagnose", night)
    assert done == run_here("diagnose", *(night / name for name in PARTS))
    assert done.code == ExitCode.OK


def test_a_file_of_a_folder_that_is_also_named_is_read_once(night: Path) -> None:
    assert run_here("decode", night, night / "b.pcap.gz").err == "70 frames in 70 packets\n"


def test_a_folder_without_captures(tmp_path: Path) -> None:
    (tmp_path / "notes.txt").write_text("nothing here")
    done = run_here("decode", tmp_path)
    assert done.code == ExitCode.UNREADABLE
    assert done.err == f"{tmp_path}: this folder contains no capture\n"


def test_a_capture_that_cannot_be_read_does_not_hide_the_others(night: Path) -> None:
    (night / "b.pcap.gz").write_bytes((night / "b.pcap.gz").read_bytes()[:-30])
    done = run_here("decode", night / "missing.pcap", *(night / name for name in reversed(PARTS)))
    assert done.code == ExitCode.UNREADABLE
    assert "missing.pcap: cannot be opened: no such file or directory" in done.err
    assert "b.pcap.gz: " in done.err
    numbers = [int(line.split()[0]) for line in done.lines]
    assert numbers == list(range(1, len(numbers) + 1))
    assert len(numbers) >= 50


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="this system has no named pipes")
def test_a_pipe_stays_where_it_was_given(night: Path, tmp_path: Path) -> None:
    pipe = tmp_path / "pipe"
    os.mkfifo(pipe)
    content = (night / "a.pcap").read_bytes()
    writer = threading.Thread(target=lambda: pipe.write_bytes(content))
    writer.start()
    done = run("decode", "--json", night / "d.pcap", pipe, night / "c.pcapng", night / "b.pcap.gz")
    writer.join()
    files = list(dict.fromkeys(Path(json.loads(line)["file"]).name for line in done.lines))
    assert files == ["b.pcap.gz", "pipe", "c.pcapng", "d.pcap"]


def test_standard_input_stays_where_it_was_given(night: Path) -> None:
    stdin = (night / "d.pcap").read_bytes()
    done = run("decode", "--json", "-", night / "b.pcap.gz", night / "a.pcap", stdin=stdin)
    files = list(dict.fromkeys(json.loads(line)["file"] for line in done.lines))
    assert files == ["-", str(night / "a.pcap"), str(night / "b.pcap.gz")]
    assert "(standard input, packet 1)" in run("decode", "-", night / "a.pcap", stdin=stdin).lines[0]


def test_captures_that_overlap_are_merged_by_time(tmp_path: Path) -> None:
    packets = packets_of(LOST)
    (tmp_path / "odd.pcap").write_bytes(as_pcap(packets[1::2]))
    (tmp_path / "even.pcap").write_bytes(as_pcap(packets[::2]))
    done = run_here("diagnose", tmp_path, "--json")
    found = [json.loads(line) for line in done.lines]
    whole = [json.loads(line) for line in run_here("diagnose", LOST, "--json").lines]
    assert [finding["sentence"] for finding in found] == [finding["sentence"] for finding in whole]
    for finding in found:
        for packet in finding["packets"]:
            name = "even.pcap" if packet["frame"] % 2 else "odd.pcap"
            assert packet == {
                "frame": packet["frame"],
                "file": str(tmp_path / name),
                "packet": (packet["frame"] + 1) // 2,
            }


def test_each_line_names_the_capture_and_its_packet(night: Path) -> None:
    assert run_here("decode", night).lines[20].endswith("  (b.pcap.gz, packet 1)")
    assert run_here("decode", night, "--lang", "ja").lines[69].endswith("  (d.pcap のパケット 10)")
    assert run_here("calls", night).lines[30].endswith("frames 61 > 62 (d.pcap, packets 1 2)")
    tree = run_here("decode", night, "--tree", "-f", "frame == 41").lines
    assert tree[0].endswith("  (c.pcapng, packet 1)")


def test_one_capture_is_not_named_in_lines() -> None:
    for command in ("decode", "calls", "diagnose", "slave"):
        assert "slave-mode-lost" not in run_here(command, LOST).out


def test_json_names_the_capture_and_its_packet(night: Path) -> None:
    frame = json.loads(run_here("decode", night, "--json").lines[20])
    assert (frame["packet"], frame["file"], frame["file_packet"]) == (21, str(night / "b.pcap.gz"), 1)
    call = json.loads(run_here("calls", night, "--json").lines[30])
    d = str(night / "d.pcap")
    assert call["packets"] == [{"frame": 61, "file": d, "packet": 1}, {"frame": 62, "file": d, "packet": 2}]
    finding = json.loads(run_here("diagnose", night, "--json").lines[2])
    assert finding["packets"][0] == {"frame": 65, "file": d, "packet": 5}
    session = json.loads(run_here("slave", night, "--json").lines[0])
    assert {"frame": 1, "file": str(night / "a.pcap"), "packet": 1} in session["packets"]


def test_json_of_one_capture_has_the_packets_too() -> None:
    finding = json.loads(run_here("diagnose", LOST, "--json").lines[0])
    assert finding["packets"][0] == {"frame": 61, "file": str(LOST), "packet": 61}


def test_captures_of_the_same_name_are_told_apart_by_their_folders(tmp_path: Path, night: Path) -> None:
    other = tmp_path / "other"
    other.mkdir()
    (night / "d.pcap").rename(other / "a.pcap")
    lines = run_here("decode", night / "a.pcap", other / "a.pcap").lines
    assert lines[0].endswith(f"({night / 'a.pcap'}, packet 1)")
    assert lines[-1].endswith(f"({other / 'a.pcap'}, packet 10)")


def test_sentences_and_tables_name_the_capture(night: Path) -> None:
    text = " ".join(run_here("slave", night).out.split())
    assert "frames 1, 2 (a.pcap, packets 1 2)" in text
    assert "frame 63 (d.pcap, packet 3)" in text
    assert "Frames: 61 62 63 64 (d.pcap, packets 1 2 3 4)" in run_here("diagnose", night).out


def test_the_name_of_a_capture_cannot_disturb_the_terminal(night: Path) -> None:
    (night / "d.pcap").rename(night / "d\x1b[2J.pcap")
    for command in ("decode", "calls", "diagnose", "slave"):
        done = run_here(command, night)
        assert "\x1b" not in done.out + done.err
        assert "\\x1b" in done.out


def test_a_report_of_several_captures_names_them(night: Path, tmp_path: Path) -> None:
    pytest.importorskip("plotly")
    page = tmp_path / "report.html"
    assert run_here("report", night, "-o", page).code == ExitCode.OK
    text = page.read_text()
    assert "a.pcap, b.pcap.gz, c.pcapng, d.pcap" in text
    assert "61 62 63 64 (d.pcap, packets 1 2 3 4)" in text


def test_many_files_need_few_descriptors(tmp_path: Path) -> None:
    packets = packets_of(LOST)
    for number, packet in enumerate(packets):
        (tmp_path / f"{number:03}.pcap").write_bytes(as_pcap([packet]))
    limit = "import resource; resource.setrlimit(resource.RLIMIT_NOFILE, (30, 30))"
    code = f"{limit}; from bcapscope.cli import main; main()"
    argv = [sys.executable, "-c", code, "decode", str(tmp_path)]
    done = subprocess.run(argv, capture_output=True, check=False)
    assert done.stderr == b"70 frames in 70 packets\n"
