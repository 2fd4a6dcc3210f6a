"""What was said, for those who watch and for a capture."""

from __future__ import annotations

from pathlib import Path

import pytest

from bcapscope.capture.capture_file import open_capture
from bcapscope.player import frame_recorder
from bcapscope.player.frame_recorder import FrameRecorder, open_recording
from bcapscope.player.player_messages import FrameMessage
from bcapscope.protocol.codec.frame import encode_frame
from bcapscope.simulator.profile import PROFILES
from bcapscope.simulator.simulator import Simulator
from tests.capture.test_rotating_recording import SmallDisk
from tests.cli.run import run_here
from tests.player.simulated import SimulatedChannel

REQUEST, REPLY = encode_frame(7, 0, 2, ()), encode_frame(7, 0, 0, ())


def test_frames_are_told_outside_of_the_pace_and_the_last_ones_kept() -> None:
    told: list[FrameMessage] = []
    journal = FrameRecorder(told.append, None)
    journal.on_frame(True, REQUEST, 5)
    journal.is_pacing = True
    journal.on_frame(False, REPLY, 6)
    assert [(packet.sent, packet.raw) for packet in told] == [(True, REQUEST)]
    assert (journal.last_sent, journal.last_received) == (REQUEST, REPLY)


def test_all_of_it_becomes_a_capture(tmp_path: Path) -> None:
    path = tmp_path / "a.pcapng"
    with open_recording(str(path)) as recording:
        journal = FrameRecorder(lambda _: None, recording)
        journal.is_pacing = True
        journal.on_frame(True, REQUEST, 1_000_000)
        journal.on_frame(False, REPLY, 3_000_000)
        journal.save_capture(SimulatedChannel(Simulator(PROFILES["rc8"])))
    ran = run_here("decode", path)
    assert [line.split()[1:6] for line in ran.lines] == [
        ["0.000000", "127.0.0.1:50000", ">", "127.0.0.1:5007", "udp"],
        ["0.002000", "127.0.0.1:5007", ">", "127.0.0.1:50000", "udp"],
    ]


def test_a_capture_is_in_the_order_of_time_though_a_reply_was_read_after_the_next_request(
    tmp_path: Path,
) -> None:
    path = tmp_path / "a.pcapng"
    with open_recording(str(path)) as recording:
        journal = FrameRecorder(lambda _: None, recording)
        journal.is_pacing = True
        for sent, raw, time in ((True, REQUEST, 1), (True, encode_frame(8, 0, 2, ()), 9), (False, REPLY, 8)):
            journal.on_frame(sent, raw, time * 1_000_000)
        journal.save_capture(SimulatedChannel(Simulator(PROFILES["rc8"])))
    assert [line.split()[1] for line in run_here("decode", path).lines] == [
        "0.000000",
        "0.007000",
        "0.008000",
    ]


def test_a_recording_without_a_packet_is_deleted_and_none_is_written_over(tmp_path: Path) -> None:
    path = tmp_path / "a.pcapng"
    with open_recording(str(path)):
        assert path.exists()
    assert not path.exists()
    path.write_bytes(b"mine")
    with pytest.raises(FileExistsError), open_recording(str(path)):
        pass
    assert path.read_bytes() == b"mine"
    with open_recording(None) as recording:
        assert recording is None


def test_a_recording_on_a_full_disk_ends_with_a_whole_packet(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(frame_recorder, "_FRAMES_PER_WRITE", 10)
    SmallDisk(tmp_path, 5_000, monkeypatch)
    path = tmp_path / "a.pcapng"
    with open_recording(str(path)) as recording:
        journal = FrameRecorder(lambda _: None, recording)
        for number in range(100):
            journal.on_frame(True, REQUEST, number)
        with pytest.raises(OSError, match="No space left"):
            journal.save_capture(SimulatedChannel(Simulator(PROFILES["rc8"])))
    with open_capture(str(path)) as capture:
        assert len(list(capture)) == 60
