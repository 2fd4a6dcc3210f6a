"""Captures of one conversation from two places, on the command line."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest

from bcapscope.cli.common.exit_codes import ExitCode
from tests.cli.run import run_here
from tests.samples.calls import CLIENT, MS, SERVER, START
from tests.samples.files import pcap
from tests.samples.legs import PROXY_NEAR, TwoPlaces, both_ends, both_legs

SECOND = 1000 * MS
LOST = {3: "request", 5: "reply", 9: "request"}


def json_lines(*words: object) -> list[dict[str, Any]]:
    return [json.loads(line) for line in run_here(*map(str, words), "--json").lines]


def two_files(folder: Path, places: TwoPlaces, clock: int = 0, drift: float = 0.0) -> list[Path]:
    paths = [folder / "client.pcap", folder / "controller.pcap"]
    for path, data in zip(paths, places.captures(clock, drift), strict=True):
        path.write_bytes(data)
    return paths


def recording(folder: Path, note: str = "drop: dropped") -> Path:
    legs = both_legs(note)
    legs.lost = dict(LOST)
    path = folder / "legs.pcapng"
    path.write_bytes(legs.poll(20).recording())
    return path


def verdicts(calls: list[dict[str, Any]]) -> dict[int, str]:
    return {call["call"] - 1: call["verdict"] for call in calls if call["retries"]}


EXPECTED = {3: "request lost", 5: "reply lost", 9: "request lost"}


@pytest.mark.parametrize("clock", [0, -700 * MS, 90 * SECOND])
def test_two_ends_give_each_call_once_with_its_verdict(tmp_path: Path, clock: int) -> None:
    places = both_ends()
    places.lost = dict(LOST)
    near, far = two_files(tmp_path, places.poll(200), clock, 30e-6)
    for paths in ((near, far), (far, near)):
        calls = json_lines("calls", *paths)
        assert len(calls) == 200
        assert verdicts(calls) == EXPECTED
        assert calls[0]["started"] == START / 1e9
        delays = [seen for call in calls for seen in call["places"] if seen["delay_ms"] is not None]
        assert all(abs(seen["delay_ms"] - 0.3) <= seen["delay_error_ms"] + 0.001 for seen in delays)
        assert all(seen["delay_error_ms"] <= 0.301 for seen in delays)


def test_what_one_capture_did_not_cover_is_not_lost(tmp_path: Path) -> None:
    places = both_ends()
    places.lost = {3: "reply", 100: "request", 196: "request"}
    places.poll(200)
    places.far.packets = [
        packet for packet in places.far.packets if START + 2 * SECOND < packet.time < START + 9 * SECOND
    ]
    calls = json_lines("calls", *two_files(tmp_path, places))
    assert len(calls) == 200
    assert verdicts(calls) == {3: "cannot tell", 100: "request lost", 196: "cannot tell"}
    assert {call["outcome"] for call in calls} == {"answered"}


@pytest.mark.parametrize("later", [0.1, 5])
def test_the_client_is_named_although_the_capture_at_its_side_begins_later(
    tmp_path: Path, later: float
) -> None:
    places = both_legs()
    places.poll(200)
    places.near.packets = [packet for packet in places.near.packets if packet.time > START + later * SECOND]
    near, far = two_files(tmp_path, places)
    for paths in ((near, far), (far, near)):
        calls = json_lines("calls", *paths)
        assert len(calls) == 200
        assert {call["client"] for call in calls} == {f"{CLIENT.ip}:{CLIENT.port}"}
        assert {call["server"] for call in calls} == {f"{PROXY_NEAR.ip}:{PROXY_NEAR.port}"}
        assert {call["outcome"] for call in calls} == {"answered"}
        at_controller = json_lines("calls", *paths, "--filter", f"server == {SERVER.ip}")
        assert len(at_controller) == 200


def test_the_same_file_twice_is_one_capture(tmp_path: Path) -> None:
    near, _ = two_files(tmp_path, both_ends().poll(30))
    copy = tmp_path / "copy.pcap"
    copy.write_bytes(near.read_bytes())
    calls = json_lines("calls", near, copy)
    assert len(calls) == 30
    assert not any(call["retries"] or call["duplicates"] for call in calls)


def test_decode_shows_the_frames_of_both_ends_in_order(tmp_path: Path) -> None:
    paths = two_files(tmp_path, both_ends().poll(30), 90 * SECOND)
    frames = json_lines("decode", *paths)
    times = [frame["time"] for frame in frames]
    assert times == sorted(times)
    assert [frame["frame"] for frame in frames] == list(range(1, 121))
    assert sorted(frame["packet"] for frame in frames) == list(range(1, 121))
    near = json_lines("decode", *paths, "--side", "client")
    assert [frame["packet"] for frame in near] == list(range(1, 61))


def test_the_summary_says_how_the_clocks_differ(tmp_path: Path) -> None:
    paths = two_files(tmp_path, both_ends().poll(30), 250 * MS)
    said = run_here("calls", *paths).err
    assert "client.pcap (the client's side) and controller.pcap (the controller's side) contain" in said
    assert "differs by +250.000 ms (± 0.300 ms" in said
    assert "120 frames in 120 packets" in said


def test_a_damaged_file_is_reported_once(tmp_path: Path) -> None:
    paths = two_files(tmp_path, both_ends().poll(30))
    paths[1].write_bytes(paths[1].read_bytes()[:-10])
    done = run_here("calls", *paths)
    assert done.code == ExitCode.DAMAGED
    assert done.err.count("controller.pcap: ") == 1
    assert len(done.lines) == 30


def test_further_files_are_read_beside_the_pair(tmp_path: Path) -> None:
    paths = two_files(tmp_path, both_ends().poll(30))
    later = tmp_path / "later.pcap"
    later.write_bytes(pcap(both_ends().poll(10, START + 100 * SECOND, 60 * MS).near.packets))
    assert len(json_lines("calls", *paths, later)) == 40


@pytest.mark.parametrize("command", ["stats", "diagnose", "slave"])
def test_every_command_counts_one_client(tmp_path: Path, command: str) -> None:
    path = recording(tmp_path)
    both, near = run_here(command, path), run_here(command, path, "--side", "client")
    assert both.code == near.code == ExitCode.OK
    if command == "stats":
        (figures,) = json_lines("stats", path)
        (alone,) = json_lines("stats", path, "--side", "client")
        assert figures["total"]["calls"] == alone["total"]["calls"] == 20
        assert len(figures["clients"]) == 1
    if command == "diagnose":
        assert "20 calls, 1 client" in both.out
        said = " ".join(both.out.split())
        assert "cable" not in said.replace("Network, cable and controller are not the cause", "")
        assert "the proxy applied its rule drop to" in said


def test_a_call_says_which_rule_of_the_proxy_dropped_its_frames(tmp_path: Path) -> None:
    lines = run_here("calls", recording(tmp_path)).lines
    assert "1 retry, request lost, lost in the proxy, drop: dropped" in lines[3]
    assert "1 retry, reply lost, lost in the proxy, drop: dropped" in lines[5]
    tree = run_here("calls", "--tree", recording(tmp_path)).lines
    assert any("proxy 0.200 ms" in line for line in tree)


def test_a_recording_without_comments_says_that_the_proxy_lost_them(tmp_path: Path) -> None:
    path = recording(tmp_path, note="")
    assert "request lost, lost in the proxy" in run_here("calls", path).lines[3]
    found = " ".join(run_here("diagnose", path).out.split())
    assert "The proxy received 1 frame of this call that it did not forward" in found
    assert "Check cable" not in found


def test_a_comment_on_the_wire_is_escaped(tmp_path: Path) -> None:
    done = run_here("calls", recording(tmp_path, note="drop: \x1b[31mdropped"))
    assert "\x1b[31m" not in done.out
    assert "\x1b[31m" not in run_here("diagnose", recording(tmp_path, note="\x1b[31mbad")).out


def test_a_delay_in_the_proxy_is_shown(tmp_path: Path) -> None:
    legs = both_legs("")
    legs.poll(20)
    legs.far.packets = [packet._replace(time=packet.time + 5 * MS) for packet in legs.far.packets]
    near = legs.near.packets
    legs.near.packets = [
        packet._replace(time=packet.time + (10 * MS if index % 2 else 0)) for index, packet in enumerate(near)
    ]
    path = tmp_path / "slow.pcapng"
    path.write_bytes(legs.recording())
    lines = run_here("calls", path).lines
    assert len(lines) == 20
    assert "held by the proxy for 5.200 ms" in lines[10]


def test_stats_shows_the_one_way_delays(tmp_path: Path) -> None:
    places = both_ends()
    places.lost = dict(LOST)
    paths = two_files(tmp_path, places.poll(100), 90 * SECOND)
    (figures,) = json_lines("stats", *paths)
    (found,) = figures["places"]
    assert (found["requests"]["lost"], found["replies"]["lost"]) == (2, 1)
    assert (found["requests"]["frames"], found["replies"]["frames"]) == (101, 100)
    assert found["requests"]["delay_ms"]["p50"] == pytest.approx(0.3, abs=found["delay_error_ms"] + 0.01)
    assert found["proxy"] is False
    text = run_here("stats", *paths).out
    assert "between the two places" in text
    assert "192.168.0.10:50001 > 192.168.0.1:5007 udp request" in text


def test_the_rings_of_both_ends_are_one_conversation(tmp_path: Path) -> None:
    places = both_ends()
    places.lost = {30: "request", 75: "reply"}
    places.poll(120)
    near, far = places.near.packets, places.far.packets
    files = {
        "near-1": near[:100],
        "near-2": near[100:],
        "far-1": far[:130],
        "far-2": far[130:],
    }
    paths = [tmp_path / f"{name}.pcap" for name in files]
    for path, packets in zip(paths, files.values(), strict=True):
        path.write_bytes(pcap(packets, nanoseconds=True))
    calls = json_lines("calls", *paths)
    assert len(calls) == 120
    assert verdicts(calls) == {30: "request lost", 75: "reply lost"}
    (figures,) = json_lines("stats", *paths)
    assert len(figures["clients"]) == 1


def test_files_of_one_place_stay_in_order_although_their_clock_estimates_differ(tmp_path: Path) -> None:
    """Slow replies shift the first estimate by 2 ms, and the second files begin with a reply."""
    places = both_ends().poll(200)
    near, far = places.near.packets, places.far.packets
    near[1:200:2] = [packet._replace(time=packet.time + 4 * MS) for packet in near[1:200:2]]
    files = {"near-1": near[:201], "near-2": near[201:], "far-1": far[:201], "far-2": far[201:]}
    paths = [tmp_path / f"{name}.pcap" for name in files]
    for path, packets in zip(paths, files.values(), strict=True):
        path.write_bytes(pcap(packets, nanoseconds=True))
    calls = json_lines("calls", *paths)
    assert len(calls) == 200
    seen = [each["controller_side"] for call in calls for each in call["places"]]
    assert len(seen) == 400
    assert seen == sorted(seen)
