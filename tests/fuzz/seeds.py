"""Where fuzzing begins: the tests' own samples, sound, glued and damaged."""

from __future__ import annotations

import gzip
from pathlib import Path

from bcapscope.protocol.codec.frame import encode_frame
from bcapscope.protocol.codec.variant import EMPTY, VT, Variant, encode_argument
from bcapscope.protocol.tables.function_table import function_by_name
from bcapscope.simulator.profile import PROFILES
from tests.capture import packets as p
from tests.dumps import FORMS, window
from tests.frames import ARGUMENTS, DAMAGED, FRAMES, HANDLE, nested
from tests.fuzz.simulating import BUTTON, CALL, HANG_UP, RAW, RETRY, WAIT, Step

CAPTURES = Path(__file__).parents[2] / "captures"
LARGEST_SEED = 8192


def _framed(argument: bytes) -> bytes:
    return b"\x01" + (16 + len(argument)).to_bytes(4, "little") + bytes(8) + b"\x01\x00" + argument + b"\x04"


def frame_seeds() -> list[bytes]:
    """Datagrams."""
    sound = [pair.data for pair in FRAMES] + [_framed(pair.data) for pair in ARGUMENTS]
    return [*sound, *(sample.data for sample in DAMAGED), nested(34)]


def stream_seeds() -> list[bytes]:
    """Streams behind their cuts, as `tests.fuzz.targets.stream` takes them."""
    frames = [pair.data for pair in FRAMES]
    heads = (b"\x01\x00", b"\x00\x02\x07\x20", b"\x03\x03\x10\x00\x05")
    bodies = (
        b"".join(frames),
        b"\x01\x01" + frames[2] + b"\x01garbage" + frames[3],
        frames[4][:-3] + frames[0],
    )
    return [head + body for head in heads for body in (*bodies, *frames)]


def capture_seeds() -> list[bytes]:
    """Capture files: every form, link layer and way to carry a frame, one at least of each."""
    call, answer = p.request(1), p.reply(1)
    long = encode_frame(2, 0, 64, [Variant.array(VT.UI1, bytes(range(200)))])
    to_server = p.ipv4(p.udp(call))
    datagrams = (p.from_client(call), p.from_server(answer), p.from_client(call + call))
    segments = [p.ethernet(p.ipv4(content, protocol=6)) for content in _segments(long)]
    parts = p.udp(long)
    pieces = (
        p.ipv4(parts[:80], part=0x2000),
        p.ipv4(parts[80:160], part=0x2000 + 10),
        p.ipv4(parts[160:], part=20),
    )
    other_links = [
        (113, bytes(14) + b"\x08\x00"),
        (276, b"\x08\x00" + bytes(18)),
        (0, b"\x02\0\0\0"),
        (101, b""),
    ]
    made = [
        p.pcap(*datagrams),
        p.pcap(*segments),
        p.pcap(*map(p.ethernet, pieces)),
        p.pcap(p.ethernet(to_server, tags=(0x88A8, 0x8100))),
        p.pcap(p.ethernet(p.ipv6(p.udp(call)), 0x86DD), p.ethernet(p.ipv6(p.udp(call)[:20]), 0x86DD)),
        p.pcap(p.ethernet(p.ipv4(p.udp(call, dport=7000))), p.ethernet(p.ipv4(p.udp(call, dport=7000)))),
        *(p.pcap(head + to_server, linktype=linktype) for linktype, head in other_links),
        p.section()
        + p.interface()
        + p.enhanced(datagrams[0])
        + p.simple(datagrams[1])
        + p.obsolete(datagrams[0]),
        p.section(">") + p.interface(order=">") + p.enhanced(datagrams[0], order=">"),
        gzip.compress(p.pcap(*datagrams), mtime=0),
    ]
    files = [path.read_bytes() for path in sorted(CAPTURES.glob("*.pcap*"))]
    return made + [data for data in files if len(data) <= LARGEST_SEED]


