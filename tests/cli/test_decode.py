"""``bcapscope decode`` from the outside."""

from __future__ import annotations

import csv
import gzip
import io
import json
import os
import pty
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import pytest

from bcapscope.cli.common.exit_codes import ExitCode
from tests.cli.run import CAPTURES, run, run_here

SESSION = CAPTURES / "slave-session.pcapng"
RETRIES = CAPTURES / "retry-story.pcapng"
ALL = sorted([*CAPTURES.glob("*.pcap"), *CAPTURES.glob("*.pcapng")])


@pytest.mark.parametrize("path", ALL, ids=lambda path: path.name)
def test_every_sample_is_read_to_its_end(path: Path) -> None:
    done = run_here("decode", path)
    assert done.code == ExitCode.OK
    assert done.err.splitlines()[-1].startswith(f"{len(done.lines) - _malformed(done.lines)} frames in ")


def _malformed(lines: list[str]) -> int:
    return sum("     -     - " in line for line in lines)


def test_a_line_a_frame() -> None:
    lines = run_here("decode", RETRIES).lines
    assert len(lines) == 6
    assert lines[1].startswith(
        "     2     0.002010 192.168.0.10:50001 > 192.168.0.1:5007 udp request   1233  1232  "
        "Robot_Execute slvMove hRobot=1 vntParam=R4["
    )
    assert "udp response  1235  1232  S_OK Robot_Execute slvMove pVal=R4[" in lines[5]


def test_json_is_one_object_a_line() -> None:
    records = [json.loads(line) for line in run_here("decode", SESSION, "--json").lines]
    assert [record["frame"] for record in records] == list(range(1, len(records) + 1))
    assert not [record for record in records if record["problems"]]
    assert {record["function"] for record in records} >= {"Service_Start", "Robot_Execute", "Service_Stop"}
    assert all(record["function"] for record in records if record["kind"] == "response")


def test_csv_is_a_table_with_a_header() -> None:
    rows = list(csv.DictReader(io.StringIO(run_here("decode", RETRIES, "--csv").out)))
    assert [row["serial"] for row in rows] == ["1232", "1233", "1234", "1235", "1233", "1235"]
    assert {row["command"] for row in rows} == {"slvMove"}


def test_tree_and_hexdump() -> None:
    tree = run_here("decode", RETRIES, "--tree").out
    assert "HRESULT" in tree
    assert "argument count" in tree
    dump = run_here("decode", RETRIES, "--hex").out
    assert "01 64 00 00 00 d0 04 00  00 40 00 00 00 03 00 0a" in dump


def test_hex_goes_with_text_only() -> None:
    done = run_here("decode", RETRIES, "--hex", "--json")
    assert done.code == ExitCode.USAGE
    assert "--hex cannot be combined with --csv or --json" in done.err


def test_a_filter_keeps_numbers_and_pairing() -> None:
    lines = run_here("decode", RETRIES, "-f", "kind == response and serial == 1235").lines
    assert len(lines) == 1
    assert lines[0].startswith("     6     0.007240 ")
    assert "Robot_Execute slvMove" in lines[0]


def test_a_bad_filter_is_told_with_a_caret() -> None:
    done = run_here("decode", RETRIES, "-f", "serail == 5")
    assert done.code == ExitCode.USAGE
    assert "did you mean 'serial'?" in done.err
    assert done.err.splitlines()[-1].strip() == "^"
    assert done.out == ""


@pytest.mark.parametrize("clock", ["relative", "delta", "utc", "epoch"])
def test_clocks(clock: str) -> None:
    first, second, *_ = run_here("decode", RETRIES, "--time", clock).lines
    texts = {
        "relative": ("0.000000", "0.002010"),
        "delta": ("0.000000", "0.002010"),
        "utc": ("2023-11-14T22:13:20.000000000Z", "2023-11-14T22:13:20.002010000Z"),
        "epoch": ("1700000000.000000000", "1700000000.002010000"),
    }
    assert (first.split()[1], second.split()[1]) == texts[clock]


def test_several_captures_are_one_traffic() -> None:
    lines = run_here("decode", RETRIES, RETRIES).lines
    assert [int(line.split()[0]) for line in lines] == list(range(1, 13))


def test_gzip_and_standard_input() -> None:
    plain = run_here("decode", SESSION)
    assert run("decode", "-", stdin=gzip.compress(SESSION.read_bytes())) == plain


def test_frames_of_a_pipe_are_shown_as_they_come() -> None:
    argv = [sys.executable, "-m", "bcapscope", "decode", "-"]
    data = (CAPTURES / "exchanges.pcap").read_bytes()
    with subprocess.Popen(
        argv, stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.PIPE
    ) as done:
        assert done.stdin
        assert done.stdout
        assert done.stderr
        done.stdin.write(data[:24])
        at = 24
        for number in range(1, 4):
            size = 16 + int.from_bytes(data[at + 8 : at + 12], "little")
            done.stdin.write(data[at : at + size])
            done.stdin.flush()
            at += size
            assert (
                int(done.stdout.readline().split()[0]) == number
            )  # would wait for ever if it were held back
        done.stdin.close()
        assert done.stdout.read() == b""
        assert done.stderr.read() == b"3 frames in 3 packets\n"


