"""``bcapscope stats`` from the outside."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest

from bcapscope.cli.common.exit_codes import ExitCode
from tests.bench.traffic import write
from tests.cli.run import CAPTURES, Ran, run, run_here

LOST = CAPTURES / "slave-mode-lost.pcapng"
RETRIES = CAPTURES / "retry-story.pcapng"
KEY = ("client", "server", "transport", "function", "command")
ALL = sorted([*CAPTURES.glob("*.pcap"), *CAPTURES.glob("*.pcapng")])


def records(done: Ran) -> list[dict[str, Any]]:
    return [json.loads(line) for line in done.lines]


def test_a_table_for_people() -> None:
    done = run_here("stats", LOST)
    assert done.code == ExitCode.OK
    assert done.err == "70 frames in 70 packets\n"
    assert done.lines[0] == "2023-11-14T22:13:19.984000000Z, 0.553 s"
    (row,) = [line.split() for line in done.lines if line.startswith("Robot_Execute slvMove  ")]
    assert row == [*("Robot_Execute", "slvMove", "33", "59.7", "4.2%"), *["0.700"] * 5, "3"]
    assert "2  0x83500121  Robot_Execute slvMove" in done.lines


def test_the_retry_story_in_figures() -> None:
    (record,) = records(run_here("stats", RETRIES, "--json"))
    assert (record["start"], record["end"]) == (1700000000.0, 1700000000.00724)
    (command,) = record["commands"]
    assert (command["function"], command["command"]) == ("Robot_Execute", "slvMove")
    counts = {
        name: command[name] for name in ("calls", "answered", "retries", "retried_calls", "late_replies")
    }
    assert counts == {"calls": 1, "answered": 1, "retries": 3, "retried_calls": 1, "late_replies": 1}
    assert command["latency_ms"]["max"] == 7.24
    assert command["line_time_share"] == 1.0


@pytest.mark.parametrize("path", ALL, ids=lambda path: path.name)
def test_figures_agree_with_calls(path: Path) -> None:
    calls = [json.loads(line) for line in run_here("calls", path, "--json").lines]
    found = records(run_here("stats", path, "--json"))
    if not calls:
        assert found == []
        return
    (record,) = found
    rows = {
        (row["client"], row["transport"], row["function"], row["command"]): row for row in record["commands"]
    }
    for key, row in rows.items():
        own = [
            call
            for call in calls
            if (call["client"], call["transport"], call["function"], call["command"]) == key
        ]
        assert row["calls"] == len(own)
        assert row["retries"] == sum(call["retries"] for call in own)
        assert row["executing"] == sum(call["executing"] for call in own)
        for outcome in ("answered", "refused", "unanswered", "capture_ended"):
            assert row[outcome] == sum(call["outcome"] == outcome for call in own)
    counted = sum(row["calls"] for row in record["commands"])
    assert counted == record["total"]["calls"] == len(calls)


def test_figures_of_generated_traffic(tmp_path: Path) -> None:
    truth = write(tmp_path / "slave.pcap", 20_000)
    (record,) = records(run_here("stats", tmp_path / "slave.pcap", "--json"))
    total = record["total"]
    assert total["calls"] == truth.calls
    assert total["retries"] == truth.retries
    assert total["late_replies"] == truth.late_replies
    assert total["unanswered"] + total["capture_ended"] == truth.unanswered
    assert total["latency_ms"]["min"] >= 0.6
    assert 2.9 <= total["latency_ms"]["max"] < 2.91


def test_windows(tmp_path: Path) -> None:
    truth = write(tmp_path / "slave.pcap", 5_000)
    path = tmp_path / "slave.pcap"
    found = records(run_here("stats", path, "--json", "--window", "2.5"))
    starts = [record["start"] for record in found]
    assert starts[:3] == [1700000000.0, 1700000002.5, 1700000005.0]
    assert {round(record["end"] - record["start"], 6) for record in found} == {2.5}
    assert sum(record["total"]["calls"] for record in found) == truth.calls
    assert found[1]["total"]["calls_per_s"] == pytest.approx(125, abs=0.5)
    tables = run_here("stats", path, "--window", "2.5").out.split("\n\n2023-")
    assert len(tables) == len(found)


@pytest.mark.parametrize("window", ["0", "0.01", "-1", "long"])
def test_no_window(window: str) -> None:
    assert run_here("stats", LOST, "--window", window).code == ExitCode.USAGE


def test_a_filter() -> None:
    (record,) = records(run_here("stats", LOST, "--json", "-f", "outcome == refused"))
    assert record["total"]["calls"] == record["total"]["refused"] == 4
    assert run_here("stats", LOST, "-f", "call > 1000000").out == ""
    done = run_here("stats", LOST, "-f", "comand == slvMove")
    assert done.code == ExitCode.USAGE
    assert "command" in done.err
    assert "^" in done.err


def test_a_capture_that_breaks_off() -> None:
    done = run("stats", "-", "--json", stdin=LOST.read_bytes()[:5000])
    assert done.code == ExitCode.DAMAGED
    assert records(done)[0]["total"]["calls"] > 5


def test_nothing_to_read() -> None:
    assert run_here("stats").code == ExitCode.USAGE
    done = run_here("stats", CAPTURES / "missing.pcap")
    assert (done.code, done.out) == (ExitCode.UNREADABLE, "")


def test_colours() -> None:
    assert "\x1b[" in run_here("stats", LOST, "--color", "always").out
    assert "\x1b[" not in run_here("stats", CAPTURES / "malformed.pcapng").out