def _segments(long: bytes) -> list[bytes]:
    """A TCP connection: opened, a frame in three parts, one of them late, one twice, closed."""
    parts = [(1, long[:50]), (101, long[100:]), (51, long[50:100]), (51, long[50:120])]
    sent = [p.tcp(data, seq=seq, ack=1, flags=8) for seq, data in parts]
    return [p.tcp(seq=0, flags=2), *sent, p.tcp(seq=len(long) + 1, ack=1, flags=1)]


def render_seeds() -> list[bytes]:
    """Datagrams behind the byte that tells who sent them."""
    hostile = encode_frame(5, 0, 64, [HANDLE, Variant(VT.BSTR, "=\x1b[2J\x9b\u202e\u2028\ud800[/foo]\"<b>'")])
    return [bytes((head,)) + data for data in (*frame_seeds(), hostile) for head in (0, 1, 2)]


def text_seeds() -> list[bytes]:
    """Frames as they are pasted: every form of dump, captions, prose; the frames of the sample captures."""
    request, damaged = FRAMES[2].data, FRAMES[2].data[:13] + FRAMES[2].data[14:]
    texts = [form(request) for form in FORMS]
    texts += [f"Send Packet\n{window(request)}\nReceive:\n{window(damaged)}\nas I said, 0x01 is SOH."]
    samples = [path.read_text() for path in sorted(CAPTURES.glob("*.txt"))]
    return [text.encode() for text in texts + samples]


def _call(function: str, *arguments: Variant, tcp: bool = False) -> bytes:
    found = function_by_name(function)
    assert found is not None
    packed = b"".join(map(encode_argument, arguments))
    return Step(CALL, 0, tcp, bytes((found.id, len(arguments))) + packed).packed()


def _robot(command: str, parameter: Variant = EMPTY, tcp: bool = False) -> bytes:
    return _call("Robot_Execute", Variant(VT.I4, 2), Variant(VT.BSTR, command), parameter, tcp=tcp)


def _wait(ms: int) -> bytes:
    return Step(WAIT, 0, False, ms.to_bytes(2, "little")).packed()


def _opening(provider: str, tcp: bool) -> list[bytes]:
    texts = [Variant(VT.BSTR, text) for text in ("", provider, "localhost", "")]
    controller, arm, program = Variant(VT.I4, 1), Variant(VT.BSTR, "Arm"), Variant(VT.BSTR, "RobSlave")
    empty = texts[0]
    return [
        _call("Service_Start", Variant(VT.BSTR, ",WDT=80,InvokeTimeout=200"), tcp=tcp),
        _call("Controller_Connect", *texts, tcp=tcp),
        _call("Controller_GetRobot", controller, arm, empty, tcp=tcp),
        _call("Controller_GetTask", controller, program, empty, tcp=tcp),
        _call("Task_Start", Variant(VT.I4, 3), Variant(VT.I4, 1), empty, tcp=tcp),
        _robot("TakeArm", Variant.array(VT.I4, (0, 0)), tcp),
        _robot("Motor", Variant.array(VT.I4, (1, 0)), tcp),
        _wait(500),
    ]