@pytest.mark.lifecycle
def test_a_closed_pipe_ends_quietly(tmp_path: Path) -> None:
    many = tmp_path / "many.pcap"
    data = (CAPTURES / "exchanges.pcap").read_bytes()
    many.write_bytes(data[:24] + data[24:] * 3000)
    argv = [sys.executable, "-m", "bcapscope", "decode", str(many)]
    with subprocess.Popen(argv, stdout=subprocess.PIPE, stderr=subprocess.PIPE) as done:
        assert done.stdout
        assert done.stderr
        done.stdout.readline()
        done.stdout.close()
        assert done.stderr.read() == b""
    assert done.returncode == 0


@pytest.mark.parametrize("kept", [1, 8, 100])
def test_a_truncated_capture_gives_all_before_the_cut(tmp_path: Path, kept: int) -> None:
    cut = tmp_path / "cut.pcapng"
    cut.write_bytes(SESSION.read_bytes()[:-kept])
    whole, done = run_here("decode", SESSION), run_here("decode", cut)
    assert done.code == ExitCode.DAMAGED
    assert done.lines == whole.lines[: len(done.lines)]
    assert len(done.lines) >= len(whole.lines) - 2
    (sentence,) = [line for line in done.err.splitlines() if line.startswith(str(cut))]
    assert "byte" in sentence


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="there is no /dev/full on this system")
@pytest.mark.parametrize("style", [[], ["--json"], ["--csv"], ["--tree"]])
def test_a_full_disk_is_told_in_one_sentence(style: list[str]) -> None:
    argv = [sys.executable, "-m", "bcapscope", "decode", str(SESSION), *style]
    with Path("/dev/full").open("wb") as full:
        done = subprocess.run(argv, stdout=full, stderr=subprocess.PIPE, check=False)
    assert done.returncode == ExitCode.UNWRITABLE
    assert done.stderr == b"Error: cannot write to standard output: no space left on device\n"


def test_a_truncated_compressed_capture_gives_all_before_the_cut(tmp_path: Path) -> None:
    cut = tmp_path / "cut.pcapng.gz"
    cut.write_bytes(gzip.compress(SESSION.read_bytes())[:-1000])
    whole, done = run_here("decode", SESSION), run_here("decode", cut)
    assert done.code == ExitCode.DAMAGED
    assert done.lines
    assert done.lines == whole.lines[: len(done.lines)]
    assert f"{cut}: the compressed file ends in the middle" in done.err


@pytest.mark.parametrize("data", [b"", b"\n", b"not a capture at all", b"\x7fELF" + bytes(60)])
def test_what_is_no_capture_is_told_in_one_sentence(tmp_path: Path, data: bytes) -> None:
    path = tmp_path / "what"
    path.write_bytes(data)
    done = run_here("decode", path)
    assert done.code == ExitCode.UNREADABLE
    assert done.out == ""
    assert done.err.startswith(f"{path}: ")
    assert "Traceback" not in done.err


def test_of_a_missing_file_nothing_is_counted(tmp_path: Path) -> None:
    path = tmp_path / "none.pcap"
    done = run_here("decode", path)
    assert done.err == f"{path}: cannot be opened: no such file or directory\n"


def test_a_missing_file_does_not_hide_the_others(tmp_path: Path) -> None:
    done = run_here("decode", tmp_path / "none.pcap", RETRIES)
    assert done.code == ExitCode.UNREADABLE
    assert len(done.lines) == 6
    assert "no such file" in done.err


@pytest.mark.parametrize("command", ["decode", "calls", "diagnose"])
def test_no_capture_is_a_mistake_in_the_command_line(command: str) -> None:
    done = run_here(command)
    assert done.code == ExitCode.USAGE
    assert "give captures or '-' (standard input), or give an interface with -i" in done.err


@pytest.mark.parametrize(
    "line", [["slave"], ["stats"], ["extract", "-o", "way.csv"], ["report", "-o", "page.html"]]
)
def test_what_cannot_listen_does_not_speak_of_interfaces(line: list[str]) -> None:
    done = run_here(*line)
    assert done.code == ExitCode.USAGE
    assert "Missing argument 'PATH...'" in done.err


def test_a_server_on_another_port_is_told() -> None:
    assert "recognised by" not in run_here("decode", RETRIES).err
    lines = run_here("decode", RETRIES, "--port", "50001").lines
    assert "response" in lines[0]


