"""Calls that go wrong, several networks in one capture, and bytes that no sound client sends."""

from __future__ import annotations

import math
import struct
import zlib

from bcapscope.protocol.codec.frame import encode_frame
from bcapscope.protocol.codec.variant import ARRAY, EMPTY, VT, Variant, encode_argument
from tests.samples.calls import (
    CLIENT,
    MS,
    START,
    US,
    Datagrams,
    i4,
    r8s,
    reply,
    request,
    text,
)
from tests.samples.files import LINUX_COOKED_2, Interface, Packet, pcap, pcapng
from tests.samples.tcp import Connection
from tests.samples.wire import Host, cooked, ethernet, udp

_CYCLE = 8 * MS
_ROBOT = i4(2)
_MOTION = [r8s(n * n / 64, 0.0, 90.0 + n / 8, 0.0, 90.0, 0.0, 0.0, 0.0) for n in range(30)]
_BUFFER_EMPTY, _NOT_SLAVE_MODE, _ERROR_ACTIVE = 0x84201482, 0x83500121, 0x81501025


def slave_mode_lost() -> bytes:
    """Return a client that pauses in the middle of a motion, and what comes of it."""
    network = Datagrams()
    point = r8s(18.0, 0.0, 93.0, 0.0, 90.0, 0.0, 0.0, 0.0)
    paused = START + (len(_MOTION) + 7) * _CYCLE
    calls = [(START - 2 * _CYCLE, "slvChangeMode", i4(0x202), EMPTY, 0, "")]
    calls += [(START + n * _CYCLE, "slvMove", pose, pose, 0, "") for n, pose in enumerate(_MOTION)]
    calls += [
        (paused, "slvMove", point, EMPTY, _BUFFER_EMPTY, "64 ms after the set point before it"),
        (paused + _CYCLE, "slvMove", point, EMPTY, _NOT_SLAVE_MODE, "a consequence"),
        (paused + 2 * _CYCLE, "slvMove", point, EMPTY, _NOT_SLAVE_MODE, "a consequence"),
        (paused + 30 * _CYCLE, "Motor", i4(1), EMPTY, _ERROR_ACTIVE, "refused while an error is active"),
    ]
    for serial, (at, command, parameter, result, hresult, comment) in enumerate(calls, 401):
        asked = request(serial, 0, "Robot_Execute", _ROBOT, text(command), parameter)
        network.up(at, asked, comment)
        network.down(at + 700 * US, reply(serial, 0, result, hresult=hresult))
    return pcapng(network.packets, [Interface("eth0")], "a pause of 64 ms ends slave mode")


def two_robots() -> bytes:
    """Return two controllers on two interfaces of one PC, recorded together."""
    left = Datagrams()
    right_client = Host(bytes.fromhex("0200c0a8010a"), "fd00:1::a", 50001)
    right_server = Host(bytes.fromhex("0200c0a80101"), "fd00:1::1", 5007)
    packets = []
    for step in range(12):
        at = START + step * 8 * MS
        left.up(at, _set_point(step + 1, 0, 0.5 * step))
        left.down(at + 900 * US, reply(step + 1, 0, r8s(*_pose(0.5 * step))))
        serial = 65530 + step if step < 6 else step - 5
        for after, src, dst, frame in (
            (3100 * US, right_client, right_server, _set_point(serial, serial, -0.25 * step)),
            (3950 * US, right_server, right_client, reply(serial, 0, r8s(*_pose(-0.25 * step)))),
        ):
            data = cooked(src, udp(src, dst, frame), src is right_client, 3)
            packets.append(Packet(at + after, data, "", 1))
    interfaces = [
        Interface("eth0", "left cell", nanoseconds=False),
        Interface("any", "right cell", LINUX_COOKED_2),
    ]
    return pcapng(sorted(packets + left.packets), interfaces)


