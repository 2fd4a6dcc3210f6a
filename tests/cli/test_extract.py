"""``bcapscope extract`` from the outside."""

from __future__ import annotations

import csv
import json
import os
import subprocess
import sys
import time
from pathlib import Path

import pytest

from bcapscope.cli.common.exit_codes import ExitCode
from tests.analysis.scenes import Story
from tests.cli.late_retry import late_retry
from tests.cli.run import CAPTURES, run_here

SESSION = CAPTURES / "slave-session.pcapng"
LOST = CAPTURES / "slave-mode-lost.pcapng"
ROBOTS = CAPTURES / "two-robots.pcapng"
NO_SLAVE_MODE = CAPTURES / "tcp-gap.pcap"
MAX_OPEN = 40

_LIMITED = """\
import os, resource, sys
resource.setrlimit(resource.RLIMIT_NOFILE, (int(sys.argv[1]),) * 2)
os.execv(sys.executable, [sys.executable, "-m", "bcapscope", *sys.argv[2:]])
"""
"""Runs the program with so many open files at the most."""


def rows(path: Path) -> list[dict[str, str]]:
    with path.open(encoding="utf-8", newline="") as file:
        return list(csv.DictReader(file))


def test_a_session(tmp_path: Path) -> None:
    out = tmp_path / "way.csv"
    ran = run_here("extract", SESSION, "-o", out)
    assert (ran.code, ran.out) == (ExitCode.OK, "")
    assert f"{out}: 240 set points in 1.885 s, J type, mode 0x202, 192.168.0.10:50001" in ran.err
    (*_, last) = found = rows(out)
    assert len(found) == 240
    assert float(last["J1_deg"]) == 24.0
    assert float(last["returned_J1_deg"]) == pytest.approx(24.0, abs=0.01)
    assert float(found[1]["controller_time_ms"]) > float(found[0]["controller_time_ms"])


def test_json_says_the_same_as_csv(tmp_path: Path) -> None:
    run_here("extract", SESSION, "-o", tmp_path / "way.csv")
    run_here("extract", SESSION, "-o", tmp_path / "way.json")
    book = json.loads((tmp_path / "way.json").read_bytes())
    table = [[float(cell) for cell in row.values()] for row in rows(tmp_path / "way.csv")]
    assert book["rows"] == table


@pytest.mark.parametrize(
    ("options", "code"), [([], ExitCode.NO_DATA), (["--taken-at", "client"], ExitCode.OK)]
)
def test_the_place_of_the_capture_decides_which_calls_a_filter_selects(
    tmp_path: Path, options: list[str], code: ExitCode
) -> None:
    path = late_retry(tmp_path)
    chosen = ["-f", "verdict == 'reply lost'", *options]
    assert run_here("extract", path, "-o", tmp_path / "way.csv", *chosen).code == code


def test_retries_are_gone(tmp_path: Path) -> None:
    run_here("extract", CAPTURES / "retry-story.pcapng", "-o", tmp_path / "way.csv")
    (row,) = rows(tmp_path / "way.csv")
    assert (row["time_s"], row["retries"], row["reply_s"]) == ("0.000000000", "3", "0.007240000")


def test_what_was_refused_is_left_out(tmp_path: Path) -> None:
    ran = run_here("extract", LOST, "-o", tmp_path / "way.csv")
    assert len(rows(tmp_path / "way.csv")) == 30
    assert "left out: 3 refused by the controller\n" in ran.err


def test_more_stays_than_files_may_be_open(tmp_path: Path) -> None:
    story = Story()
    client = story.client()
    client.open()
    client.ready()
    for number in range(MAX_OPEN):
        client.enter(40 + 100 * number)
        client.move(50 + 100 * number, 2)
    capture = tmp_path / "many.pcap"
    capture.write_bytes(story.capture())
    command = ["extract", str(capture), "-o", str(tmp_path / "way.csv")]
    argv = [sys.executable, "-c", _LIMITED, str(MAX_OPEN), *command]
    done = subprocess.run(argv, capture_output=True, check=False)
    assert done.returncode == ExitCode.OK, done.stderr.decode()
    assert len(list(tmp_path.glob("way-*.csv"))) == MAX_OPEN


def test_several_stays_are_several_files(tmp_path: Path) -> None:
    ran = run_here("extract", ROBOTS, "-o", tmp_path / "way.csv")
    assert sorted(path.name for path in tmp_path.iterdir()) == ["way-1.csv", "way-2.csv"]
    assert "way-1.csv: 12 set points" in ran.err


