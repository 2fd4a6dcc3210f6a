"""What a proxy recorded, in the files that it goes to."""

from __future__ import annotations

import json
import struct
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from bcapscope.capture.capture_file import open_capture
from bcapscope.capture.packet import Packet
from bcapscope.capture.rotating_recording import RotatingRecording, RotationLimits
from bcapscope.live.proxy_recorder import ProxyRecorder
from bcapscope.live.recorder import Recorder
from bcapscope.proxy.ring_buffer import RingRecord, RingRecordKind
from tests.capture.test_rotating_recording import SmallDisk
from tests.english import collects, encoded

ENDS = (("127.0.0.1", 50001), ("127.0.0.1", 5008), ("127.0.0.1", 50002), ("127.0.0.1", 5007))
ROOM = 10_000
UDP = 17
TOLD: list[str] = []


_FIN, _RST = 1, 4
TELLING = _FIN | _RST


@pytest.mark.parametrize("kind", [RingRecordKind.END, RingRecordKind.RESET])
@pytest.mark.parametrize("up", [True, False])
@pytest.mark.parametrize("by_proxy", [True, False])
def test_the_ends_of_a_stream_are_those_of_who_sent_them(
    kind: RingRecordKind, up: bool, by_proxy: bool, tmp_path: Path
) -> None:
    why, flag = encoded("a rule") if by_proxy else b"", _FIN if kind is RingRecordKind.END else _RST
    recorder = ProxyRecorder(Recorder(tmp_path / "r.pcapng", collects(TOLD)))
    recorder.add_records(
        [RingRecord(RingRecordKind.CLIENT_OPENED, False, 1, 1, 0, json.dumps(["tcp", *ENDS]).encode(), b"")]
    )
    recorder.add_records([RingRecord(RingRecordKind.DATA, True, 1, 2, 3, b"x", b"")])
    if by_proxy:
        recorder.add_records([RingRecord(kind, side, 1, 0, 5, why, b"") for side in (up, not up)])
    else:
        recorder.add_records(
            [RingRecord(kind, up, 1, 4, 0, b"", b""), RingRecord(kind, up, 1, 0, 5, b"", b"")]
        )
    recorder.add_records([RingRecord(RingRecordKind.CLIENT_CLOSED, False, 1, 6, 0, b"", b"")])
    recorder.close()
    ended = []
    with open_capture(str(tmp_path / "r.pcapng")) as capture:
        for time, raw, _, _, comments in capture:
            if raw[33] & TELLING:
                source, target = (int.from_bytes(raw[at : at + 2], "big") for at in (20, 22))
                assert (raw[33] & TELLING, comments) == (flag, ("a rule",) if by_proxy else ())
                ended.append((time, source, target))
    client, listen, upstream, controller = (port for _, port in ENDS)
    if by_proxy:
        assert sorted(ended) == [(5, listen, client), (5, upstream, controller)]
    elif up:
        assert ended == [(4, client, listen), (5, upstream, controller)]
    else:
        assert ended == [(4, controller, upstream), (5, listen, client)]
    assert not TOLD


