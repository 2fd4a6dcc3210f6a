"""The scapy layer: what sniff(), rdpcap() and sr() users see."""

from __future__ import annotations

from itertools import pairwise
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st
from scapy.layers.inet import IP, TCP, UDP
from scapy.layers.l2 import Ether
from scapy.packet import Padding, Raw
from scapy.sendrecv import sniff
from scapy.sessions import TCPSession
from scapy.utils import rdpcap, wrpcap

from bcapscope.capture.layer import BCAP
from bcapscope.protocol.codec.frame import Frame, Framing, encode_frame
from bcapscope.protocol.codec.variant import EMPTY, VT, Variant
from tests.capture.packets import reply, request, service_start

HANDLE = Variant(VT.I4, 1)
CALL = encode_frame(5, 4, 64, [HANDLE, Variant(VT.BSTR, "slvMove"), Variant.array(VT.R8, (1.5, 2.5))])


def client(data: bytes, seq: int, flags: str = "PA") -> Ether:
    return (
        Ether()
        / IP(src="10.0.0.2", dst="10.0.0.1")
        / TCP(sport=50001, dport=5007, seq=seq, flags=flags)
        / data
    )


def test_dissects_into_fields() -> None:
    packet = BCAP(CALL)
    assert (packet.soh, packet.length, packet.serial, packet.reserved) == (1, len(CALL), 5, 4)
    assert (packet.function_id, packet.hresult, packet.argc, packet.eot) == (64, None, 3, 4)
    assert packet.args == tuple(argument.variant for argument in Frame(CALL).arguments)
    assert (packet.function_name, packet.command_name) == ("Robot_Execute", "slvMove")
    assert packet.frame == Frame(CALL)
    result = BCAP(reply(7, 0x83500121))
    assert (result.function_id, result.hresult, result.function_name, result.command_name) == (
        None,
        0x83500121,
        None,
        None,
    )


def test_builds_what_our_codec_builds() -> None:
    args = [HANDLE, Variant(VT.BSTR, "slvMove"), Variant.array(VT.R8, (1.5, 2.5))]
    assert bytes(BCAP(serial=5, reserved=4, function_id=64, args=args)) == CALL
    assert bytes(BCAP(serial=7, hresult=0x80000900)) == encode_frame(7, 0, 0x80000900)
    assert bytes(BCAP(args=[""])) == service_start()


def test_python_values_become_what_the_vendors_client_sends() -> None:
    packet = BCAP(function_id=17, args=[True, 1, 1.5, "x", b"\x01\x02", None])
    assert packet.args == (
        Variant(VT.BOOL, True),
        Variant(VT.I4, 1),
        Variant(VT.R8, 1.5),
        Variant(VT.BSTR, "x"),
        Variant.array(VT.UI1, b"\x01\x02"),
        EMPTY,
    )
    assert BCAP(args=HANDLE).args == (HANDLE,)
    with pytest.raises(ValueError, match="give a Variant"):
        BCAP(args=[object()])


@given(
    serial=st.integers(0, 65535),
    code=st.integers(0, 0xFFFFFFFF),
    args=st.lists(st.integers(-(2**31), 2**31 - 1) | st.text(max_size=20) | st.floats(allow_nan=False)),
    framing=st.sampled_from([Framing.PLAIN, Framing.SERIAL_LINE, Framing.VERSION_1]),
)
def test_what_is_dissected_is_built_again(
    serial: int, code: int, args: list[object], framing: Framing
) -> None:
    arguments = [argument.variant for argument in BCAP(bytes(BCAP(args=args))).frame.arguments]
    raw = encode_frame(serial, framing is Framing.VERSION_1, code, arguments, framing)
    packet = BCAP(raw + b"behind")
    assert packet[Padding].load == b"behind"
    packet = BCAP(raw)
    assert bytes(packet) == raw
    packet.clear_cache()
    assert bytes(packet) == raw


@given(st.binary(max_size=80) | st.binary(max_size=60).map(lambda data: CALL[:13] + data))
def test_any_bytes_are_built_as_they_came(data: bytes) -> None:
    packet = UDP(bytes(UDP(sport=50001, dport=5007, chksum=0) / Raw(data)))
    assert bytes(packet)[8:] == data
    packet.show(dump=True)
    packet.summary()


def test_a_changed_field_is_built_anew() -> None:
    packet = BCAP(CALL)
    packet.serial = 6
    packet.args = [*packet.args[:2], EMPTY]
    packet.length = packet.argc = None
    assert bytes(packet) == encode_frame(6, 4, 64, [HANDLE, Variant(VT.BSTR, "slvMove"), EMPTY])


def test_the_port_tells_calls_from_results() -> None:
    doubtful = encode_frame(1, 0, 1)
    asked = IP(bytes(IP() / UDP(sport=50001, dport=5007) / doubtful))
    answered = IP(bytes(IP() / UDP(sport=5007, dport=50001) / doubtful))
    assert asked[BCAP].function_id == 1
    assert answered[BCAP].hresult == 1
    assert BCAP(doubtful).function_id == 1
    assert BCAP(encode_frame(1, 0, 0x0F200501)).hresult == 0x0F200501


