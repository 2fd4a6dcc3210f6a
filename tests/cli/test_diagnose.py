"""``bcapscope diagnose`` from the outside."""

from __future__ import annotations

import json
import os
import select
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

import pytest

from bcapscope.cli.common.exit_codes import ExitCode
from tests.capture.packets import request
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


def test_rules_and_severities_select() -> None:
    whole = [json.loads(line) for line in run_here("diagnose", LOST, "--json").lines]
    for words, wanted in {
        ("--rule", "underflow"): [2],
        ("--rule", "underflow", "--rule", "set-point-gap"): [1, 2],
        ("--severity", "warning"): [
            finding["finding"] for finding in whole if finding["severity"] == "warning"
        ],
        ("--severity", "error", "--severity", "warning"): [
            finding["finding"] for finding in whole if finding["severity"] != "note"
        ],
        ("--rule", "underflow", "--severity", "note"): [],
    }.items():
        chosen = [json.loads(line) for line in run_here("diagnose", LOST, "--json", *words).lines]
        assert [finding["finding"] for finding in chosen] == wanted
        assert chosen == [finding for finding in whole if finding["finding"] in wanted]


def test_the_text_keeps_the_numbers_and_counts_what_is_hidden() -> None:
    done = run_here("diagnose", LOST, "--rule", "underflow")
    assert done.lines[0] == "2 error underflow, follows from 1"
    assert done.lines[-2] == run_here("diagnose", LOST).lines[-1]
    assert done.lines[-1] == "1 of 5 findings shown, selected by --rule and --severity"
    japanese = run_here("diagnose", LOST, "--rule", "polling", "--lang", "ja").lines
    assert japanese[-1] == "検出事項 5 件のうち 0 件を表示 (--rule と --severity で選択)"


def test_an_unknown_rule_is_an_error_with_the_nearest_one() -> None:
    done = run_here("diagnose", LOST, "--rule", "underflw")
    assert done.code == ExitCode.USAGE
    assert "no rule is named 'underflw', did you mean 'underflow'?" in done.err


@pytest.mark.parametrize(
    ("words", "code"),
    [
        (("--fail-on", "error"), ExitCode.FINDINGS),
        (("--fail-on", "note"), ExitCode.FINDINGS),
        (("--fail-on", "error", "--rule", "set-point-gap"), ExitCode.OK),
        (("--fail-on", "warning", "--rule", "set-point-gap"), ExitCode.FINDINGS),
        (("--fail-on", "note", "--rule", "polling"), ExitCode.OK),
        (("--fail-on", "error", "--json"), ExitCode.FINDINGS),
        ((), ExitCode.OK),
    ],
)
def test_fail_on_sets_the_exit_code(words: tuple[str, ...], code: ExitCode) -> None:
    assert run_here("diagnose", LOST, *words).code == code


def test_reading_errors_outweigh_findings(tmp_path: Path) -> None:
    broken = tmp_path / "broken.pcapng"
    broken.write_bytes(LOST.read_bytes()[:-30])
    assert run_here("diagnose", broken, "--fail-on", "note").code == ExitCode.DAMAGED
    assert run_here("diagnose", CAPTURES / "vlan-ipv6.pcap", "--fail-on", "note").code == ExitCode.OK


