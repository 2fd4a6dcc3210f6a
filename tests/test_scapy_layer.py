"""The scapy layer: what sniff(), rdpcap() and sr() users see."""

from __future__ import annotations

import pickle
import socket
from collections.abc import Callable
from importlib import import_module
from itertools import pairwise
from pathlib import Path

import pytest
from hypothesis import assume, given
from hypothesis import strategies as st
from scapy.fields import RawVal
from scapy.layers.inet import IP, TCP, UDP
from scapy.layers.l2 import Ether
from scapy.packet import Packet, Padding, Raw, fuzz
from scapy.sendrecv import sniff
from scapy.sessions import TCPSession
from scapy.supersocket import StreamSocket
from scapy.utils import rdpcap, wrpcap

import bcapscope
from bcapscope.errors import BcapError, InputError, LocalProtocolError
from bcapscope.protocol.codec.frame import HEADER_SIZE, Frame, Framing, encode_frame
from bcapscope.protocol.codec.stream_splitter import StreamSplitter
from bcapscope.protocol.codec.variant import EMPTY, VT, Variant
from bcapscope.protocol.variant_values import variant_of
from bcapscope.scapy_layer import BCAP
from tests.capture.packets import reply, request, service_start
from tests.frames import FRAME_IDS, FRAMES, FramePair
from tests.strategies import frames, mutated_frames, streams

CAPTURES = Path(__file__).parent.parent / "captures"
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
    assert (packet.function, packet.hresult, packet.argc, packet.eot) == ("Robot_Execute", None, 3, 4)
    assert packet.args == tuple(argument.variant for argument in Frame(CALL).arguments)
    assert (packet.function_id, packet.command_name, packet.is_response) == (64, "slvMove", False)
    assert packet.frame == Frame(CALL)
    result = BCAP(reply(7, 0x83500121))
    assert (result.function, result.function_id, result.command_name) == (None, None, None)
    assert (result.hresult, result.is_response) == (0x83500121, True)


def test_builds_what_the_codec_builds() -> None:
    args = [HANDLE, Variant(VT.BSTR, "slvMove"), Variant.array(VT.R8, (1.5, 2.5))]
    assert bytes(BCAP(serial=5, reserved=4, function=64, args=args)) == CALL
    assert bytes(BCAP(serial=5, reserved=4, function="Robot_Execute", args=args)) == CALL
    assert bytes(BCAP(serial=7, hresult="E_HANDLE")) == bytes(BCAP(serial=7, hresult=-0x7FF8FFFA))
    assert bytes(BCAP(serial=7, hresult=0x80000900)) == encode_frame(7, 0, 0x80000900)
    assert bytes(BCAP(args=[""])) == service_start()


def test_python_values_get_their_types() -> None:
    packet = BCAP(function=200, args=[True, 1, 1.5, "x", b"\x01\x02", None])
    assert packet.args == (
        Variant(VT.BOOL, True),
        Variant(VT.I4, 1),
        Variant(VT.R8, 1.5),
        Variant(VT.BSTR, "x"),
        Variant.array(VT.UI1, b"\x01\x02"),
        EMPTY,
    )
    assert BCAP(args=HANDLE).args == (HANDLE,)
    with pytest.raises(LocalProtocolError, match="object"):
        BCAP(args=[object()])


@pytest.mark.parametrize(
    ("function", "values"),
    [
        ("Robot_Speed", [2, -1, 50]),
        ("Robot_Execute", [2, "slvMove", [1.5, 2]]),
        ("Service_Start", [""]),
        ("Variable_PutValue", [3, True]),
    ],
)
def test_arguments_get_the_types_of_the_function_as_in_encode(function: str, values: list[object]) -> None:
    expected = bcapscope.encode(function, values, serial=9)
    assert bytes(BCAP(args=values, function=function, serial=9)) == expected
    assert BCAP(args=values, function=function).args == bcapscope.decode(expected).variants


