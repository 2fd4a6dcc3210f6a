"""A capture whose place decides between a reply that was lost and one that was late."""

from __future__ import annotations

from pathlib import Path

from tests.samples.calls import MS, START, Datagrams, i4, r8s, reply, request, text
from tests.samples.files import pcap


def late_retry(folder: Path) -> Path:
    """Write a capture of a set point with a reply 1 ms before the retry, and return its path."""
    network = Datagrams()
    pose = r8s(*[1.0] * 8)
    set_point = i4(1), text("slvMove"), pose
    network.up(START, request(1, 0, "Robot_Execute", *set_point))
    network.down(START + 7 * MS, reply(1, 0, pose))
    network.up(START + 8 * MS, request(2, 1, "Robot_Execute", *set_point))
    network.down(START + 9 * MS, reply(2, 0, pose))
    path = folder / "retry.pcap"
    path.write_bytes(pcap(network.packets))
    return path