def test_json_has_times_client_and_calls() -> None:
    findings = [json.loads(line) for line in run_here("diagnose", LOST, "--json").lines]
    frames = [json.loads(line) for line in run_here("decode", LOST, "--json").lines]
    started = {call["call"]: call for call in map(json.loads, run_here("calls", LOST, "--json").lines)}
    underflow = findings[1]
    assert underflow["time"] == pytest.approx(underflow["began"] / 1e9)
    assert underflow["t"] == pytest.approx(underflow["time"] - frames[0]["time"], abs=1e-6)
    (call,) = underflow["calls"]
    assert started[call]["hresult"] == 0x84201482
    assert (underflow["client"], underflow["server"]) == (started[call]["client"], started[call]["server"])
    repeated = next(finding for finding in findings if finding["count"] > 1)
    assert repeated["first"] < repeated["last"]
    assert (underflow["first"], underflow["last"]) == (None, None)


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_signal_ends_reading_and_the_report_follows(number: signal.Signals) -> None:
    argv = [sys.executable, "-m", "bcapscope", "diagnose", "-"]
    pipe = subprocess.PIPE
    with subprocess.Popen(argv, stdin=pipe, stdout=pipe, stderr=pipe) as program:
        assert program.stdin is not None
        assert program.stderr is not None
        program.stdin.write(LOST.read_bytes())
        program.stdin.flush()
        program.stderr.readline()  # the first finding; the pipe is still open
        program.send_signal(number)
        out, _ = program.communicate()
    assert program.returncode == ExitCode.OK
    assert out.decode().splitlines() == run_here("diagnose", LOST).lines


def test_on_a_pipe_each_finding_is_printed_when_it_is_made() -> None:
    data = LOST.read_bytes()
    argv = [sys.executable, "-m", "bcapscope", "diagnose", "-", "--fail-on", "error"]
    pipe = subprocess.PIPE
    with subprocess.Popen(argv, stdin=pipe, stdout=pipe, stderr=pipe) as program:
        assert program.stdin is not None
        assert program.stderr is not None
        program.stdin.write(data)
        program.stdin.flush()
        first = program.stderr.readline().decode()  # the pipe is still open
        assert first.startswith("warning set-point-gap: After slvMove 431 at 0.248 s, your client sent no")
        out, _ = program.communicate()
    assert out.decode().splitlines() == run_here("diagnose", LOST).lines
    assert program.returncode == ExitCode.FINDINGS


def test_json_of_a_pipe_has_new_findings_and_then_all() -> None:
    found = [json.loads(line) for line in run("diagnose", "-", "--json", stdin=LOST.read_bytes()).lines]
    final = [finding for finding in found if finding["final"]]
    new = found[: -len(final)]
    whole = [json.loads(line) for line in run_here("diagnose", LOST, "--json").lines]
    assert [finding["sentence"] for finding in final] == [finding["sentence"] for finding in whole]
    assert [finding["rule"] for finding in new][:2] == ["set-point-gap", "underflow"]
    assert all(finding["consequence_of"] is None for finding in new)


def test_a_file_as_standard_input_is_no_pipe() -> None:
    argv = [sys.executable, "-m", "bcapscope", "diagnose", "-", "--json"]
    with LOST.open("rb") as file:
        done = subprocess.run(argv, stdin=file, capture_output=True, check=True)
    assert all(json.loads(line)["final"] for line in done.stdout.splitlines())


@pytest.mark.skipif(sys.platform != "linux", reason="only Linux has a loopback interface named lo")
def test_live_findings_are_printed_as_they_are_made() -> None:
    pipe = subprocess.PIPE
    with (
        socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as server,
        socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as client,
    ):
        server.bind(("127.0.0.1", 0))
        client.connect(server.getsockname())
        argv = [sys.executable, "-m", "bcapscope", "diagnose", "-i", "lo", "--rule", "malformed-request"]
        argv += ["-p", str(server.getsockname()[1])]
        with subprocess.Popen(argv, stdout=pipe, stderr=pipe) as program:
            assert program.stderr is not None
            if b"capturing on lo" not in program.stderr.readline():
                pytest.skip("no right to capture here")
            broken = bytearray(request(1))
            broken[1] += 1
            seen, give_up = b"", time.monotonic() + 60
            while b"error malformed-request: " not in seen:
                assert time.monotonic() < give_up, seen
                client.send(bytes(broken))
                if select.select((program.stderr,), (), (), 0.2)[0]:
                    seen += os.read(program.stderr.fileno(), 65536)
            program.send_signal(signal.SIGINT)
            out, _ = program.communicate()
    assert program.returncode == ExitCode.OK
    assert b"error malformed-request" in out