def test_a_request_may_have_too_few_and_too_many_arguments() -> None:
    assert BCAP(function="Robot_Speed", args=[2]).args == (Variant(VT.I4, 2),)
    assert BCAP(function="Controller_GetTag", args=[2, 1.5]).args == (Variant(VT.I4, 2), Variant(VT.R8, 1.5))


@pytest.mark.parametrize(
    ("build", "error", "reason"),
    [
        (
            lambda: BCAP(function="Robot_Execut"),
            InputError,
            "named 'Robot_Execut', did you mean 'Robot_Execute'",
        ),
        (
            lambda: BCAP(hresult="E_HANDL"),
            InputError,
            "no HRESULT is named 'E_HANDL', did you mean 'E_HANDLE'",
        ),
        (lambda: bytes(BCAP(function="Robot_Speed", args=[2, -1, "fast"])), LocalProtocolError, "fSpeed"),
        (lambda: bytes(BCAP(args=[Variant(VT.I2, 70000)])), LocalProtocolError, "cannot be packed"),
        (lambda: bytes(BCAP(serial=70000)), LocalProtocolError, "serial"),
        (lambda: bytes(IP() / UDP() / BCAP(function=2**32)), LocalProtocolError, "function"),
    ],
)
def test_errors_are_those_of_bcapscope(
    build: Callable[[], object], error: type[BcapError], reason: str
) -> None:
    with pytest.raises(error, match=reason):
        build()


@pytest.mark.parametrize(
    ("function", "values", "shown"),
    [
        ("Robot_Speed", [2, -1, "fast"], "fSpeed: VT_BSTR 'fast'"),
        ("Robot_Execute", [2, 5, None], "bstrCommand: VT_I4 5"),
        ("Service_Start", [None], "bstrOption: VT_EMPTY"),
    ],
)
def test_values_that_do_not_fit_can_be_shown_but_not_built(
    function: str, values: list[object], shown: str
) -> None:
    packet = BCAP(function=function, args=values)
    assert packet.args == tuple(map(variant_of, values))
    assert shown in packet.show(dump=True)
    assert shown in repr(packet)
    assert function in packet.summary()
    with pytest.raises(LocalProtocolError, match=shown.partition(":")[0]):
        bytes(packet)


def test_the_former_names_are_deprecated() -> None:
    with pytest.warns(DeprecationWarning, match="function_id has been deprecated in favor of function"):
        assert bytes(BCAP(function_id=2)) == bytes(BCAP(function=2))
    with pytest.warns(DeprecationWarning, match="import BCAP from bcapscope.scapy_layer"):
        former = import_module("bcapscope.capture.layer").BCAP
    assert former is BCAP
    with pytest.raises(AttributeError, match="no attribute 'ArgumentsField'"):
        _ = import_module("bcapscope.capture.layer").ArgumentsField


@pytest.mark.parametrize("pair", FRAMES, ids=FRAME_IDS)
def test_every_frame_of_the_table_is_dissected_and_built(pair: FramePair) -> None:
    packet, frame = BCAP(pair.data), Frame(pair.data)
    assert (packet.serial, packet.reserved, packet.args) == (frame.serial, frame.reserved, frame.variants)
    assert frame.code == (packet.hresult if packet.is_response else packet.function_id)
    assert bytes(packet) == pair.data
    again = bytes(packet.clone_with(**{**packet.fields, "length": None, "argc": None}))
    assert again == pair.data or frame.framing is Framing.VERSION_1_ZLIB


@given(frames())
def test_what_is_dissected_is_built_again(raw: bytes) -> None:
    assert BCAP(raw + b"behind")[Padding].load == b"behind"
    packet = BCAP(raw)
    assert bytes(packet) == bytes(packet.copy()) == bytes(pickle.loads(pickle.dumps(packet))) == raw
    packet.clear_cache()
    if Frame(raw).framing is Framing.VERSION_1_ZLIB:
        assert packet.frame.framing is Framing.VERSION_1
        assert (packet.frame.code, packet.frame.problems) == (Frame(raw).code, ())
        # A NaN differs from itself.
        assert list(map(repr, packet.frame.variants)) == list(map(repr, Frame(raw).variants))
    else:
        assert bytes(packet) == raw


