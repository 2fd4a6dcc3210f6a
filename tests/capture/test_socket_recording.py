"""What is recorded is read back as the traffic that it was."""

from __future__ import annotations

from io import BytesIO
from pathlib import Path

import pytest

from bcapscope.capture.capture_file import open_capture
from bcapscope.capture.packet import Interface
from bcapscope.capture.socket_recording import RAW_IP, SocketRecording
from bcapscope.protocol.codec.frame import encode_frame
from tests.cli.run import run

CLIENT, SERVER = ("10.0.0.2", 50001), ("10.0.0.1", 5007)
TIME = 1_700_000_000_123_456_789
REQUEST, REPLY = encode_frame(7, 0, 2), encode_frame(7, 0, 0)


@pytest.mark.parametrize("transport", ["udp", "tcp"])
@pytest.mark.parametrize("hosts", [("10.0.0.2", "10.0.0.1"), ("fd00::2", "fd00::1")])
def test_both_transports_over_both_versions(tmp_path: Path, transport: str, hosts: tuple[str, str]) -> None:
    client, server = (hosts[0], 50001), (hosts[1], 5007)
    file = BytesIO()
    recording = SocketRecording(file)
    write = recording.write_datagram if transport == "udp" else recording.write_segment
    for number in range(3):
        write(client, server, REQUEST, TIME + number)
        write(server, client, REPLY, TIME + number)
    path = tmp_path / "a.pcapng"
    path.write_bytes(file.getvalue())
    ran = run("decode", path, "--json")
    assert ran.code == 0, ran.err
    assert len(ran.lines) == 6
    assert '"time":1700000000.123456789' in ran.lines[0].replace(" ", "")
    assert all(f'"{transport}"' in line and '"problems":[]' in line.replace(" ", "") for line in ran.lines)


def test_a_long_segment_becomes_several(tmp_path: Path) -> None:
    file = BytesIO()
    SocketRecording(file).write_segment(CLIENT, SERVER, REQUEST * 5000, TIME)
    path = tmp_path / "a.pcapng"
    path.write_bytes(file.getvalue())
    ran = run("decode", path)
    assert ran.code == 0, ran.err
    assert len(ran.lines) == 5000


def test_a_connection_is_made_and_ended_on_an_interface_with_a_name(tmp_path: Path) -> None:
    file, where = BytesIO(), Interface(RAW_IP, "clients")
    recording = SocketRecording(file)
    client, server = ("10.0.0.2", 50001), ("10.0.0.1", 6000)
    for start in (0, 10**9):
        recording.write_handshake(client, server, TIME + start, interface=where)
        recording.write_segment(client, server, REQUEST, TIME + start + 1, interface=where, comment="a rule")
        recording.write_segment(server, client, REPLY, TIME + start + 2, interface=where)
        recording.write_stream_end(client, server, TIME + start + 3, interface=where)
        recording.write_stream_end(server, client, TIME + start + 4, interface=where, reset=True)
        recording.drop_connection(client, server)
    path = tmp_path / "a.pcapng"
    path.write_bytes(file.getvalue())
    with open_capture(str(path)) as capture:
        packets = list(capture)
    assert {packet[3].name for packet in packets} == {"clients"}
    assert [packet[1][33] for packet in packets[:7]] == [2, 18, 16, 24, 24, 17, 20]  # flags
    assert [packet[4] for packet in packets[3:5]] == [("a rule",), ()]
    ran = run("decode", path)
    assert (ran.code, len(ran.lines)) == (0, 4), ran.err
    assert ran.lines[0].endswith("# a rule")
    assert "!!" not in ran.out
