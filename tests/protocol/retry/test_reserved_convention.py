"""The conventions that clients have."""

from __future__ import annotations

from bcapscope.protocol.retry.reserved_convention import ReservedConvention, client_conventions


def test_each_convention_belongs_to_udp_or_to_tcp() -> None:
    udp, tcp = client_conventions(datagrams=True), client_conventions(datagrams=False)
    assert {*udp, *tcp} == set(ReservedConvention) - {ReservedConvention.UNKNOWN}
    assert tcp == (ReservedConvention.TCP0, ReservedConvention.TCP1)