@given(streams() | mutated_frames())
def test_damaged_bytes_are_built_as_they_came(data: bytes) -> None:
    packet = BCAP(data)
    assert bytes(packet) == data
    assert isinstance(packet.show(dump=True), str)
    assert isinstance(packet.json(), str)
    assert isinstance(packet.summary() + packet.command() + repr(packet), str)


@given(st.binary(max_size=80) | st.binary(max_size=60).map(lambda data: CALL[:13] + data))
def test_any_bytes_are_built_as_they_came(data: bytes) -> None:
    packet = UDP(bytes(UDP(sport=50001, dport=5007, chksum=0) / Raw(data)))
    assert bytes(packet)[8:] == data
    assert isinstance(packet.show(dump=True) + packet.summary(), str)


@given(mutated_frames())
def test_a_changed_serial_leaves_the_other_bytes_of_damage(data: bytes) -> None:
    packet = BCAP(data)
    assume(isinstance(packet, BCAP) and len(packet.frame.raw) > HEADER_SIZE)
    assume(packet.frame.framing is not Framing.VERSION_1_ZLIB)
    raw = packet.frame.raw
    packet.serial = 3
    again = raw[:5] + b"\x03\x00" + raw[7:]
    assert packet.frame.raw == packet.copy().frame.raw == again


@pytest.mark.parametrize("function", ["Unknown(200)", "Unknown(-2147467259)"])
def test_the_name_of_an_unknown_function_can_be_set(function: str) -> None:
    packet = BCAP(function=function)
    assert packet.function == BCAP(function=packet.function_id).function == function
    assert bytes(eval(packet.command(), {"BCAP": BCAP})) == bytes(packet)


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
    assert asked[BCAP].function == "Service_Start"
    assert answered[BCAP].hresult == 1
    assert BCAP(doubtful).function == "Service_Start"
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


@pytest.mark.parametrize("data", [b"", b"\x01", b"\x01\x20", CALL[:4], CALL[:5], CALL[:-1], b"garbage"])
def test_reassembly_waits_for_a_whole_frame(data: bytes) -> None:
    assert BCAP.tcp_reassemble(data, {}, {}) is None


def test_reassembly_takes_one_frame_and_leaves_the_rest() -> None:
    packet = BCAP.tcp_reassemble(CALL + CALL[:3], {}, {})
    assert packet is not None
    assert packet.frame == Frame(CALL)
    assert packet[Padding].load == CALL[:3]


@pytest.mark.parametrize("garbage", [b"garbage", b"\x01\x00\x00\x00\x00", b"\x01\xff\xff\xff\xff"])
def test_reassembly_finds_the_next_frame_after_garbage(garbage: bytes) -> None:
    packet = BCAP.tcp_reassemble(garbage + CALL, {}, {})
    assert packet is not None
    assert (packet[Raw].load, packet[Padding].load) == (garbage, CALL)


def test_reassembly_keeps_a_frame_with_a_damaged_end() -> None:
    damaged = CALL[:-1] + b"\xff"
    packet = BCAP.tcp_reassemble(damaged + CALL, {}, {})
    assert packet is not None
    assert (packet[BCAP].frame.raw, packet[Padding].load) == (damaged, CALL)


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


def frames_of(packet: Packet) -> list[BCAP]:
    """Return all frames of a packet."""
    return [layer for layer in packet.iterpayloads() if isinstance(layer, BCAP)]


@pytest.mark.parametrize("first", [2 * len(CALL) + 7, 3 * len(CALL) + 2, 66 * len(CALL) + 9])
def test_a_frame_may_begin_at_the_end_of_a_segment_of_frames(first: int) -> None:
    stream = b"".join(encode_frame(serial, 0, 3, [HANDLE]) for serial in range(200))
    packets = [
        Ether(bytes(client(part, 1000 + at))) for at, part in ((0, stream[:first]), (first, stream[first:]))
    ]
    with_session = sniff(offline=packets, session=TCPSession)
    serials = []
    for packet in with_session:
        for layer in packet.iterpayloads():
            if isinstance(layer, BCAP):
                serials.append(layer.serial)
            elif isinstance(layer, Raw):  # the frames that are too many for one packet
                serials += [
                    piece.item.serial
                    for piece in StreamSplitter().feed(layer.load)
                    if isinstance(piece.item, Frame)
                ]
    assert serials == list(range(200))


