"""The targets hold for their seeds, for what the fuzzer found, and for a few mutations of both."""

from __future__ import annotations

import random

import pytest

from tests.capture.packets import CLIENT, ethernet, ipv4, pcap, reply, request, tcp, udp
from tests.fuzz.fuzz import mutated, target_of
from tests.fuzz.seeds import SEEDS


def _to_itself(content: bytes, protocol: int) -> bytes:
    return ethernet(ipv4(content, CLIENT, CLIENT, protocol=protocol))


FOUND = {
    # A value that is promised more than the frame holds took the bytes of the arguments behind it as well.
    "frame: a value beyond its argument": (
        "frame",
        "011a0000000000000000000000010006000000112000000059595959590004",
    ),
    # Source and destination the same, as in a "LAND" attack: one key for both directions.
    "capture: TCP to itself": (
        "capture",
        pcap(
            _to_itself(tcp(flags=2, sport=5007), 6),
            _to_itself(tcp(request(1), seq=1, ack=1, sport=5007), 6),
            _to_itself(tcp(reply(1), seq=31, ack=1, sport=5007), 6),
        ).hex(),
    ),
    "capture: UDP to itself": ("capture", pcap(*[_to_itself(udp(reply(1), 5007), 17)] * 3).hex()),
    "capture: UDP to itself, unknown ports": (
        "capture",
        pcap(*[_to_itself(udp(reply(1), 9, 9), 17)] * 70).hex(),
    ),
}


@pytest.mark.parametrize("name", FOUND)
def test_what_was_found_stays_mended(name: str) -> None:
    target, data = FOUND[name]
    target_of(target)(bytes.fromhex(data))


@pytest.mark.parametrize("name", SEEDS)
def test_seeds_and_their_mutations_hold(name: str) -> None:
    chance, target = random.Random(1), target_of(name)
    for seed in SEEDS[name]():
        target(seed)
        for _ in range(4):
            target(mutated(seed, chance))
