"""tshark with the dissector shows every frame as `bcapscope decode --json` does, field by field."""

from __future__ import annotations

import json
import random
from collections.abc import Sequence
from itertools import pairwise
from pathlib import Path

import pytest

from bcapscope.protocol.codec.frame import encode_frame
from bcapscope.protocol.codec.stream_splitter import StreamSplitter
from bcapscope.protocol.codec.variant import VT, Variant
from tests.cli.run import CAPTURES
from tests.shared_folder import SHARED
from tests.wireshark.compressed import compressed_frames
from tests.wireshark.corpus import corpus
from tests.wireshark.packets import tcp_packets, udp_packet, write_capture
from tests.wireshark.tshark import Record, decoded, dissected, needs_tshark

pytestmark = needs_tshark

_LONGEST_UDP = 60_000  # bytes

_OTHER_GAPS = "tcp-gap.pcap"
"""Wireshark marks missing bytes of a stream itself, and does not show an unfinished frame before them."""

_SHARED_CAPTURES = ("tcp.pcapng", "udp_clean.pcap", "udp_loss.pcapng")


def _assert_equal(shown: Sequence[Record], expected: Sequence[Record], but: Sequence[str] = ()) -> None:
    for each, wanted in zip(shown, expected, strict=True):
        fields = [name for name in wanted if name not in but]
        assert {name: each[name] for name in fields} == {name: wanted[name] for name in fields}


@pytest.mark.parametrize(
    "capture",
    sorted(path for path in CAPTURES.glob("*.pcap*") if path.name != _OTHER_GAPS),
    ids=lambda path: path.name,
)
def test_samples_agree(capture: Path, script: Path) -> None:
    shown = dissected(script, capture, "-o", "tcp.reassemble_out_of_order:TRUE")
    # Wireshark does not pass a datagram without bytes to any dissector.
    empty = {"problem": "there are no bytes, but a frame begins with 01"}
    expected = [
        each for each in decoded(capture) if [p["reason"] for p in each["problems"]] != [empty["problem"]]
    ]
    _assert_equal(shown, expected)


@pytest.mark.interop
@pytest.mark.parametrize("name", _SHARED_CAPTURES)
def test_recordings_of_the_vendors_libraries_agree(name: str, script: Path) -> None:
    capture = SHARED / "captures" / name
    if not capture.exists():
        pytest.skip(f"{capture} is missing: recordings of DENSO's libraries")
    _assert_equal(dissected(script, capture), decoded(capture))


@pytest.mark.interop
@pytest.mark.parametrize("transport", ["udp", "tcp"])
def test_vectors_agree(transport: str, script: Path, tmp_path: Path) -> None:
    path = SHARED / "vectors.json"
    if not path.exists():
        pytest.skip(f"{path} is missing: frames of DENSO's libraries")
    packets: list[bytes] = []
    for number, vector in enumerate(json.loads(path.read_text())):
        raw, is_request = bytes.fromhex(vector["hex"]), vector["direction"] == "request"
        packets += (
            [udp_packet(is_request, raw)]
            if transport == "udp"
            else tcp_packets(is_request, [raw], 20_000 + number)
        )
    capture = write_capture(tmp_path / "vectors.pcap", packets)
    expected = decoded(capture)
    assert len(expected) >= 280
    _assert_equal(dissected(script, capture), expected)


def _udp_agrees(frames: list[bytes], script: Path, capture: Path) -> None:
    packets = [udp_packet(index % 2 == 0, data) for index, data in enumerate(frames) if data]
    write_capture(capture, packets)
    _assert_equal(dissected(script, capture), decoded(capture))


def _tcp_agrees(frames: list[bytes], script: Path, capture: Path) -> None:
    """Each frame begins a connection of its own, followed by two sound frames, in segments of random size."""
    chance = random.Random(5007)
    sound = encode_frame(7, 0, 1)
    packets: list[bytes] = []
    connection_of: dict[int, int] = {}
    complete: list[int] = []
    for index, data in enumerate(frames):
        stream = data + sound + sound
        cuts = chance.sample(range(len(stream)), chance.randint(0, 3))
        if index % 2:  # half of the connections have a short segment after the first frame
            cuts += [len(data), len(data) + chance.randint(1, len(sound))]
        segments = [stream[start:stop] for start, stop in pairwise((0, *sorted(cuts), len(stream)))]
        made = tcp_packets(index % 2 == 0, segments, 10_000 + index)
        connection_of |= {len(packets) + each: index for each in range(1, len(made) + 1)}
        packets += made
        complete.append(len(StreamSplitter().feed(stream)))
    write_capture(capture, packets)
    shown: list[list[Record]] = [[] for _ in frames]
    expected: list[list[Record]] = [[] for _ in frames]
    for found, groups in ((dissected(script, capture), shown), (decoded(capture), expected)):
        for record in found:
            groups[connection_of[record["packet"]]].append(record)
    for index, each in enumerate(shown):
        # Wireshark shows the unfinished end of a stream as TCP segments. It shows garbage in the packet that
        # proves it, decode in the packet of its last byte.
        _assert_equal(each, expected[index][: complete[index]], but=("packet",))


_AGREES = {"udp": _udp_agrees, "tcp": _tcp_agrees}


@pytest.mark.parametrize("transport", _AGREES)
@pytest.mark.parametrize("count", [1500, pytest.param(10_000, marks=pytest.mark.deep)])
@pytest.mark.timeout(1800)
def test_generated_and_mutated_frames_agree(transport: str, count: int, script: Path, tmp_path: Path) -> None:
    frames = [data for data in corpus("sound_or_mutated_frames", count) if len(data) < _LONGEST_UDP]
    _AGREES[transport](frames, script, tmp_path / "frames.pcap")


@pytest.mark.parametrize("transport", _AGREES)
def test_streams_of_frames_and_garbage_agree(transport: str, script: Path, tmp_path: Path) -> None:
    pieces = [data for data in corpus("streams", 500) if data]
    _AGREES[transport](pieces, script, tmp_path / "streams.pcap")


@pytest.mark.parametrize("transport", _AGREES)
def test_compressed_frames_agree(transport: str, script: Path, tmp_path: Path) -> None:
    _AGREES[transport](list(compressed_frames(300)), script, tmp_path / "compressed.pcap")


@pytest.mark.parametrize("kept", [29, 43, 60])
def test_datagrams_that_the_capture_cut_agree(kept: int, script: Path, tmp_path: Path) -> None:
    frames = [data for data in corpus("frames", 100) if data]
    packets = [udp_packet(index % 2 == 0, data) for index, data in enumerate(frames)]
    capture = write_capture(tmp_path / "cut.pcap", packets, kept)
    _assert_equal(dissected(script, capture), decoded(capture))


def test_without_reassembly_unfinished_frames_are_shown_as_damaged(script: Path, tmp_path: Path) -> None:
    frame = encode_frame(7, 0, 1, [Variant(VT.BSTR, "a" * 50)])
    capture = write_capture(tmp_path / "a.pcap", tcp_packets(True, [frame[:40], frame[40:]], 40_000))
    (whole,) = dissected(script, capture)
    assert whole["problems"] == []
    first, rest = dissected(script, capture, "-o", "tcp.desegment_tcp_streams:FALSE")
    assert (first["function"], first["problems"][0]["code"]) == ("Service_Start", "length")
    assert rest["kind"] == "malformed"