def test_a_segment_of_thousands_of_frames_is_read() -> None:
    stream = b"".join(encode_frame(serial, 0, 2) for serial in range(4000))
    (packet,) = sniff(offline=[Ether(bytes(client(stream, 1)))], session=TCPSession)
    assert [layer.serial for layer in frames_of(packet)] == list(range(64))
    assert packet[Raw].load == stream[64 * 16 :]
    assert bytes(packet)[-len(stream) :] == stream


@pytest.mark.parametrize(
    "name",
    [
        "damaged-dumps.pcap",
        "exchanges.pcap",
        "retry-story.pcapng",
        "slave-mode-lost.pcapng",
        "slave-session.pcapng",
        "two-robots.pcapng",
        "vlan-ipv6.pcap",
    ],
)
def test_a_capture_has_the_frames_that_open_reads(name: str) -> None:
    path = str(CAPTURES / name)
    read = [frame for packet in sniff(offline=path, session=TCPSession) for frame in frames_of(packet)]
    expected = list(bcapscope.open(path).frames)
    assert [each.frame.raw for each in read] == [each.raw for each in expected]
    assert [each.hresult for each in read] == [each.hresult for each in expected]
    requests = [(got, frame) for got, frame in zip(read, expected, strict=True) if frame.kind == "request"]
    assert requests
    for got, frame in requests:
        assert (got.function, got.command_name) == (frame.function, frame.command or None)


def test_rdpcap_reads_each_datagram() -> None:
    path = str(CAPTURES / "retry-story.pcapng")
    packets = rdpcap(path)
    assert [packet[BCAP].frame.raw for packet in packets] == [
        each.raw for each in bcapscope.open(path).frames
    ]
    assert [packet[BCAP].retry_of for packet in packets] == [None, 1232, 1232, 1232, None, None]
    assert packets[1][BCAP].mysummary() == "b-CAP Robot_Execute 'slvMove' serial 1233 retry of 1232"


def test_sr_pairs_each_attempt_with_its_reply() -> None:
    answered, others = rdpcap(str(CAPTURES / "retry-story.pcapng")).sr()
    assert [(pair.query.serial, pair.answer.serial) for pair in answered] == [(1233, 1233), (1235, 1235)]
    assert [packet.serial for packet in others] == [1232, 1234]


def test_sr_pairs_all_calls_of_a_session() -> None:
    path = str(CAPTURES / "slave-session.pcapng")
    answered, _ = rdpcap(path).sr()
    calls = [call for call in bcapscope.open(path).calls if call.reply is not None]
    expected = sorted((call.request.item.raw, call.reply.item.raw) for call in calls if call.reply)
    assert sorted((pair.query[BCAP].frame.raw, pair.answer[BCAP].frame.raw) for pair in answered) == expected


@pytest.mark.parametrize("frame", [CALL, encode_frame(2, 1, 64, [HANDLE], Framing.VERSION_1), reply(3)])
def test_what_is_no_retry(frame: bytes) -> None:
    packet = IP(bytes(client(frame, 1)[IP])) if frame == CALL else BCAP(frame)
    assert packet[BCAP].retry_of is None


def test_what_is_no_retry_after_garbage_in_a_stream() -> None:
    (packet,) = sniff(offline=[Ether(bytes(client(b"garbage" + CALL, 1)))], session=TCPSession)
    assert packet[Raw].load == b"garbage"
    assert packet[BCAP].retry_of is None