def test_a_server_that_has_to_be_worked_out_is_said(tmp_path: Path) -> None:
    data = (CAPTURES / "exchanges.pcap").read_bytes().replace(b"\x13\x8f", b"\x3a\x9f")
    path = tmp_path / "other-port.pcap"
    path.write_bytes(data)
    done = run_here("decode", path)
    assert "controller 192.168.0.1:15007 (udp), recognised by " in done.err
    assert len(done.lines) == len(run_here("decode", CAPTURES / "exchanges.pcap").lines)


def test_colours_are_for_terminals() -> None:
    assert "\x1b" not in run_here("decode", RETRIES).out
    assert "\x1b[" in run_here("decode", RETRIES, "--color", "always").out
    assert "\x1b[" in _on_a_terminal(NO_COLOR="")
    assert "\x1b[" not in _on_a_terminal(NO_COLOR="1")


def _on_a_terminal(**environment: str) -> str:
    main, side = pty.openpty()
    argv = [sys.executable, "-m", "bcapscope", "decode", str(RETRIES)]
    with subprocess.Popen(argv, stdout=side, stderr=subprocess.DEVNULL, env={**os.environ, **environment}):
        os.close(side)
        shown = b""
        try:
            while chunk := os.read(main, 65536):
                shown += chunk
        except OSError:
            pass  # how Linux says that the other side is closed
    os.close(main)
    return shown.decode()


@pytest.mark.parametrize("style", [[], ["--json"], ["--csv"], ["--tree", "--hex", "--full"]])
def test_hostile_strings_never_get_out_raw(style: list[str]) -> None:
    out = run_here("decode", CAPTURES / "malformed.pcapng", *style).out
    assert not [char for char in out if not char.isprintable() and char not in "\n\r\u3000"]
    assert "\r" not in out.replace("\r\n", "") or style == ["--csv"]


def test_comments_of_the_capture_are_shown_and_stay_escaped() -> None:
    assert run_here("decode", RETRIES).lines[0].endswith("  # a new set point, serial 1232")
    assert json.loads(run_here("decode", RETRIES, "--json").lines[0])["comments"] == [
        "a new set point, serial 1232"
    ]
    assert "comments" not in json.loads(run_here("decode", CAPTURES / "exchanges.pcap", "--json").lines[0])


def test_pasted_hex_is_read_and_what_is_wrong_with_it_said(golden: Callable[[str, bytes], None]) -> None:
    done = run_here("decode", "--text", CAPTURES / "damaged-dumps.txt")
    assert done.code == ExitCode.OK
    assert done.err == "17 packets found in the text\n"
    shown = "".join(f"{line}\n" for line in done.lines)
    golden("damaged-dumps.txt", shown.encode())
    assert shown.count("length is 100, but there are 98 bytes") == 2
    assert shown.count("length is 100, but there are 51 bytes") == 3
    assert "unknown command; perhaps slvChangeMode was meant (at 29)" in shown
    text = (CAPTURES / "damaged-dumps.txt").read_bytes()
    assert run("decode", "--text", "-", stdin=text).out == done.out
    assert run("decode", "--text", "-", stdin=text.decode().encode("utf-16")).out == done.out


@pytest.mark.parametrize("text", [b"no hex at all\n", b"", b"\xff\xfe\x00"])
def test_a_text_without_hex_is_said(text: bytes) -> None:
    done = run("decode", "--text", "-", stdin=text)
    assert done.code == ExitCode.UNREADABLE
    assert "this text contains no hex" in done.err


def test_one_source_at_a_time() -> None:
    assert run_here("decode", RETRIES, "-i", "lo").code == ExitCode.USAGE
    assert run_here("decode", "--text", "-", "-i", "lo").code == ExitCode.USAGE


def test_an_unknown_interface_is_said() -> None:
    done = run_here("decode", "-i", "nosuch0")
    assert done.code == ExitCode.UNREADABLE
    assert "no interface is named nosuch0" in done.err


@pytest.mark.lifecycle
@pytest.mark.parametrize(
    ("redirection", "code"),
    [(">&-", ExitCode.UNWRITABLE), ("2>&-", ExitCode.UNWRITABLE), ("<&-", ExitCode.USAGE)],
)
def test_closed_standard_streams_end_in_order(redirection: str, code: ExitCode) -> None:
    command = f"{sys.executable} -m bcapscope decode - {redirection}"
    done = subprocess.run(["sh", "-c", command], capture_output=True, check=False, input=b"")
    assert done.returncode == code
    assert b"Traceback" not in done.stderr


@pytest.mark.parametrize(
    ("words", "told"),
    [
        (("--json", "--csv"), "--json and --csv exclude each other"),
        (("--full",), "--full has no effect without --tree"),
        (("--full", "--json"), "--full has no effect without --tree"),
    ],
)
def test_styles_that_do_not_go_together_are_told(words: tuple[str, ...], told: str) -> None:
    done = run_here("decode", CAPTURES / "retry-story.pcapng", *words)
    assert (done.code, done.out) == (ExitCode.USAGE, "")
    assert told in done.err