def test_a_client_that_goes_begins_no_file_of_a_ring(tmp_path: Path) -> None:
    recorder = ProxyRecorder(Recorder(tmp_path / "r.pcapng", collects(TOLD), RotationLimits(2, size=ROOM)))
    recorder.add_records(
        [RingRecord(RingRecordKind.CLIENT_OPENED, False, 1, 1, 0, json.dumps(["udp", *ENDS]).encode(), b"")]
    )
    for time in (1_000, 2_000):
        recorder.add_records(
            [RingRecord(RingRecordKind.DATA, True, 1, time, time + 1, bytes(ROOM // 2), b"")]
        )
    recorder.add_records([RingRecord(RingRecordKind.CLIENT_CLOSED, False, 1, 3_000, 0, b"", b"")])
    recorder.close()
    times = []
    for path in sorted(tmp_path.iterdir()):
        with open_capture(str(path)) as capture:
            times.append([packet[0] for packet in capture])
    assert times == [[1_000, 1_001], [2_000, 2_001]]
    assert not TOLD


def test_packets_stand_in_the_order_of_their_times_however_they_are_taken(tmp_path: Path) -> None:
    records = [
        RingRecord(RingRecordKind.CLIENT_OPENED, False, 1, 1, 0, json.dumps(["udp", *ENDS]).encode(), b"")
    ]
    records += [
        RingRecord(RingRecordKind.DATA, True, 1, time, time + 25, bytes(time % 300), b"")
        for time in range(10, 400, 10)
    ]
    for size in (1, 2, 7, 100):
        path = tmp_path / f"{size}.pcapng"
        recorder = ProxyRecorder(Recorder(path, collects(TOLD)))
        for start in range(0, len(records), size):
            recorder.add_records(records[start : start + size])
        recorder.close()
        with open_capture(str(path)) as capture:
            times = [packet[0] for packet in capture]
        assert times == sorted([*range(10, 400, 10), *range(35, 425, 10)])
    assert not TOLD


@pytest.mark.parametrize("up", [True, False])
def test_a_hole_in_a_stream_is_a_gap_on_both_legs(up: bool, tmp_path: Path) -> None:
    recorder = ProxyRecorder(Recorder(tmp_path / "r.pcapng", collects(TOLD)))
    recorder.add_records([opened(1, "tcp"), RingRecord(RingRecordKind.DATA, up, 1, 2, 3, b"x" * 10, b"")])
    recorder.add_records([RingRecord(RingRecordKind.HOLE, up, 1, 4, 5, struct.pack("=QQ", 700, 900), b"")])
    recorder.add_records([RingRecord(RingRecordKind.DATA, up, 1, 6, 7, b"y" * 10, b"")])
    recorder.close()
    gaps: dict[str, list[int]] = {}
    for _, raw, _, where, _ in packets_of(tmp_path / "r.pcapng"):
        if raw[40:]:
            gaps.setdefault(where.name, []).append(int.from_bytes(raw[24:28], "big"))
    near, far = (gaps[name] for name in ("clients of 127.0.0.1:5018", "controller 127.0.0.1:5017"))
    came, left = (near, far) if up else (far, near)
    assert (came[1] - came[0], left[1] - left[0]) == (710, 910)
    assert not TOLD


def packets_of(path: Path) -> list[Packet]:
    with open_capture(str(path)) as capture:
        return list(capture)


def opened(number: int, transport: str) -> RingRecord:
    ends = [(host, port + 10 * number) for host, port in ENDS]
    return RingRecord(
        RingRecordKind.CLIENT_OPENED, False, number, 1, 0, json.dumps([transport, *ends]).encode(), b""
    )


@st.composite
def passed(draw: st.DrawFn) -> list[RingRecord]:
    """What two clients of UDP and one of TCP say: most of it passes at once, some is held, lost or noted."""
    records: list[RingRecord] = []
    time = 10
    for _ in range(draw(st.integers(0, 30))):
        time += draw(st.integers(0, 9))
        number, up, size = draw(st.integers(1, 3)), draw(st.booleans()), draw(st.integers(0, 5))
        came = draw(st.sampled_from([time, time, time, 0]))
        left = draw(st.sampled_from([time + 1, time + 1, time + 30, 0]))
        note = draw(st.sampled_from(["", "", "", "a rule"]))
        records.append(
            RingRecord(
                RingRecordKind.DATA, up, number, came, left, bytes([len(records)] * size), encoded(note)
            )
        )
    return records


@given(records=passed(), pieces=st.integers(2, 9), is_ring=st.booleans())
def test_what_passes_one_after_another_is_written_as_everything_else_is(
    records: list[RingRecord], pieces: int, is_ring: bool, tmp_path_factory: pytest.TempPathFactory
) -> None:
    folder = tmp_path_factory.mktemp("r")
    everything = [opened(1, "udp"), opened(2, "udp"), opened(3, "tcp"), *records]
    found = []
    for size in (pieces, 1):  # one alone never passes before another
        path = folder / f"{size}.pcapng"
        recorder = ProxyRecorder(
            Recorder(path, collects(TOLD), RotationLimits(99, size=ROOM) if is_ring else None)
        )
        for start in range(0, len(everything), size):
            recorder.add_records(everything[start : start + size])
        recorder.close()
        written = [packet for each in sorted(folder.glob(f"{size}*")) for packet in packets_of(each)]
        # Numbers in a stream follow the order in which it is written, which is that of times as far as known.
        found.append(sorted(repr(packet if packet[1][9] == UDP else len(packet[1])) for packet in written))
    assert found[0] == found[1]
    assert not TOLD


def test_nothing_passes_before_what_is_told_later_and_came_earlier(tmp_path: Path) -> None:
    recorder = ProxyRecorder(Recorder(tmp_path / "r.pcapng", collects(TOLD)))
    recorder.add_records([opened(1, "udp"), opened(2, "udp")])
    times = [(1, 10, 11), (1, 12, 13), (2, 9, 14), (1, 15, 16)]
    recorder.add_records(
        [RingRecord(RingRecordKind.DATA, True, client, came, left, b"", b"") for client, came, left in times]
    )
    recorder.close()
    assert [packet[0] for packet in packets_of(tmp_path / "r.pcapng")] == list(range(9, 17))


def test_what_waits_is_not_written_before_what_is_told_later_and_came_earlier(tmp_path: Path) -> None:
    recorder = ProxyRecorder(Recorder(tmp_path / "r.pcapng", collects(TOLD)))
    recorder.add_records([opened(1, "udp"), opened(2, "udp")])
    recorder.add_records([RingRecord(RingRecordKind.DATA, True, 1, 30, 60, b"", b"")])
    times = [(1, 70, 80), (2, 50, 90), (1, 95, 96)]
    recorder.add_records(
        [RingRecord(RingRecordKind.DATA, True, client, came, left, b"", b"") for client, came, left in times]
    )
    recorder.close()
    assert [packet[0] for packet in packets_of(tmp_path / "r.pcapng")] == [30, 50, 60, 70, 80, 90, 95, 96]


def test_a_hole_is_told_of_a_client_that_is_gone_by_the_clock(tmp_path: Path) -> None:
    recorder = ProxyRecorder(Recorder(tmp_path / "r.pcapng", collects(TOLD)))
    recorder.add_records([opened(1, "tcp"), RingRecord(RingRecordKind.DATA, True, 1, 2, 3, b"x", b"")])
    hole = RingRecord(RingRecordKind.HOLE, True, 1, 20, 21, struct.pack("=QQ", 5, 5), b"")
    recorder.add_records([hole, RingRecord(RingRecordKind.CLIENT_CLOSED, False, 1, 10, 0, b"", b"")])
    recorder.close()
    assert len(packets_of(tmp_path / "r.pcapng")) == 8
    assert not TOLD


@pytest.mark.parametrize("last", ["hole", "stranger"])
def test_no_file_of_a_ring_is_begun_without_a_packet(last: str, tmp_path: Path) -> None:
    recorder = ProxyRecorder(Recorder(tmp_path / "r.pcapng", collects(TOLD), RotationLimits(2, size=ROOM)))
    transport = "tcp" if last == "hole" else "udp"
    recorder.add_records(
        [opened(1, transport), RingRecord(RingRecordKind.DATA, True, 1, 2, 3, bytes(ROOM), b"")]
    )
    if last == "hole":
        recorder.add_records([RingRecord(RingRecordKind.HOLE, True, 1, 4, 5, struct.pack("=QQ", 7, 7), b"")])
    else:
        recorder.add_records(
            [RingRecord(RingRecordKind.DATA, True, 9, time, time, b"x", b"") for time in (4, 5, 6)]
        )
    recorder.close()
    assert all(packets_of(path) for path in tmp_path.iterdir())


def test_each_file_of_a_ring_names_the_interfaces_of_what_passes(tmp_path: Path) -> None:
    recorder = ProxyRecorder(Recorder(tmp_path / "r.pcapng", collects(TOLD), RotationLimits(99, size=ROOM)))
    passing = [
        RingRecord(RingRecordKind.DATA, number % 2 == 0, 1, number, number, bytes(400), b"")
        for number in range(90)
    ]
    recorder.add_records([opened(1, "udp")])
    recorder.add_records(passing[1:])
    recorder.close()
    files = sorted(tmp_path.iterdir())
    assert len(files) > 3
    packets = [packet for path in files for packet in packets_of(path)]
    assert [packet[0] for packet in packets] == [number for number in range(1, 90) for _ in "12"]
    assert {packet[3].name for packet in packets} == {
        "clients of 127.0.0.1:5018",
        "controller 127.0.0.1:5017",
    }
    assert all(path.stat().st_size < ROOM + 2000 for path in files)


def test_a_disk_that_is_full_while_things_pass_is_told_once(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def full(self: RotatingRecording, data: bytes) -> bool:
        raise OSError(28, "No space left on device")

    told: list[str] = []
    recorder = ProxyRecorder(Recorder(tmp_path / "r.pcapng", collects(told)))
    recorder.add_records([opened(1, "udp")])
    recorder.flush()
    monkeypatch.setattr(RotatingRecording, "_try_write", full)
    passing = [RingRecord(RingRecordKind.DATA, True, 1, time, time, b"x", b"") for time in range(1, 20)]
    recorder.add_records(passing[:9])
    recorder.flush()
    recorder.add_records(passing[9:])
    assert not recorder.close()
    assert told == [f"recording to {tmp_path}/r.pcapng stopped: no space left on device"]


def test_a_ring_on_a_full_disk_goes_on_and_that_is_told_once(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    SmallDisk(tmp_path, 50_000, monkeypatch)
    told: list[str] = []
    recorder = ProxyRecorder(Recorder(tmp_path / "r.pcapng", collects(told), RotationLimits(10, size=ROOM)))
    recorder.add_records([opened(1, "udp")])
    for number in range(200):
        recorder.add_records(
            [RingRecord(RingRecordKind.DATA, True, 1, number + 1, number + 1, bytes(500), b"")]
        )
        recorder.flush()
    assert recorder.close()
    assert told == [
        f"the disk is full: the oldest files of the recording {tmp_path}/r.pcapng are removed early"
    ]
    packets = [packet for path in sorted(tmp_path.iterdir()) for packet in packets_of(path)]
    assert packets[-1][0] == 200


def test_what_is_flushed_can_be_read_before_the_end(tmp_path: Path) -> None:
    path = tmp_path / "r.pcapng"
    recorder = ProxyRecorder(Recorder(path, collects(TOLD)))
    recorder.add_records(
        [RingRecord(RingRecordKind.CLIENT_OPENED, False, 1, 1, 0, json.dumps(["udp", *ENDS]).encode(), b"")]
    )
    recorder.add_records([RingRecord(RingRecordKind.DATA, True, 1, 10, 20, b"x", b"")])
    recorder.flush()
    with open_capture(str(path)) as capture:
        assert [packet[0] for packet in capture] == [10, 20]
    recorder.close()


@given(records=passed(), pieces=st.integers(1, 9))
def test_each_record_knows_the_packet_on_the_clients_side(
    records: list[RingRecord], pieces: int, tmp_path_factory: pytest.TempPathFactory
) -> None:
    path = tmp_path_factory.mktemp("r") / "r.pcapng"
    recorder = ProxyRecorder(Recorder(path, collects(TOLD)), keeps_packet_numbers=True)
    everything = [opened(1, "udp"), opened(2, "udp"), opened(3, "tcp"), *records]
    for start in range(0, len(everything), pieces):
        recorder.add_records(everything[start : start + pieces])
    recorder.flush()
    numbers = [*recorder.next_packet_numbers(3), *recorder.next_packet_numbers(len(records))]
    recorder.close()
    packets = packets_of(path)
    for record, number in zip(everything, numbers, strict=True):
        time = record.received_at if record.up else record.sent_at
        if record.kind is RingRecordKind.DATA and time and record.data:
            packet = packets[number - 1]
            assert (packet[0], packet[3].name[:7], packet[1][-len(record.data) :]) == (
                time,
                "clients",
                record.data,
            )
        elif record.kind is RingRecordKind.CLIENT_OPENED or not time:
            assert not number
    assert not TOLD