def vlan_ipv6() -> bytes:
    """Return a TCP session over IPv6 in two VLANs, among packets that are no b-CAP."""
    client = Host(bytes.fromhex("0200c0a8000a"), "fd00::a", 49152)
    server = Host(bytes.fromhex("0200c0a80001"), "fd00::1", 5007)
    connection = Connection(client, server, vlans=(100, 42))
    connection.open(START)
    names = map(text, ("", "CaoProv.DENSO.VRC9", "localhost", "@IfNotMember"))
    calls = (
        (request(1, 0, "Service_Start", text(",WDT=400")), reply(1, 0)),
        (request(2, 0, "Controller_Connect", *names), reply(2, 0, i4(1))),
        (request(3, 0, "Controller_GetVariable", i4(1), text("IO128"), text("")), reply(3, 0, i4(2))),
        (request(4, 0, "Variable_PutValue", i4(2), Variant(VT.BOOL, True)), reply(4, 0)),
        (request(5, 0, "Variable_GetValue", i4(2)), reply(5, 0, Variant(VT.BOOL, True))),
        (request(6, 0, "Controller_GetVariable", i4(1), text("S1"), text("")), reply(6, 0, i4(3))),
        (request(7, 0, "Variable_PutValue", i4(3), text("ロボット 😀")), reply(7, 0)),
    )
    for step, (asked, answered) in enumerate(calls, 1):
        connection.up(START + step * 10 * MS, asked)
        connection.down(START + step * 10 * MS + MS, answered)
    return pcap(sorted(connection.packets + _noise()), nanoseconds=True)


def _noise() -> list[Packet]:
    """Make an ARP request, a name query and a clock's datagram, as on any network."""
    router = Host(bytes.fromhex("0200c0a800fe"), "192.168.0.254", 123)
    everyone = bytes.fromhex("ffffffffffff")
    arp = struct.pack(">HHBBH", 1, 0x0800, 6, 4, 1) + router.mac + bytes((192, 168, 0, 254)) + bytes(6)
    question = b"\x00\x01\x01\x00\x00\x01\x00\x00\x00\x00\x00\x00\x04cell\x05local\x00\x00\x01\x00\x01"
    name_query = udp(CLIENT, router._replace(port=53), question)
    clock = udp(router, CLIENT._replace(port=123), b"\x1c" + bytes(47))
    return [
        Packet(START + 3 * MS, everyone + router.mac + b"\x08\x06" + arp + bytes((192, 168, 0, 1))),
        Packet(START + 14 * MS, ethernet(CLIENT, router, name_query)),
        Packet(START + 25 * MS, ethernet(router, CLIENT, clock)),
    ]


def malformed() -> bytes:
    """Return datagrams with strings that attack a reader and frames that are wrong, one fault each."""
    network = Datagrams()
    for index, (comment, data) in enumerate((*_hostile_strings(), *_broken_frames())):
        network.up(START + index * MS, data, comment)
    network.down(START + 900 * MS, reply(1, 0, text("\x1b]0;owned\x07"), hresult=0x80004005), "from a server")
    whole = network.packets[0]
    cut = Packet(START + 950 * MS, whole.data[:70], "the capture kept 70 bytes", 0, len(whole.data))
    return pcapng([*network.packets, cut], [Interface("eth0")], "nothing here is to be trusted")


def _hostile_strings() -> list[tuple[str, bytes]]:
    strings = {
        "clears a terminal": "\x1b[2J\x1b[31mred\x1b[0m",
        "C1 control characters": "\x9b31m\x84\x85",
        "reverses what follows it": "abc\u202egpj.exe\u2066",
        "breaks the line": "one\r\nHTTP/1.1 200 OK\n\n2     0.000000 forged",
        "markup": "[/foo][red]<script>alert(1)</script>&amp;",
        "a formula in a spreadsheet": '=HYPERLINK("http://a","b"),\'"; x',
        "NUL inside": "slv\0Move",
        "lone surrogates": "\ud800a\udc00",
        "long": "slvMove" * 60,
        "marks piled up, no width, not a character": "Z\u0351\u0350\u035c\u200b\ufeff\uffff",
    }
    return [
        (comment, request(serial, serial, "Robot_Execute", _ROBOT, text(value), EMPTY))
        for serial, (comment, value) in enumerate(strings.items(), 1)
    ]


