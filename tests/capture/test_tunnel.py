"""Mirrored traffic: packets inside GRE, VXLAN and IP."""

from __future__ import annotations

import struct

import pytest
from hypothesis import given
from hypothesis import strategies as st
from scapy.contrib.erspan import ERSPAN_II, ERSPAN_III, ERSPAN_PlatformSpecific
from scapy.layers.inet import IP, UDP
from scapy.layers.inet6 import IPv6
from scapy.layers.l2 import GRE, Dot1Q, Ether
from scapy.layers.vxlan import VXLAN
from scapy.packet import Packet as Layers

from bcapscope.capture.capture_counts import CaptureCounts
from bcapscope.capture.link_layer import IPPacket
from bcapscope.capture.packet import Interface, Packet
from bcapscope.capture.packet_decoder import PacketDecoder
from bcapscope.capture.tunnel import DEEPEST_TUNNEL, packet_in_tunnel
from bcapscope.traffic.observation import Observation
from tests.capture.packets import ethernet, ipv4, reply, request, tcp, udp

ETHERNET = Interface(1)
PROBE = {"src": "10.9.0.1", "dst": "10.9.0.2"}


def mirrored(payload: bytes) -> Layers:
    """A frame of Ethernet between the client and the controller."""
    return Ether() / IP(src="10.0.0.2", dst="10.0.0.1") / UDP(sport=50001, dport=5007) / payload


def outer() -> Layers:
    return Ether() / IP(**PROBE)


def tunnels(payload: bytes) -> dict[str, Layers]:
    inner = mirrored(payload)
    return {
        "IP in IP": outer() / inner[IP],
        "IPv4 in IPv6": Ether() / IPv6(src="::1", dst="::2", nh=4) / inner[IP],
        "IPv6 in IPv4": Ether()
        / IP(**PROBE, proto=41)
        / IPv6(src="::a", dst="::b")
        / UDP(sport=50001, dport=5007)
        / payload,
        "GRE": outer() / GRE(proto=0x0800) / inner[IP],
        "GRE with all options": outer()
        / GRE(proto=0x0800, chksum_present=1, key_present=1, seqnum_present=1, key=7, sequence_number=9)
        / inner[IP],
        "GRE with Ethernet": outer() / GRE(proto=0x6558, key_present=1) / inner,
        "ERSPAN I": outer() / GRE(proto=0x88BE) / bytes(inner),
        "ERSPAN II": outer() / GRE(proto=0x88BE, seqnum_present=1) / ERSPAN_II() / inner,
        "ERSPAN III": outer() / GRE(proto=0x22EB, seqnum_present=1) / ERSPAN_III() / inner,
        "ERSPAN III with platform header": outer()
        / GRE(proto=0x22EB, seqnum_present=1)
        / ERSPAN_III(o=1)
        / ERSPAN_PlatformSpecific()
        / inner,
        "ERSPAN III without Ethernet": outer()
        / GRE(proto=0x22EB, seqnum_present=1)
        / ERSPAN_III(ft=2)
        / bytes(inner[IP]),
        "VXLAN": outer() / UDP(sport=40000, dport=4789) / VXLAN(vni=5) / inner,
        "VXLAN on the old port of Linux": outer()
        / UDP(sport=40000, dport=8472)
        / VXLAN(flags=8, vni=5)
        / inner,
        "VXLAN with a VLAN inside": outer()
        / UDP(sport=40000, dport=4789)
        / VXLAN(vni=5)
        / Ether()
        / Dot1Q(vlan=3)
        / inner[IP],
        "ERSPAN in VXLAN": outer()
        / UDP(sport=40000, dport=4789)
        / VXLAN(vni=5)
        / (outer() / GRE(proto=0x88BE, seqnum_present=1) / ERSPAN_II() / inner),
    }


def observe(*packets: bytes) -> tuple[list[Observation], PacketDecoder]:
    decoder = PacketDecoder()
    captured: list[Packet] = [(time, data, len(data), ETHERNET, ()) for time, data in enumerate(packets, 1)]
    return list(decoder.decode(captured)), decoder


