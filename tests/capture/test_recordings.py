"""Recordings of DENSO's own libraries, on ports that nobody told us, read to the last packet."""

from __future__ import annotations

import pytest

from bcapscope.capture.capture_file import open_capture
from bcapscope.capture.packet_decoder import PacketDecoder
from bcapscope.protocol.codec.frame import Frame
from bcapscope.traffic.observation import Direction, ServerEvidenceKind
from tests.shared_folder import SHARED

pytestmark = pytest.mark.interop

FOLDER = SHARED / "captures"


@pytest.mark.parametrize(
    ("name", "packets", "requests", "responses", "port"),
    [
        ("udp_clean.pcap", 4020, 2010, 2010, 15007),
        ("udp_loss.pcapng", 4493, 2483, 2010, 15008),
        ("tcp.pcapng", 4030, 2010, 2010, 15007),
    ],
)
def test_every_packet_of_a_recording_is_understood(
    name: str, packets: int, requests: int, responses: int, port: int
) -> None:
    path = FOLDER / name
    if not path.exists():
        pytest.skip(f"no recording {name} beside the project")
    observer = PacketDecoder()
    with open_capture(path) as capture:
        found = list(observer.decode(capture))
    assert observer.counts.packets == packets
    assert observer.counts.not_ip == observer.counts.not_bcap == observer.counts.broken == 0
    assert all(isinstance(each.item, Frame) and not each.item.problems for each in found)
    sides = [each.flow.direction for each in found]
    assert (sides.count(Direction.REQUEST), sides.count(Direction.RESPONSE)) == (requests, responses)
    (conversation,) = observer.conversations
    assert conversation.server.port == port
    assert conversation.server_evidence.kind is not ServerEvidenceKind.GUESS