def test_a_field_makes_it_a_request_or_a_reply() -> None:
    packet = BCAP(CALL)
    packet.hresult = "S_OK"
    packet.args, packet.length, packet.argc = [], None, None
    assert bytes(packet) == encode_frame(5, 4, 0)
    packet.function = "Controller_GetTag"
    assert bytes(packet) == encode_frame(5, 4, Frame(request(1)).code)


def test_a_reply_without_its_defaults_stays_a_reply() -> None:
    packet = BCAP(encode_frame(1, 0, 0))
    packet.hide_defaults()
    assert packet.is_response
    assert packet.sprintf("%BCAP.function% %BCAP.hresult%") == "None S_OK"


def test_the_port_tells_the_kind_of_each_frame_in_a_segment() -> None:
    stream = reply(5) + encode_frame(6, 0, 1)
    answer = IP(src="10.0.0.1", dst="10.0.0.2") / TCP(sport=5007, dport=50001, seq=1, flags="PA") / stream
    (packet,) = sniff(offline=[Ether(bytes(Ether() / answer))], session=TCPSession)
    assert [(layer.hresult, layer.function) for layer in frames_of(packet)] == [(0, None), (1, None)]


def test_show_names_functions_and_arguments() -> None:
    shown = BCAP(CALL).show(dump=True)
    assert "function  = Robot_Execute\n" in shown
    args = "hRobot: VT_I4 1, bstrCommand: VT_BSTR 'slvMove', vntParam: VT_R8|VT_ARRAY (1.5, 2.5)"
    assert f"args      = [{args}]\n" in shown
    nested = Variant.array(VT.VARIANT, (Variant(VT.I2, 1), EMPTY))
    shown = BCAP(encode_frame(1, 0, 0x80070006, [nested])).show(dump=True)
    assert "hresult   = E_HANDLE\n" in shown
    assert "args      = [VT_VARIANT|VT_ARRAY (VT_I2 1, VT_EMPTY)]\n" in shown


def test_a_damaged_frame_says_so() -> None:
    packet = BCAP(CALL[:-4])
    assert packet.frame.problems == Frame(CALL[:-4]).problems != ()
    assert packet.mysummary() == "b-CAP Robot_Execute 'slvMove' serial 5 retry of 4 [damaged]"


def test_one_packet_can_stand_for_many() -> None:
    many = BCAP(serial=[1, 2], function=["Robot_Halt", 2], args=[1])
    assert many.function == ["Robot_Halt", "Service_Stop"]
    assert "args=[VT_I4 1]" in repr(many)
    packets = list(many)
    assert [(each.serial, each.function) for each in packets] == [
        (1, "Robot_Halt"),
        (2, "Robot_Halt"),
        (1, "Service_Stop"),
        (2, "Service_Stop"),
    ]


def test_fuzz_keeps_the_arguments() -> None:
    packet = fuzz(BCAP(function="Robot_Halt", args=[1, ""]))
    raw = bytes(packet)
    assert Frame(raw).code == 70
    assert Frame(raw).raw[15:43] == bytes(BCAP(function="Robot_Halt", args=[1, ""]))[15:43]


def test_raw_values_are_sent_as_they_are() -> None:
    packet = BCAP(function="Robot_Halt", args=RawVal(b"\xff\xff"), argc=7)
    assert bytes(packet) == bytes.fromhex("01 12000000 0100 0000 46000000 0700 FFFF 04")


def test_a_simulated_controller_answers_what_scapy_sends() -> None:
    with bcapscope.Simulator() as controller:
        address = (controller.host, controller.port)
        with socket.create_connection(address) as connection:
            stream = StreamSocket(connection, BCAP)
            started = stream.sr1(BCAP(args=[""]), timeout=30, verbose=False)
            values = ["", "CaoProv.DENSO.VRC", "", ""]
            connected = stream.sr1(
                BCAP(serial=2, function="Controller_Connect", args=values), timeout=30, verbose=False
            )
        calls = [call.function for call in controller.calls]
    assert started.hresult == 0
    assert connected.args[0].vt == VT.I4
    assert calls[:2] == ["Service_Start", "Controller_Connect"]
