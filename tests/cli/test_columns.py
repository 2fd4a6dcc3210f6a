"""Chosen columns, CSV tables, and lines that fit the terminal."""

from __future__ import annotations

import csv
import io
import json
import os
import struct
import subprocess
import sys
from contextlib import suppress
from pathlib import Path

import pytest

from bcapscope.cli.common.exit_codes import ExitCode
from bcapscope.protocol.text_format import display_width
from bcapscope.traffic.filter.field_table import FIELDS, RecordKind
from tests.cli.run import CAPTURES, run_here

LOST, STORY = CAPTURES / "slave-mode-lost.pcapng", CAPTURES / "retry-story.pcapng"
ALL = sorted([*CAPTURES.glob("*.pcap"), *CAPTURES.glob("*.pcapng")])


def table(text: str) -> list[dict[str, str]]:
    return list(csv.DictReader(io.StringIO(text)))


def test_columns_of_frames() -> None:
    done = run_here("decode", LOST, "--columns", "frame,t,command,arg[2][0],hresult,src")
    assert done.lines[0].split() == ["frame", "t", "command", "arg[2][0]", "hresult", "src"]
    wanted = ["63", "0.312000", "slvMove", "18.0", "-", "192.168.0.10:50001"]
    assert done.lines[63].split() == wanted
    assert done.lines[64].split()[-2:] == ["0x84201482", "192.168.0.1:5007"]
    assert len({line.index("slvMove") for line in done.lines[10:60]}) == 1


def test_columns_of_calls() -> None:
    done = run_here("calls", STORY, "--columns", "call,t,latency,latency_ms,serials,verdict,started")
    assert done.lines[1].split("  ")[-1] == "2023-11-14T22:13:20.000000000Z"
    assert "1232 1233 1234 1235" in done.lines[1]
    assert done.lines[1].split()[:4] == ["1", "0.000000", "7.240ms", "7.240"]


def test_columns_as_json_and_csv() -> None:
    chosen = ("--columns", "frame,command,arg,hresult,src,time,t")
    records = [json.loads(line) for line in run_here("decode", LOST, "--json", *chosen).lines]
    assert list(records[62]) == ["frame", "command", "arg", "hresult", "src", "time", "t"]
    assert records[62]["arg"] == [2, "slvMove", [18.0, 0.0, 93.0, 0.0, 90.0, 0.0, 0.0, 0.0]]
    assert (records[63]["hresult"], records[63]["src"]) == (0x84201482, "192.168.0.1:5007")
    whole = [json.loads(line) for line in run_here("decode", LOST, "--json").lines]
    assert [record["time"] for record in records] == [record["time"] for record in whole]
    rows = table(run_here("decode", LOST, "--csv", *chosen).out)
    assert rows[63]["hresult"] == str(0x84201482)
    assert rows[62]["time"] == "1700000000.296000000"
    assert rows[62]["hresult"] == ""


@pytest.mark.parametrize("path", ALL, ids=lambda path: path.name)
@pytest.mark.parametrize("style", [(), ("--json",), ("--csv",)])
def test_every_field_can_be_a_column(path: Path, style: tuple[str, ...]) -> None:
    for command, kind in (("decode", RecordKind.FRAME), ("calls", RecordKind.CALL)):
        names = [field.name for field in FIELDS if kind in field.applies_to]
        done = run_here(command, path, "--columns", ",".join([*names, "file", "file_packet"]), *style)
        assert done.code == ExitCode.OK
        assert all(line.isprintable() for line in done.lines)


@pytest.mark.parametrize(
    ("words", "reason"),
    [
        (("decode", LOST, "--columns", "t,comand"), "there is no field 'comand', did you mean 'command'?"),
        (("decode", LOST, "--columns", "latency"), "latency"),
        (("decode", LOST, "--columns", "t,,command"), "there is no field ''"),
        (("decode", LOST, "--columns", "command[0]"), "command"),
        (("decode", LOST, "--columns", "t", "--tree"), "--columns excludes --tree and --hex"),
        (("calls", LOST, "--columns", "t", "--tree"), "--columns excludes --tree"),
        (("calls", LOST, "--csv", "--json"), "--json and --csv exclude each other"),
        (("stats", LOST, "--csv", "--json"), "--json and --csv exclude each other"),
    ],
)
def test_what_makes_no_sense_is_an_error(words: tuple[str | Path, ...], reason: str) -> None:
    done = run_here(*words)
    assert done.code == ExitCode.USAGE
    assert reason in done.err


