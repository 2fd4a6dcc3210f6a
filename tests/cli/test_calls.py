"""``bcapscope calls`` and ``bcapscope fields`` from the outside."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from bcapscope.cli.common.exit_codes import ExitCode
from bcapscope.traffic.filter.field_table import FIELDS
from tests.capture import packets
from tests.cli.late_retry import late_retry
from tests.cli.run import CAPTURES, run, run_here
from tests.samples.calls import MS, START, Datagrams, reply, request
from tests.samples.files import pcap

RETRIES = CAPTURES / "retry-story.pcapng"
ALL = sorted([*CAPTURES.glob("*.pcap"), *CAPTURES.glob("*.pcapng")])


def test_the_retry_story_is_one_call() -> None:
    (line,) = run_here("calls", RETRIES, "--json").lines
    assert json.loads(line) == {
        "call": 1,
        "function": "Robot_Execute",
        "function_id": 64,
        "command": "slvMove",
        "transport": "udp",
        "client": "192.168.0.10:50001",
        "server": "192.168.0.1:5007",
        "object": None,
        "started": 1700000000.0,
        "requests": [1, 2, 3, 4],
        "serials": [1232, 1233, 1234, 1235],
        "retries": 3,
        "unseen_retries": 0,
        "replies": [6],
        "late_replies": [5],
        "lost_replies": [],
        "executing": 0,
        "duplicates": [],
        "outcome": "answered",
        "hresult": 0,
        "hresult_name": "S_OK",
        "hresult_text": "done",
        "latency_ms": 7.24,
        "rtt_ms": 1.2,
        "convention": "seed",
        "verdict": "reply late",
        "captured_again": [],
        "places": [],
        "packets": [{"frame": frame, "file": str(RETRIES), "packet": frame} for frame in range(1, 7)],
    }


def copies_in(call: dict[str, Any]) -> list[int]:
    return [*call["duplicates"], *call["captured_again"]]


@pytest.mark.parametrize(
    ("options", "verdict"), [([], "cannot tell"), (["--taken-at", "client"], "reply lost")]
)
def test_the_place_of_the_capture_decides_whether_a_reply_was_lost(
    tmp_path: Path, options: list[str], verdict: str
) -> None:
    path = late_retry(tmp_path)
    (line,) = run_here("calls", path, "--json", *options).lines
    assert json.loads(line)["verdict"] == verdict
    rules = [json.loads(line)["rule"] for line in run_here("diagnose", path, "--json", *options).lines]
    assert ("reply-lost" in rules) is (verdict == "reply lost")


@pytest.mark.parametrize("path", ALL, ids=lambda path: path.name)
def test_every_sound_request_is_in_one_call(path: Path) -> None:
    frames = [json.loads(line) for line in run_here("decode", path, "--json").lines]
    calls = [json.loads(line) for line in run_here("calls", path, "--json").lines]
    asked = sorted(frame["frame"] for frame in frames if frame["kind"] == "request")
    kept = [number for call in calls for number in call["requests"] + copies_in(call)]
    replies = {frame["frame"] for frame in frames if frame["kind"] == "response"}
    assert sorted(number for number in kept if number not in replies) == asked


@pytest.mark.parametrize("style", [[], ["--tree"]])
def test_lines_and_trees(style: list[str], golden: Callable[[str, bytes], None]) -> None:
    out = "".join(
        run_here("calls", CAPTURES / name, *style).out for name in ("retry-story.pcapng", "tcp-gap.pcap")
    )
    golden(f"calls{''.join(style)}.txt", out.encode())


def test_a_filter() -> None:
    path = CAPTURES / "slave-mode-lost.pcapng"
    out = run_here("calls", path, "--json", "-f", "outcome == refused and command == slvMove").lines
    assert json.loads(out[0])["hresult_name"] == "0x84201482"
    assert run_here("calls", path, "-f", "latency > 1h").code == ExitCode.USAGE


def test_tree_and_json_exclude_each_other() -> None:
    assert run_here("calls", RETRIES, "--json", "--tree").code == ExitCode.USAGE


def test_fields_are_listed_with_their_meaning() -> None:
    out = run_here("fields").out
    for field in FIELDS:
        assert field.name in out
        assert field.meaning in out
    assert "contains" in out


@pytest.mark.parametrize("flag", ["-f", "--filter"])
def test_a_filter_goes_with_every_form(flag: str) -> None:
    path = CAPTURES / "slave-session.pcapng"
    expression = "command == slvChangeMode and arg[2] == 0"
    (line,) = run_here("calls", path, flag, expression).lines
    head, *tree = run_here("calls", path, "--tree", flag, expression).lines
    (record,) = map(json.loads, run_here("calls", path, "--json", flag, expression).lines)
    assert line == head
    assert [row.split()[1] for row in tree] == ["request", "reply"]
    assert line.startswith(f"{record['call']:>6} ")
    assert f"frames {record['requests'][0]} > {record['replies'][0]}" in line


def test_a_filter_leaves_out_what_belongs_to_no_call() -> None:
    traffic = Datagrams()
    traffic.down(START, reply(8, 0))
    traffic.up(START + MS, request(9, 0, "Service_Stop"))
    capture = pcap(traffic.packets)
    stray, call = run("calls", "-", stdin=capture).lines
    assert "reply with serial 8 answers no request that was seen" in stray
    done = run("calls", "-", "-f", "call > 0", stdin=capture)
    assert done.lines == [call]
    assert "1 reply to no open call; first: frame 1" in done.err
    assert len(run("calls", "-", "--json", stdin=capture).lines) == 1


def test_a_bad_filter_is_shown_where_it_is_bad() -> None:
    done = run_here("calls", RETRIES, "-f", "latency > 5 and comand == slvMove")
    assert (done.code, done.out) == (ExitCode.USAGE, "")
    assert "^" in done.err


def test_sessions_that_were_not_ended_are_told() -> None:
    err = run_here("calls", CAPTURES / "vlan-ipv6.pcap").err
    assert "no Service_Stop seen; not released: Controller 1, Variable IO128, Variable S1" in err
    assert "Service_Stop" not in run_here("calls", CAPTURES / "slave-session.pcapng").err


def test_an_unknown_function_id_is_signed(tmp_path: Path) -> None:
    odd = tmp_path / "odd.pcap"
    exchange = packets.from_client(packets.request(1, -5)), packets.from_server(packets.reply(1))
    odd.write_bytes(packets.pcap(*exchange))
    call = json.loads(run_here("calls", odd, "--json").lines[0])
    assert (call["function_id"], call["function"]) == (-5, "Unknown(-5)")
    frames = [json.loads(line) for line in run_here("decode", odd, "--json").lines]
    assert [frame["function_id"] for frame in frames] == [-5, -5]
    assert " Unknown(-5)" in run_here("decode", odd).lines[0]
    assert "Unknown(-5)" in run_here("decode", odd, "--tree").out
    assert "4294967291" not in run_here("decode", odd, "--tree", "--full").out
    assert "Unknown(-5)" in run_here("stats", odd).out
    assert ",-5,Unknown(-5)," in run_here("decode", odd, "--csv").out
    assert len(run_here("decode", odd, "-f", "function_id == -5").lines) == 2