def _broken_frames() -> list[tuple[str, bytes]]:
    sound = _set_point(20, 20, 1.0)
    stop = request(21, 21, "Service_Stop")
    handle = encode_argument(_ROBOT)
    nested = struct.pack("<HI", VT.VARIANT | ARRAY, 1) * 59 + struct.pack("<HII", VT.I4, 1, 1)
    return [
        ("no bytes", b""),
        ("one byte", b"\x01"),
        ("does not begin with SOH", b"GET / HTTP/1.1\r\nHost: robot\r\n\r\n"),
        ("length field too small", sound[:1] + struct.pack("<I", 4) + sound[5:]),
        ("length field says 4 GB", sound[:1] + b"\xff\xff\xff\xff" + sound[5:]),
        ("ends with 05", sound[:-1] + b"\x05"),
        ("cut after 40 bytes", sound[:40]),
        ("65535 arguments, one there", _with(22, 65535, handle)),
        ("no argument counted, one there", _with(23, 0, handle)),
        ("type 9 is not for the wire", _with(24, 1, _argument(9, 1, b"\x12\x34"))),
        ("an array of type 0x0FFF", _with(25, 1, _argument(0x2FFF, 2, bytes(8)))),
        ("four billion doubles promised", _with(26, 1, _argument(0x2005, 0xFFFFFFFF, bytes(16)))),
        ("a string longer than the frame", _with(27, 1, _argument(8, 1, b"\xff\xff\xff\x7fA\x00"))),
        ("a string of three bytes", _with(28, 1, _argument(8, 1, b"\x03\x00\x00\x00A\x00B"))),
        ("argument length too small", _with(29, 1, b"\x04" + handle[1:])),
        ("argument length too large", _with(30, 1, b"\x40" + handle[1:])),
        ("element count 7 of a scalar", _with(31, 1, _argument(3, 7, bytes(4)))),
        ("60 VARIANT arrays inside one another", _with(32, 1, _argument(VT.VARIANT | ARRAY, 1, nested))),
        ("function 200, which does not exist", encode_frame(33, 33, 200, (_ROBOT,))),
        ("two frames in one datagram", stop + request(34, 34, "Service_Stop")),
        ("bytes behind the frame", stop + b"\xde\xad\xbe\xef"),
        ("compressed, and says it unpacks to 4 GB", _compressed(handle)),
        ("not a number, infinite, minus zero", _strange_numbers()),
        ("serial 0", request(0, 0, "Service_Stop")),
    ]


def _with(serial: int, argc: int, arguments: bytes) -> bytes:
    """Make a Variable_GetValue whose argument count is as told."""
    head = struct.pack("<BIHHIH", 1, 16 + len(arguments), serial, serial, 101, argc)
    return head + arguments + b"\x04"


def _argument(vt: int, count: int, data: bytes) -> bytes:
    return struct.pack("<IHI", 6 + len(data), vt, count) + data


def _compressed(handle: bytes) -> bytes:
    """Make a compressed frame of version 1; its zlib stream is stored, and so the same everywhere."""
    inner = struct.pack("<IH", 101, 1) + handle
    stored = struct.pack("<BHH", 1, len(inner), len(inner) ^ 0xFFFF) + inner
    packed = b"\x78\x01" + stored + zlib.adler32(inner).to_bytes(4, "big")
    return struct.pack("<BIHHI", 1, 15 + len(packed), 36, 1, 0xFFFFFFFF) + packed + b"\x01\x04"


def _set_point(serial: int, reserved: int, first: float) -> bytes:
    return request(serial, reserved, "Robot_Execute", _ROBOT, text("slvMove"), r8s(*_pose(first)))


def _strange_numbers() -> bytes:
    point = r8s(math.nan, math.inf, -math.inf, -0.0, 5e-324, 1.7976931348623157e308, 0.0, 0.0)
    return request(35, 35, "Robot_Execute", _ROBOT, text("slvMove"), point)


def _pose(first: float) -> tuple[float, ...]:
    return (first, 10.0, 80.0, 0.0, 90.0, 0.0, 0.0, 0.0)
