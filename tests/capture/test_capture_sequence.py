"""Reading several captures as one."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from bcapscope.capture import capture_sequence
from bcapscope.capture.capture_file import open_capture
from bcapscope.capture.capture_input import CaptureInput
from bcapscope.capture.capture_sequence import CaptureSequence, capture_names
from bcapscope.capture.packet import Interface, PacketOrigin
from bcapscope.capture.packet_decoder import PacketDecoder
from bcapscope.errors import CaptureError
from tests.capture.packets import from_client, pcap_header, pcap_record, request

Files = list[list[int]]
"""The times of the packets of each file, in s since the first packet of all."""


def sequence_of(folder: Path, files: Sequence[Sequence[int]]) -> tuple[CaptureSequence, list[CaptureError]]:
    paths, problems = [], []
    for number, times in enumerate(files):
        path = folder / f"{number}.pcap"
        records = (pcap_record(from_client(request(time % 65536)), 1_700_000_000 + time) for time in times)
        path.write_bytes(pcap_header() + b"".join(records))
        paths.append(str(path))
    return CaptureSequence(
        paths, capture_names(paths), open_capture, lambda path, error: problems.append(error)
    ), problems


@given(st.lists(st.lists(st.integers(0, 100), max_size=8).map(sorted), min_size=2, max_size=6))
def test_all_packets_come_in_the_order_of_time_with_their_origins(
    tmp_path_factory: pytest.TempPathFactory, files: Files
) -> None:
    sequence, problems = sequence_of(tmp_path_factory.mktemp("files"), files)
    packets = list(sequence)
    times = [time // 10**9 - 1_700_000_000 for time, *_ in packets]
    assert times == sorted(time for file in files for time in file)
    assert problems == []
    for number, time in enumerate(times, 1):
        origin = sequence.origin_of(number)
        assert origin is not None
        assert files[int(Path(origin.path).stem)][origin.packet - 1] == time
    assert sequence.position == sequence.size


def test_packets_out_of_order_in_one_file_stay_in_their_order(tmp_path: Path) -> None:
    sequence, _ = sequence_of(tmp_path, [[50, 52, 51], [1, 3, 2]])
    assert [time // 10**9 - 1_700_000_000 for time, *_ in sequence] == [1, 3, 2, 50, 52, 51]


def test_the_origin_is_unknown_beyond_the_limit(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(capture_sequence, "MAX_RUNS", 3)
    sequence, _ = sequence_of(tmp_path, [[0, 2, 4, 6], [1, 3, 5, 7]])
    assert len(list(sequence)) == 8
    assert sequence.origin_of(3) == PacketOrigin(str(tmp_path / "0.pcap"), "0.pcap", 2)
    assert [sequence.origin_of(number) for number in (0, *range(4, 9))] == [None] * 6


def test_a_frame_has_the_origin_of_the_packet_that_completed_it(tmp_path: Path) -> None:
    sequence, _ = sequence_of(tmp_path, [[10, 11], [1, 2]])
    other = tmp_path / "other.pcap"
    other.write_bytes(pcap_header() + pcap_record(b"no IP at all", 1_700_000_005))
    source = CaptureInput([*sequence.paths, str(other)], (), lambda path, error: None)
    assert len(list(source.observations())) == 4
    found = [source.origin_of_frame(frame) for frame in range(5)]
    assert [each and (each.name, each.packet) for each in found] == [
        None,
        ("1.pcap", 1),
        ("1.pcap", 2),
        ("0.pcap", 1),
        ("0.pcap", 2),
    ]


_PACKETS = {
    "frame": from_client(request(7)),
    "two frames": from_client(request(7) + request(8)),
    "no IP": b"no IP at all",
    "no frame": from_client(b"no frame at all, but to the port of b-CAP"),
}


@given(st.lists(st.sampled_from(sorted(_PACKETS)), max_size=30))
def test_the_decoder_notes_the_packet_of_every_frame(kinds: list[str]) -> None:
    packets = [
        (1_700_000_000 + number, _PACKETS[kind], len(_PACKETS[kind]), Interface(1), ())
        for number, kind in enumerate(kinds)
    ]
    decoder, runs = PacketDecoder(), capture_sequence.RunTable()
    decoder.note_packet = lambda frame, packet: runs.add(frame, 0, packet)
    for observation in decoder.decode(packets):
        assert runs.find(observation.number) == (0, observation.packet)
