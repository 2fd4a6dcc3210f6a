"""Filters that select nothing, or something else than meant."""

from __future__ import annotations

from pathlib import Path

import pytest

from bcapscope.cli.common.exit_codes import ExitCode
from tests.cli.run import CAPTURES, run_here

LOST = CAPTURES / "slave-mode-lost.pcapng"
HINT = "command 'slvMov' is in no table, did you mean 'slvMove'?"


@pytest.mark.parametrize(
    ("words", "sentence"),
    [
        (("decode",), f"0 of 70 frames match the filter; {HINT}"),
        (("decode", "--json"), f"0 of 70 frames match the filter; {HINT}"),
        (("decode", "--tree"), f"0 of 70 frames match the filter; {HINT}"),
        (("calls",), f"0 of 35 calls match the filter; {HINT}"),
        (("stats",), f"0 of 35 calls match the filter; {HINT}"),
        (("diagnose",), f"0 of 35 calls match the filter; {HINT}"),
        (("decode", "--lang", "ja"), "フレーム 70 個のうち、フィルタに一致するものはありません。"),
    ],
)
def test_a_filter_that_selects_nothing_says_so(words: tuple[str, ...], sentence: str) -> None:
    done = run_here(*words, LOST, "-f", "command == slvMov")
    assert done.code == ExitCode.OK
    assert done.err.startswith(sentence)


@pytest.mark.parametrize("command", ["slave", "compare", "extract", "report"])
def test_other_commands_say_so_too(command: str, tmp_path: Path) -> None:
    words = {
        "compare": ("compare", LOST, LOST),
        "extract": ("extract", LOST, "-o", tmp_path / "way.csv"),
        "report": ("report", LOST, "-o", tmp_path / "report.html"),
    }.get(command, (command, LOST))
    assert f"calls match the filter; {HINT}" in run_here(*words, "-f", "command == slvMov").err


def test_known_names_get_no_hint() -> None:
    done = run_here("decode", LOST, "-f", "command == TakeArm")
    assert done.err == "0 of 70 frames match the filter\n70 frames in 70 packets\n"


def test_a_filter_that_selects_something_says_nothing() -> None:
    assert run_here("decode", LOST, "-f", "command != slvMov").err == "70 frames in 70 packets\n"
    assert run_here("calls", LOST, "-f", "hresult == 0x83500121").err == "70 frames in 70 packets\n"


def test_a_capture_without_frames_does_not_blame_the_filter(tmp_path: Path) -> None:
    empty = tmp_path / "empty.pcap"
    empty.write_bytes((CAPTURES / "exchanges.pcap").read_bytes()[:24])
    assert "match" not in run_here("decode", empty, "-f", "serial == 1").err


def test_t_is_the_time_in_the_column() -> None:
    shown = [line.split()[1] for line in run_here("decode", LOST).lines]
    later = [line.split()[1] for line in run_here("decode", LOST, "-f", "t >= 0.312").lines]
    assert later == [time for time in shown if float(time) >= 0.312]
    calls = [line.split()[1] for line in run_here("calls", LOST).lines]
    assert [line.split()[1] for line in run_here("calls", LOST, "-f", "t >= 0.312").lines] == [
        time for time in calls if float(time) >= 0.312
    ]
    assert run_here("diagnose", LOST, "-f", "t < 0.1").lines[0].startswith("No problem found")


def test_time_stays_absolute_and_names_t() -> None:
    done = run_here("decode", LOST, "-f", "time > 2")
    assert len(done.lines) == 70
    assert done.err.startswith(
        "warning: time > 2 compares with seconds since 1970. For seconds since the first frame, use t > 2\n"
    )
    later = run_here("decode", LOST, "-f", 'time > "2023-11-14T22:13:20.2Z"')
    assert "warning" not in later.err
    assert later.lines == run_here("decode", LOST, "-f", "time > 1700000000.2").lines
    assert 0 < len(later.lines) < 70
    japanese = run_here("decode", LOST, "-f", "time > 2", "--lang", "ja")
    assert japanese.err.startswith("警告: time > 2 は 1970 年からの秒数との比較です。")


def test_fields_lists_t() -> None:
    lines = run_here("fields").lines
    assert any(line.split()[:3] == ["t", "both", "duration"] for line in lines)
    assert any("For seconds since the first frame, compare t" in line for line in lines)