def simulator_seeds() -> list[bytes]:
    """Sessions, as `tests.fuzz.simulating` takes them: slave mode, motions, variables, retries, bad bytes."""
    point = Variant.array(VT.R8, (0.0, 0.0, 90.0, 0.0, 90.0, 0.0, 0.0, 0.0))
    pose = Variant(VT.BSTR, "@E J(10,0,90,0,90,0)")
    formats = [_robot(name, Variant(VT.I4, value)) for name, value in _FORMATS]
    slaves = [
        [
            *formats,
            _robot("slvChangeMode", Variant(VT.I4, mode)),
            _robot("slvMove", point),
            Step(RETRY, 0, False, b"\x01\x00").packed(),
            *[_wait(8), _robot("slvMove", point)] * 3,
            _robot("slvChangeMode", Variant(VT.I4, 0)),
            _wait(100),
        ]
        for mode in (0x002, 0x102, 0x202)
    ]
    controller, empty = Variant(VT.I4, 1), Variant(VT.BSTR, "")
    variables = [
        _call("Controller_GetVariable", controller, Variant(VT.BSTR, "P1"), empty),
        _call("Variable_PutValue", Variant(VT.I4, 4), Variant.array(VT.R8, (300.0,) * 7)),
        _call("Variable_GetValue", Variant(VT.I4, 4)),
        _call("Controller_GetVariableNames", controller, empty),
        _call("Variable_Release", Variant(VT.I4, 4)),
    ]
    moves = [
        _call("Robot_Move", Variant(VT.I4, 2), Variant(VT.I4, 1), pose, empty, tcp=tcp)
        + _robot("CurJnt", tcp=tcp)
        + _wait(90) * 4
        for tcp in (False, True)
    ]
    logs = [_robot("StartLog"), _wait(40), _robot("GetLogRecord", Variant(VT.I4, 0)), _robot("J2P", point)]
    raw = [Step(RAW, 1, tcp, pair.data[:255]).packed() for pair in FRAMES for tcp in (False, True)]
    ends = [Step(BUTTON, 0, False, b"s").packed(), Step(HANG_UP, 0, True, b"").packed()]
    made = []
    for profile, name in enumerate(PROFILES):
        provider = "CaoProv.DENSO.VRC9" if name == "rc9" else "CaoProv.DENSO.VRC"
        over_udp, over_tcp = _opening(provider, False), _opening(provider, True)
        for script in (*slaves, variables, logs, raw, [moves[0], *ends], [*over_tcp, moves[1], *ends]):
            made.append(bytes((profile,)) + b"".join([*over_udp, *script]))
    return made


def trajectory_seeds() -> list[bytes]:
    """The first lines of the samples, and of other kinds of files, behind the byte that tells the name."""
    tables = [b"".join(path.read_bytes().splitlines(True)[:6]) for path in sorted(CAPTURES.glob("*.csv"))]
    tables += [
        b"1 2 3 4 5 6\n" * 4,
        b"t;J1;J2\n0,0;1,5;2\n0,1;1,6;3\n",
        "[J1 - 指令値]\t[No.]\n1\t1\n2\t2\n3\t9\n".encode("utf-16"),
        b"X,Y,Z,Ox,Oy,Oz,Ax,Ay,Az,Fig\n" + b"400,0,500,0,1,0,0,0,1,1\n" * 3,
    ]
    message = b'{"joint_names":["j2","j1"],"points":[{"positions":[0,1],"time_from_start":{"sec":0}}]}'
    own = b'{"format":"bcapscope trajectory 1","columns":["J1_deg"],"rows":[[1],["NaN"]],"interval_ms":8}'
    texts = [path.read_bytes() for path in sorted(CAPTURES.glob("*.yaml"))]
    return [
        *(b"\0" + data for data in (*tables, *capture_seeds()[:8])),
        *(b"\1" + data for data in (message, own)),
        *(b"\2" + data for data in (*texts, b"a: &a [*a]\nb: {joint_names: [x], points: *a}\n")),
    ]


_FORMATS = (("slvSendFormat", 0), ("slvRecvFormat", 0x14), ("slvGetMode", 0))


def rules_seeds() -> list[bytes]:
    """A short talk, in pieces, under every kind of rules."""
    handle, pose = Variant(VT.I4, 1), Variant.array(VT.R4, (1.0, 20.0))
    moves = [
        encode_frame(serial, serial // 2 * 2, 64, (handle, Variant(VT.BSTR, "slvMove"), pose))
        for serial in (2, 3)
    ]
    steps = []
    for serial, raw in enumerate((*moves, encode_frame(9, 0, 70, (handle,))), 2):
        cut = raw[:30], raw[30:]
        steps += [
            (0, cut[0]),
            (0, cut[1]),
            (4 * 4 + 1, encode_frame(serial, 0, 0, (pose,))),
            (2, b""),
            (4 * 9 + 3, b""),
        ]
    talk = b"".join(bytes((what, len(data))) + data for what, data in (*steps, (0, b"garbage" + moves[0])))
    return [bytes((choice,)) + talk for choice in (*range(0, 256, 16), *range(16))]


SEEDS = {
    "frame": frame_seeds,
    "stream": stream_seeds,
    "capture": capture_seeds,
    "render": render_seeds,
    "text": text_seeds,
    "simulator": simulator_seeds,
    "trajectory": trajectory_seeds,
    "rules": rules_seeds,
}
