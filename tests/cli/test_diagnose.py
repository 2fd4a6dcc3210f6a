"""``bcapscope diagnose`` from the outside."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

import pytest

from bcapscope.cli.common.exit_codes import ExitCode
from tests.cli.run import CAPTURES, run, run_here

LOST = CAPTURES / "slave-mode-lost.pcapng"
ALL = sorted([*CAPTURES.glob("*.pcap"), *CAPTURES.glob("*.pcapng")])


def test_the_first_cause_comes_first(golden: Callable[[str, bytes], None]) -> None:
    done = run_here("diagnose", LOST)
    assert done.code == ExitCode.OK
    assert done.err == "70 frames in 70 packets\n"
    golden("diagnose.txt", done.out.encode())


def test_colours(golden: Callable[[str, bytes], None]) -> None:
    golden("diagnose.ansi", run_here("diagnose", LOST, "--color", "always").out.encode())


def test_json_is_an_object_a_line() -> None:
    findings = [json.loads(line) for line in run_here("diagnose", LOST, "--json").lines]
    assert [finding["finding"] for finding in findings] == [1, 2, 3, 4, 5]
    assert [finding["consequence_of"] for finding in findings] == [None, 1, 2, 2, 2]
    assert findings[0]["rule"] == "set-point-gap"
    assert findings[0]["frames"] == [61, 62, 63, 64]


def test_a_clean_capture_says_so() -> None:
    done = run_here("diagnose", CAPTURES / "vlan-ipv6.pcap")
    assert done.code == ExitCode.OK
    assert done.lines == ["No problem found in 14 frames, 7 calls, 1 client, 61 ms"]
    assert run_here("diagnose", CAPTURES / "vlan-ipv6.pcap", "--json").lines == []


@pytest.mark.parametrize("path", ALL, ids=lambda path: path.name)
def test_every_sample_can_be_diagnosed(path: Path) -> None:
    done = run_here("diagnose", path)
    assert done.code == ExitCode.OK
    assert "Traceback" not in done.err
    assert all(line.isprintable() for line in done.lines)


def test_a_broken_capture_is_diagnosed_up_to_the_damage(tmp_path: Path) -> None:
    broken = tmp_path / "broken.pcapng"
    broken.write_bytes(LOST.read_bytes()[:-30])
    done = run_here("diagnose", broken, "--json")
    assert done.code == ExitCode.DAMAGED
    assert json.loads(done.lines[0])["rule"] == "set-point-gap"


def test_other_ports_and_standard_input() -> None:
    assert (
        run("diagnose", "-", "-p", "5007", stdin=LOST.read_bytes()).lines == run_here("diagnose", LOST).lines
    )


def test_no_capture_is_told_in_a_sentence(tmp_path: Path) -> None:
    done = run_here("diagnose", tmp_path / "none.pcap")
    assert done.code == ExitCode.UNREADABLE
    assert done.lines == []
    assert done.err.endswith("none.pcap: cannot be opened: no such file or directory\n")
    assert run_here("diagnose").code == ExitCode.USAGE


def test_a_filter_chooses_calls() -> None:
    refused = run_here("diagnose", LOST, "--json", "-f", "hresult == 0x83500121").lines
    assert [json.loads(line)["rule"] for line in refused][:3] == [
        "set-point-gap",
        "underflow",
        "slvmove-outside-slave-mode",
    ]
    done = run_here("diagnose", LOST, "-f", "call == 5")
    (line,) = done.lines
    assert line.startswith(
        "No problem found in the traffic of 1 call selected by the filter, out of 70 frames, 35 calls, 1 "
    )
    assert run_here("diagnose", LOST, "-f", "laytency > 5ms").code == ExitCode.USAGE