@pytest.mark.parametrize("client", ["fd00:1::a", "[fd00:1::a]:50001"])
def test_one_client_of_several(tmp_path: Path, client: str) -> None:
    run_here("extract", ROBOTS, "-o", tmp_path / "way.csv", "--client", client)
    assert rows(tmp_path / "way.csv")[1]["J1_deg"] == "-0.25"
    ran = run_here("extract", ROBOTS, "-o", tmp_path / "none.csv", "--client", "10.9.8.7")
    assert (ran.code, ran.err.splitlines()[-1]) == (
        ExitCode.NO_DATA,
        "no set points (slvMove) by 10.9.8.7 found, so no trajectory was written",
    )


def test_a_filter_chooses_set_points(tmp_path: Path) -> None:
    ran = run_here("extract", SESSION, "-o", tmp_path / "way.csv", "-f", "call <= 20")
    assert len(rows(tmp_path / "way.csv")) == 9
    assert "left out: 231 not selected\n" in ran.err
    ran = run_here("extract", SESSION, "-o", tmp_path / "none.csv", "-f", "call < 3")
    assert ran.code == ExitCode.NO_DATA
    assert "240 set points found, but none is part of a trajectory" in ran.err
    assert not (tmp_path / "none.csv").exists()


def test_without_slave_mode(tmp_path: Path) -> None:
    ran = run_here("extract", NO_SLAVE_MODE, "-o", tmp_path / "way.csv")
    assert ran.code == ExitCode.NO_DATA
    assert ran.err.splitlines()[-1] == "no set points (slvMove) found, so no trajectory was written"
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("there", ["way.csv", "way-2.csv"])
def test_nothing_is_overwritten_unless_told(tmp_path: Path, there: str) -> None:
    (tmp_path / there).write_text("mine")
    ran = run_here("extract", ROBOTS, "-o", tmp_path / "way.csv")
    assert ran.code == ExitCode.UNWRITABLE
    assert f"{there}: exists already. Add --force to overwrite it" in ran.err
    assert [path.read_text() for path in tmp_path.iterdir()] == ["mine"]
    assert run_here("extract", ROBOTS, "-o", tmp_path / "way.csv", "--force").code == ExitCode.OK
    assert len(rows(tmp_path / "way-2.csv")) == 12


def test_what_cannot_be_written_is_said(tmp_path: Path) -> None:
    ran = run_here("extract", SESSION, "-o", tmp_path / "nowhere" / "way.csv")
    assert ran.code == ExitCode.UNWRITABLE
    assert "no such file or directory" in ran.err
    assert "Traceback" not in ran.err
    (tmp_path / "dir.csv").mkdir()
    assert run_here("extract", SESSION, "-o", tmp_path / "dir.csv", "--force").code == ExitCode.UNWRITABLE


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="there are no pipes with names")
def test_a_signal_that_ends_it_leaves_nothing_half_written(tmp_path: Path) -> None:
    pipe = tmp_path / "session.pcapng"
    os.mkfifo(pipe)
    argv = [sys.executable, "-m", "bcapscope", "extract", str(pipe), "-o", str(tmp_path / "way.csv")]
    with subprocess.Popen(argv, stderr=subprocess.PIPE) as process, pipe.open("wb") as writer:
        try:
            writer.write(SESSION.read_bytes())
            writer.flush()
            until = time.monotonic() + 30
            while not (begun := list(tmp_path.glob(".way*.part"))):
                assert time.monotonic() < until
                assert process.poll() is None
                time.sleep(0.01)
            process.terminate()
            _, printed = process.communicate(timeout=30)
        finally:
            process.kill()
    assert begun
    assert (process.returncode, printed) == (ExitCode.INTERRUPTED, b"")
    assert list(tmp_path.iterdir()) == [pipe]


def test_the_name_tells_the_format(tmp_path: Path) -> None:
    assert run_here("extract", SESSION, "-o", tmp_path / "way.txt").code == ExitCode.USAGE


def test_a_damaged_capture_is_written_up_to_the_damage(tmp_path: Path) -> None:
    whole = SESSION.read_bytes()
    (tmp_path / "cut.pcapng").write_bytes(whole[: len(whole) // 2])
    ran = run_here("extract", tmp_path / "cut.pcapng", "-o", tmp_path / "way.csv")
    assert ran.code == ExitCode.DAMAGED
    assert 50 < len(rows(tmp_path / "way.csv")) < 240