def test_csv_of_calls_has_the_fields_of_json() -> None:
    rows = table(run_here("calls", LOST, "--csv").out)
    records = [json.loads(line) for line in run_here("calls", LOST, "--json").lines]
    assert len(rows) == len(records) == 35
    for row, record in zip(rows, records, strict=True):
        for name in ("call", "function_id", "command", "client", "hresult", "outcome", "verdict", "retries"):
            assert row[name] == str(record[name])
        assert float(row["latency_ms"]) == pytest.approx(record["latency_ms"])
        assert row["requests"] == " ".join(map(str, record["requests"]))
        assert float(row["started"]) == pytest.approx(record["started"])


def test_csv_of_statistics_has_the_figures_of_json() -> None:
    rows = table(run_here("stats", LOST, "--csv").out)
    record = json.loads(run_here("stats", LOST, "--json").lines[0])
    assert [row["row"] for row in rows] == ["total", "client", *["command"] * len(record["commands"])]
    for row, found in zip(rows, (record["total"], *record["clients"], *record["commands"]), strict=True):
        for name in ("calls", "answered", "refused", "retries", "calls_per_s", "request_bytes"):
            assert row[name] == str(found[name])
        assert row["latency_ms.p99.9"] == str(found["latency_ms"]["p99.9"])
        assert row["command"] == (found.get("command") or "")
    windows = table(run_here("stats", LOST, "--csv", "--window", "0.1").out)
    assert len({row["start"] for row in windows}) > 1


def test_csv_of_several_captures_names_them() -> None:
    rows = table(run_here("decode", LOST, STORY, "--csv").out)
    assert {row["file"] for row in rows} == {str(LOST), str(STORY)}
    assert max(int(row["file_packet"]) for row in rows if row["file"] == str(STORY)) == 6
    assert "file" not in table(run_here("decode", LOST, "--csv").out)[0]


def test_text_from_the_wire_is_no_formula() -> None:
    rows = table(
        run_here("decode", CAPTURES / "malformed.pcapng", "--csv", "--columns", "command,arg,src").out
    )
    assert not any(cell.startswith(("=", "+", "@")) for row in rows for cell in row.values())


def on_terminal(columns: int, *words: str | Path) -> list[str]:
    """Run a command on a terminal of so many columns, and return the rows that it writes."""
    pty, fcntl, termios = map(pytest.importorskip, ("pty", "fcntl", "termios"))  # Windows has none
    main, secondary = pty.openpty()
    fcntl.ioctl(secondary, termios.TIOCSWINSZ, struct.pack("HHHH", 24, columns, 0, 0))
    env = {name: value for name, value in os.environ.items() if name != "COLUMNS"} | {"NO_COLOR": "1"}
    argv = [sys.executable, "-m", "bcapscope", *map(str, words)]
    out = bytearray()
    with subprocess.Popen(argv, stdout=secondary, stderr=subprocess.DEVNULL, env=env):
        os.close(secondary)
        with suppress(OSError):  # the terminal was closed
            while data := os.read(main, 65536):
                out += data
    os.close(main)
    return out.decode().splitlines()


@pytest.mark.parametrize("command", ["decode", "calls"])
@pytest.mark.parametrize("language", ["en", "ja"])
def test_lines_are_folded_at_the_width_of_a_terminal(command: str, language: str) -> None:
    rows = on_terminal(72, command, LOST, "--lang", language)
    assert max(map(display_width, rows)) <= 72
    lines = run_here(command, LOST, "--lang", language).lines
    assert "".join(rows).replace(" ", "") == "".join(lines).replace(" ", "")
    assert len(rows) > len(lines)
    assert on_terminal(72, command, LOST, "--lang", language, "--wide") == lines


def test_columns_are_cut_at_the_width_of_a_terminal() -> None:
    rows = on_terminal(60, "decode", LOST, "--columns", "t,function,arg")
    assert len(rows) == 71
    assert max(map(display_width, rows)) == 60
    assert rows[-2].endswith("1") or rows[-2].endswith("…")
    whole = run_here("decode", LOST, "--columns", "t,function,arg").lines
    assert on_terminal(60, "decode", LOST, "--columns", "t,function,arg", "--wide") == whole