def test_what_is_no_frame_stays_raw() -> None:
    for data in (b"hello", b"\x01", CALL[:14]):
        assert BCAP not in IP(bytes(IP() / UDP(sport=50001, dport=5007) / data))
        assert IP(bytes(IP() / UDP(sport=50001, dport=5007) / data))[Raw].load == data


def test_answers() -> None:
    asked = IP(bytes(IP(src="1.1.1.1", dst="2.2.2.2") / UDP(sport=50001, dport=5007) / request(9)))

    def result(data: bytes) -> IP:
        return IP(bytes(IP(src="2.2.2.2", dst="1.1.1.1") / UDP(sport=5007, dport=50001) / data))

    assert result(reply(9)).answers(asked)
    assert result(reply(9)).hashret() == asked.hashret()
    assert result(reply(9, 0x83500121)).answers(asked)
    assert not result(reply(8)).answers(asked)
    assert not result(encode_frame(9, 0, 0x900)).answers(asked)
    assert not asked.answers(asked)
    assert not result(reply(9)).answers(result(reply(9)))
    assert not BCAP(reply(9)).answers(Raw(b""))


def test_summaries_cannot_harm_a_terminal() -> None:
    name = Variant(VT.BSTR, "\x1b[31m\u202e[/foo]\n")
    packet = BCAP(encode_frame(5, 0, 64, [HANDLE, name, EMPTY]))
    assert packet.mysummary() == "b-CAP Robot_Execute '\\x1b[31m\\u202e[/foo]\\n' serial 5"
    assert "\x1b" not in packet.show(dump=True)
    assert BCAP(reply(7)).mysummary() == "b-CAP S_OK serial 7"
    assert BCAP(request(7)).mysummary() == "b-CAP Controller_GetTag serial 7"


@pytest.mark.parametrize("data", [b"", b"\x01", b"\x01\x20", b"\x01\x20\x00", CALL[:4], CALL[:5], CALL[:-1]])
def test_reassembly_waits_for_the_whole_frame(data: bytes) -> None:
    metadata: dict[str, object] = {}
    assert BCAP.tcp_reassemble(data, metadata, {}) is None
    assert metadata == ({"tcp_min_len": len(CALL)} if len(data) >= 5 else {})


def test_reassembly_takes_one_frame_and_leaves_the_rest() -> None:
    packet = BCAP.tcp_reassemble(CALL + CALL[:3], {}, {})
    assert packet is not None
    assert packet.frame == Frame(CALL)
    assert packet[Padding].load == CALL[:3]


@pytest.mark.parametrize(
    ("data", "garbage", "rest"),
    [
        (b"garbage" + CALL, b"garbage", CALL),
        (b"garbage", b"garbage", None),
        (b"\x01\x00\x00\x00\x00" + CALL, b"\x01\x00\x00\x00\x00", CALL),
        (b"\x01\xff\xff\xff\xff", b"\x01\xff\xff\xff\xff", None),
    ],
)
def test_reassembly_gets_into_step(data: bytes, garbage: bytes, rest: bytes | None) -> None:
    packet = BCAP.tcp_reassemble(data, {}, {})
    assert packet is not None
    assert packet[Raw].load == garbage
    assert (packet[Padding].load if Padding in packet else None) == rest


def test_a_sniffed_session_is_put_together(tmp_path: Path) -> None:
    path = str(tmp_path / "session.pcap")
    stream = service_start() + CALL + CALL
    cuts = [0, 2, 20, len(service_start()) + 5, len(service_start()) + len(CALL), len(stream)]
    packets = [client(stream[a:b], 1000 + a) for a, b in pairwise(cuts)]
    answer = IP(src="10.0.0.1", dst="10.0.0.2") / TCP(sport=5007, dport=50001, seq=1, flags="PA") / reply(5)
    wrpcap(path, [*packets, Ether() / answer])
    found = [packet[BCAP] for packet in sniff(offline=path, session=TCPSession) if BCAP in packet]
    assert [packet.frame.raw for packet in found] == [service_start(), CALL, CALL, reply(5)]
    assert [packet.is_response for packet in found] == [False, False, False, True]


def test_glued_frames_in_one_segment_are_all_there(tmp_path: Path) -> None:
    path = str(tmp_path / "glued.pcap")
    wrpcap(path, [client(service_start() + CALL + request(3), 1)])
    (packet,) = sniff(offline=path, session=TCPSession)
    found = []
    layer = packet[BCAP]
    while isinstance(layer, BCAP):
        found.append(layer.copy())
        layer = layer.payload
    assert [each.serial for each in found] == [1, 5, 3]


def test_read_from_a_file(tmp_path: Path) -> None:
    path = str(tmp_path / "udp.pcap")
    wrpcap(path, [Ether() / IP() / UDP(sport=50001, dport=5007) / BCAP(args=[""])])
    assert rdpcap(path)[0][BCAP].function_name == "Service_Start"