@pytest.mark.parametrize("name", list(tunnels(b"")))
def test_the_frame_in_a_tunnel_is_read(name: str) -> None:
    (found,), decoder = observe(bytes(tunnels(request(7))[name]))
    assert found.item.raw == request(7)
    client, server = ("[::a]", "[::b]") if name == "IPv6 in IPv4" else ("10.0.0.2", "10.0.0.1")
    assert (found.flow.src_text, found.flow.dst_text) == (f"{client}:50001", f"{server}:5007")
    assert decoder.counts == CaptureCounts(packets=1, items=1)


def test_tcp_in_a_tunnel() -> None:
    stream = [tcp(request(1), seq=1), tcp(request(2), seq=1 + len(request(1)))]
    found, _ = observe(*(ethernet(ipv4(ipv4(each, protocol=6), protocol=4)) for each in stream))
    assert [each.item.raw for each in found] == [request(1), request(2)]


def test_fragments_of_the_tunnel_and_in_the_tunnel_are_joined() -> None:
    whole = udp(request(1))
    inner = [ipv4(whole[:16], part=0x2000), ipv4(whole[16:], part=2)]
    outside = ipv4(inner[1], protocol=4)[20:]
    packets = [
        ipv4(inner[0], protocol=4),
        ipv4(outside[:24], protocol=4, identification=9, part=0x2000),
        ipv4(outside[24:], protocol=4, identification=9, part=3),
    ]
    (found,), decoder = observe(*map(ethernet, packets))
    assert found.item.raw == request(1)
    assert decoder.counts.fragments_lost == 0


def test_a_tunnel_that_the_capture_cut() -> None:
    whole = bytes(tunnels(request(7))["ERSPAN II"])
    decoder = PacketDecoder()
    (found,) = decoder.decode([(1, whole[:-3], len(whole), ETHERNET, ())])
    assert "cut" in [problem.code for problem in found.item.problems]


def nested(depth: int) -> bytes:
    content, protocol = udp(request(7)), 17
    for _ in range(depth):
        content, protocol = ipv4(content, protocol=protocol), 4
    return ethernet(ipv4(content, protocol=protocol))


def test_tunnels_inside_each_other_are_read_to_a_limit() -> None:
    assert [each.item.raw for each in observe(nested(DEEPEST_TUNNEL))[0]] == [request(7)]
    for depth in (DEEPEST_TUNNEL + 1, 1000):
        found, decoder = observe(nested(depth))
        assert found == []
        assert decoder.counts == CaptureCounts(packets=1, not_bcap=1)


@pytest.mark.parametrize(
    "content",
    [
        bytes(Ether() / b"no IP"),
        b"",
        struct.pack(">HH", 0x4000, 0x0800) + ipv4(udp(request(1))),  # source routes
        struct.pack(">HH", 0x0001, 0x880B) + ipv4(udp(request(1))),  # PPTP
        struct.pack(">HH", 0, 0x0806) + ipv4(udp(request(1))),  # ARP
        struct.pack(">HH", 0xB000, 0x0800),
        struct.pack(">HH", 0x1000, 0x22EB),
    ],
)
def test_a_tunnel_without_ip_counts_as_other_traffic(content: bytes) -> None:
    found, decoder = observe(ethernet(ipv4(content, protocol=47)))
    assert found == []
    assert decoder.counts == CaptureCounts(packets=1, not_bcap=1)


def test_a_controller_on_the_port_of_vxlan_is_still_read() -> None:
    decoder = PacketDecoder({4789})
    packets = [ethernet(ipv4(udp(request(1), 50001, 4789))), ethernet(ipv4(udp(reply(1), 4789, 50001)))]
    captured: list[Packet] = [(time, data, len(data), ETHERNET, ()) for time, data in enumerate(packets, 1)]
    assert [each.item.raw for each in decoder.decode(captured)] == [request(1), reply(1)]


@given(st.sampled_from([4, 17, 41, 47]), st.binary(max_size=60), st.sampled_from([4789, 8472, 5007]))
def test_hostile_bytes_raise_nothing(protocol: int, content: bytes, port: int) -> None:
    packet_in_tunnel(IPPacket(protocol, bytes(8), content, 0, None))
    packet_in_tunnel(IPPacket(17, bytes(8), udp(content, 1, port), 0, None))


@given(st.sampled_from(list(tunnels(b""))), st.integers(0, 200), st.integers(0, 255))
def test_a_changed_byte_raises_nothing(name: str, position: int, value: int) -> None:
    data = bytearray(bytes(tunnels(request(7))[name]))
    data[position % len(data)] = value
    observe(bytes(data))
