"""Links between frames agree with `bcapscope calls`, where both claim one."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest

from bcapscope.protocol.codec.frame import encode_frame
from bcapscope.protocol.codec.variant import VT, Variant
from bcapscope.protocol.tables.hresult import S_EXECUTING
from tests.bench.traffic import write as write_traffic
from tests.cli.run import CAPTURES, run
from tests.shared_folder import SHARED
from tests.wireshark.packets import tcp_packets, udp_packet, write_capture
from tests.wireshark.tshark import Record, dissected, needs_tshark, tshark

pytestmark = needs_tshark

_COMMENT = Variant(VT.BSTR, "a")


def _calls(capture: Path) -> list[dict[str, Any]]:
    return [json.loads(line) for line in run("calls", "--json", capture).lines]


def _packet_by_frame(capture: Path) -> dict[int, int]:
    return {each["frame"]: each["packet"] for each in map(json.loads, run("decode", "--json", capture).lines)}


def _check_links(shown: list[Record], capture: Path) -> tuple[int, int]:
    """Compare the links of all frames with the calls; return the number of compared replies and retries."""
    packet_of = _packet_by_frame(capture)
    by_packet = {each["packet"]: each for each in shown}
    replies = retries = 0
    for call in _calls(capture):
        requests = [packet_of[frame] for frame in call["requests"]]
        own = {*requests, *(packet_of[frame] for frame in (*call["duplicates"], *call["captured_again"]))}
        for frame in (*call["replies"], *call["late_replies"]):
            claimed = by_packet[packet_of[frame]]["response_to"]
            if claimed is not None:
                assert claimed in own
                assert by_packet[claimed]["serial"] == by_packet[packet_of[frame]]["serial"]
                replies += 1
        for packet in requests[1:]:
            claimed = by_packet[packet]["retry_of"]
            if claimed is not None:
                assert claimed == requests[0]
                retries += 1
        assert by_packet[requests[0]]["retry_of"] is None
    return replies, retries


@pytest.mark.parametrize(
    "name", ["retry-story.pcapng", "slave-session.pcapng", "slave-mode-lost.pcapng", "two-robots.pcapng"]
)
def test_links_of_samples_agree_with_calls(name: str, script: Path) -> None:
    replies, _ = _check_links(dissected(script, CAPTURES / name), CAPTURES / name)
    assert replies > 1


@pytest.mark.interop
@pytest.mark.parametrize("name", ["tcp.pcapng", "udp_loss.pcapng"])
def test_links_of_the_vendors_recordings_agree_with_calls(name: str, script: Path) -> None:
    capture = SHARED / "captures" / name
    if not capture.exists():
        pytest.skip(f"{capture} is missing: recordings of DENSO's libraries")
    replies, retries = _check_links(dissected(script, capture), capture)
    assert replies > 1900
    assert retries > 100 or name.startswith("tcp")


def test_links_of_long_traffic_agree_with_calls(script: Path, tmp_path: Path) -> None:
    capture = tmp_path / "traffic.pcap"
    truth = write_traffic(capture, 6_000)
    replies, retries = _check_links(dissected(script, capture), capture)
    assert retries == truth.retries
    assert replies == truth.calls - truth.unanswered + truth.late_replies


def _frame(serial: int, reserved: int = 0, code: int = 1) -> bytes:
    return encode_frame(serial, reserved, code, [_COMMENT] if code == 1 else [])


def test_a_request_is_linked_to_its_reply_and_not_to_the_notice(script: Path, tmp_path: Path) -> None:
    packets = [
        udp_packet(True, _frame(5)),
        udp_packet(False, _frame(5, code=S_EXECUTING)),
        udp_packet(False, _frame(5, code=0)),
    ]
    shown = dissected(script, write_capture(tmp_path / "a.pcap", packets), "-2")
    assert [each["response_in"] for each in shown] == [3, None, None]
    assert [each["response_to"] for each in shown] == [None, 1, 1]


def test_a_retry_of_a_retry_is_linked_to_the_first_attempt(script: Path, tmp_path: Path) -> None:
    packets = [udp_packet(True, _frame(*each)) for each in ((5, 0), (6, 5), (7, 6))]
    shown = dissected(script, write_capture(tmp_path / "a.pcap", packets))
    assert [each["retry_of"] for each in shown] == [None, 1, 1]


def test_a_request_with_other_arguments_is_no_retry(script: Path, tmp_path: Path) -> None:
    other = encode_frame(6, 5, 1, [Variant(VT.BSTR, "b")])
    packets = [udp_packet(True, _frame(5)), udp_packet(True, other)]
    shown = dissected(script, write_capture(tmp_path / "a.pcap", packets))
    assert [each["retry_of"] for each in shown] == [None, None]


def test_a_serial_that_tcp_reuses_is_answered_in_order(script: Path, tmp_path: Path) -> None:
    requests = tcp_packets(True, [_frame(5), _frame(5)], 40_000)
    replies = tcp_packets(False, [_frame(5, code=0), _frame(5, code=0)], 40_000)[2:]
    shown = dissected(script, write_capture(tmp_path / "a.pcap", [*requests, *replies]))
    assert [each["response_to"] for each in shown] == [None, None, 3, 4]


def test_the_reply_shows_the_time_since_its_request(script: Path) -> None:
    options = ("-T", "fields", "-e", "bcap.rtt", "-Y", "bcap.rtt")
    assert tshark(script, CAPTURES / "exchanges.pcap", *options).split() == ["0.001200000"] * 5
