"""``bcapscope compare`` from the outside."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from bcapscope.cli.common.exit_codes import ExitCode
from tests.cli.late_retry import late_retry
from tests.cli.run import CAPTURES, run, run_here

GOOD = CAPTURES / "slave-session.pcapng"
BAD = CAPTURES / "slave-mode-lost.pcapng"


def test_what_went_wrong_stands_first() -> None:
    done = run_here("compare", GOOD, BAD)
    assert done.code == ExitCode.OK
    lines = done.lines
    assert lines[0].startswith(f"good  {GOOD}")
    assert lines[1].startswith(f"bad   {BAD}")
    assert lines[3] == "notable"
    assert "64.000 ms" in lines[5]
    assert lines.index("notable") < lines.index("findings") < lines.index("other differences")
    assert "  0 → 1  warning set-point-gap" in lines
    assert f"called only in {GOOD}" in lines
    assert done.err.splitlines() == [
        f"{GOOD}:",
        "518 frames in 518 packets",
        f"{BAD}:",
        "70 frames in 70 packets",
    ]


def test_a_capture_does_not_differ_from_itself() -> None:
    done = run_here("compare", BAD, BAD)
    assert done.lines[2:] == ["", "nothing notable differs"]
    (line,) = run_here("compare", BAD, BAD, "--json").lines
    record = json.loads(line)
    assert record["notable"] is False
    assert not any(record[part] for part in ("differences", "only_good", "only_bad", "findings"))


@pytest.mark.parametrize(("options", "is_lost"), [([], False), (["--taken-at", "client"], True)])
def test_the_place_of_the_captures_decides_whether_a_reply_was_lost(
    tmp_path: Path, options: list[str], is_lost: bool
) -> None:
    (line,) = run_here("compare", GOOD, late_retry(tmp_path), "--json", *options).lines
    rules = [finding["rule"] for finding in json.loads(line)["findings"]]
    assert ("reply-lost" in rules) is is_lost


def test_json_is_one_object() -> None:
    (line,) = run_here("compare", GOOD, BAD, "--json").lines
    record = json.loads(line)
    assert record["notable"] is True
    assert (record["good"]["name"], record["good"]["calls"]) == (str(GOOD), 257)
    assert (record["bad"]["calls"], record["bad"]["stays"]) == (35, 1)
    assert record["differences"][0]["notable"] is True
    assert {"function": "Service_Stop", "command": None, "calls": 1} in record["only_good"]
    assert record["only_bad"] == []
    assert record["findings"][0]["rule"] == "set-point-gap"


def test_figures_agree_with_stats() -> None:
    record = json.loads(run_here("compare", GOOD, BAD, "--json").out)
    rows = [json.loads(run_here("stats", path, "--json").out)["commands"] for path in (GOOD, BAD)]
    (good, bad) = (next(row for row in found if row["command"] == "slvMove") for found in rows)
    (figure,) = [
        each
        for each in record["differences"]
        if (each["command"], each["figure"]) == ("slvMove", "latency_ms.p99")
    ]
    assert (figure["good"], figure["bad"]) == (good["latency_ms"]["p99"], bad["latency_ms"]["p99"])
    assert figure["ratio"] == figure["bad"] / figure["good"]


def test_a_damaged_capture_is_compared_as_far_as_it_goes(tmp_path: Path) -> None:
    cut = tmp_path / "cut.pcapng"
    cut.write_bytes(GOOD.read_bytes()[:20_000])
    for paths in ((cut, BAD), (BAD, cut)):
        done = run_here("compare", *paths)
        assert done.code == ExitCode.DAMAGED
        assert "the capture ends inside" in done.err
        assert "notable" in done.lines


def test_standard_input_is_one_of_the_two() -> None:
    assert run("compare", GOOD, "-", stdin=GOOD.read_bytes()).lines[2:] == ["", "nothing notable differs"]
    assert run_here("compare", "-", "-").code == ExitCode.USAGE


def test_what_cannot_be_read_is_not_compared() -> None:
    for paths in ((GOOD, CAPTURES / "missing.pcap"), (CAPTURES / "README.md", BAD)):
        done = run_here("compare", *paths)
        assert (done.code, done.out) == (ExitCode.UNREADABLE, "")
    assert run_here("compare", GOOD).code == ExitCode.USAGE


def test_colours_and_hostile_names() -> None:
    assert "\x1b[" in run_here("compare", GOOD, BAD, "--color", "always").out
    out = run_here("compare", CAPTURES / "malformed.pcapng", GOOD).out
    assert "\x1b" not in out
    assert "\\x1b[2J" in out


def test_a_filter_chooses_calls_in_both() -> None:
    (line,) = run_here("compare", GOOD, BAD, "--json", "-f", "command == slvMove").lines
    record = json.loads(line)
    assert (record["good"]["calls"], record["bad"]["calls"]) == (240, 33)
    assert not record["only_good"]
    assert not record["only_bad"]
    (line,) = run_here("compare", GOOD, BAD, "--json", "-f", "command == Motor").lines
    record = json.loads(line)
    assert (record["bad"]["calls"], record["bad"]["stays"]) == (1, 0)
