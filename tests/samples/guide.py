"""The packets of "How to use the Slave mode/b-CAP" (DENSO Wave, 2009): as printed and as they must have been.

Several dumps of that document lost zero bytes, gained some, or were cut when it was made. Each stands here as
printed, beside the frame that its length field and the width of its fields call for.
"""

from __future__ import annotations

from typing import NamedTuple

from bcapscope.protocol.codec.variant import Variant
from tests.samples.calls import (
    CLIENT,
    MS,
    SECOND,
    START,
    US,
    Datagrams,
    i2,
    i4,
    r4s,
    reply,
    request,
    text,
)
from tests.samples.files import Interface, pcap, pcapng


class Dump(NamedTuple):
    """A packet of the document.

    Attributes:
        page: title of the page.
        caption: what stands over the hex.
        printed: the hex, line by line as printed.
        frame: the sound frame.
        client: whether the client sends it.
    """

    page: str
    caption: str
    printed: str
    frame: bytes
    client: bool


_ROBOT = i4(1)
_WAY = r4s(-55.90986251831055, 25.482128143310547, 179.03720092773438, 33.9837646484375, 0.0, 0.0, 0.0, 0.0)
_HERE = r4s(-57.42422103881836, 25.76953125, 178.46681213378906, 34.36530685424805, 0.0, 0.0, 0.0, 0.0)
_TESTER_WAY = r4s(
    *(12.42261028289795, 60.361080169677734, 17.632320404052734),
    *(35.8143310546875, 20.427980422973633, 23.948789596557617),
)
_TESTER_HERE = r4s(
    *(12.422607421875, 60.3607177734375, 17.6319580078125, 35.8143310546875),
    *(20.427978515625, 23.947917938232422, 0.0, 0.0),
)


def _execute(serial: int, reserved: int, command: str, parameter: Variant) -> bytes:
    return request(serial, reserved, "Robot_Execute", _ROBOT, text(command), parameter)


_CHANGE_MODE, _GET_MODE, _MOVE = "slvChangeMode", "slvGetMode", "slvMove"
_TX, _RX = "TX(Client->Server):", "RX(Server->Client):"
_RETRY_PAGE = "Retry sequence in UDP connection (3)"
_SET_POINT_TAIL = """\
76 00 65 00 26 00 00 00 04 20 08 00 00 00 B3 A3 5F C2
66 DB CB 41 86 09 33 43 60 EF 07 42 00 00 00 00 00 00
00 00 00 00 00 00 00 00 00 00 04"""
_SET_POINT_MIDDLE = """
00 00 03 00 01 00 00 00 01 00 00 18 00 00 00 08 00
01 00 00 00 0E 00 00 00 73 00 6C 00 76 00 4D 00 6F 00
"""
_POSE_TAIL = """
00 00 04 20 08 00 00 00 67 B2 65 C2 00 28 CE 41 81 77
32 43 13 76 09 42 00 00 00 00 00 00 00 00 00 00 00
00 00 00 00 04"""


def _set_point(serial: int, reserved: int, caption: str, head: str, whole: bool) -> Dump:
    printed = head + _SET_POINT_MIDDLE + (_SET_POINT_TAIL if whole else "")
    frame = _execute(serial, reserved, _MOVE, _WAY)
    return Dump(_RETRY_PAGE, f"Packet TX(Client->Server){caption}", printed.strip(), frame, True)


def _pose(serial: int, reserved: int, caption: str, head: str) -> Dump:
    frame = reply(serial, reserved, _HERE)
    return Dump(_RETRY_PAGE, f"Packet RX(Server->Client){caption}", head + _POSE_TAIL, frame, False)


DUMPS: tuple[Dump, ...] = (
    Dump(
        _CHANGE_MODE,
        _TX,
        """\
01 52 00 00 00 05 00 00 00 40 00 00 00 03 00 0A
00 00 00 03 00 01 00 00 00 01 00 00 00 24 00 00
00 08 00 01 00 00 00 1A 00 00 00 73 00 6C 00 76
00 43 00 68 00 61 00 6E 00 67 00 65 00 4D 00 6F
00 64 00 65 00 08 00 00 00 02 00 01 00 00 00 02
00 04""",
        _execute(5, 0, _CHANGE_MODE, i2(2)),
        True,
    ),
    Dump(_CHANGE_MODE, _RX, "01 10 00 00 00 08 00 00 00 00 00 00 00 00 04", reply(8, 0), False),
    Dump(
        _GET_MODE,
        _TX,
        """\
01 4E 00 00 00 05 00 00 00 40 00 00 00 03 00 0A
00 00 00 03 00 01 00 00 00 01 00 00 00 1E 00 00
00 08 00 01 00 00 00 14 00 00 00 73 00 6C 00 76
00 47 00 65 00 74 00 4D 00 6F 00 64 00 65 00 0A
00 00 00 08 00 01 00 00 00 00 00 00 00 00 04""",
        _execute(5, 0, _GET_MODE, text("")),
        True,
    ),
    Dump(
        _GET_MODE,
        _RX,
        """\
01 1C 00 00 00 05 00 00 00 00 00 00 00 01 00 08
00 00 00 02 00 01 00 00 00 02 00 04""",
        reply(5, 0, i2(2)),
        False,
    ),
    Dump(
        _MOVE,
        "Client \u2192server:",
        """\
01 60 00 00 00 08 00 00 00 40 00 00 00 03 00 0A
00 00 00 03 00 01 00 00 00 01 00 00 00 18 00 00
00 08 00 01 00 00 00 0E 00 00 00 53 00 4C 00 56
00 4D 00 4F 00 56 00 45 00 22 00 00 00 04 20 07
00 00 00 00 00 20 41 00 00 A0 41 00 00 F0 41 00
00 20 42 00 00 48 42 00 00 70 42 00 00 80 3F 04""",
        _execute(8, 0, "SLVMOVE", r4s(10.0, 20.0, 30.0, 40.0, 50.0, 60.0, 1.0)),
        True,
    ),
    _set_point(1232, 0, "", "01 64 00 00 00 D0 04 00 00 40 00 00 03 00 0A 00", True),
    _pose(1232, 0, "", "01 3A 00 00 00 D0 04 00 00 00 00 00 01 00 26 00"),
    _set_point(1232, 0, "", "01 64 00 00 00 D0 04 00 00 40 00 00 03 00 0A 00", False),
    _set_point(1233, 1232, " Retry #1", "01 64 00 00 00 D1 04 D0 04 40 00 00 03 00 0A 00", False),
    _set_point(1234, 1232, " Retry #2", "01 64 00 00 00 D2 04 D0 04 40 00 00 03 00 0A 00", False),
    _set_point(1235, 1232, " Retry #3", "01 64 00 00 00 D3 04 D0 04 40 00 00 03 00 0A 00", True),
    _pose(1233, 1232, " #1", "01 3A 00 00 00 D1 04 D0 04 00 00 00 01 00 26 00"),
    _pose(1235, 1232, " #2", "01 3A 00 00 00 D3 04 D0 04 00 00 00 01 00 26 00"),
    Dump(
        "Show packets (1)",
        "SendData",
        """\
01 54 00 00 00 09 00 00 00 40 00 00 00 03 00 0A
00 00 00 03 00 01 00 00 00 01 00 00 00 24 00 00
00 08 00 01 00 00 00 1A 00 00 00 73 00 6C 00 76
00 43 00 68 00 61 00 8E 00 67 00 85 00 4D 00 6F
00 64 00 65 00 0A 00 00 00 03 00 01 00 00 00 02
00 00 00 04""",
        _execute(9, 0, _CHANGE_MODE, i4(2)),
        True,
    ),
    Dump(
        "Show packets (1)",
        "ReceiveData",
        "01 10 00 00 00 09 00 00 00 00 00 00 00 00 00 04",
        reply(9, 0),
        False,
    ),
    Dump(
        "Show packets (2)",
        "SendData",
        """\
01 5C 00 00 00 0A 00 00 00 40 00 00 00 03 00 0A
00 00 00 03 00 01 00 00 00 01 00 00 00 18 00 00
00 08 00 01 00 00 00 0E 00 00 00 73 00 6C 00 76
00 4D 00 6F 00 76 00 85 00 1E 00 00 00 04 20 06
00 00 00 03 C3 46 41 BF 71 71 42 FE 0E 8D 41 E0
41 0F 42 81 6C A3 41 1F 97 BF 41 04""",
        _execute(10, 0, _MOVE, _TESTER_WAY),
        True,
    ),
    Dump(
        "Show packets (2)",
        "ReceiveData",
        """\
01 3A 00 00 00 0A 00 00 00 00 00 00 00 01 00 26
00 00 00 04 20 08 00 00 00 00 C3 46 41 60 71 71
42 40 0E 8D 41 E0 41 0F 42 80 6C A3 41 56 95 BF
41 00 00 00 00 00 00 00 00 04""",
        reply(10, 0, _TESTER_HERE),
        False,
    ),
)


def exchanges() -> bytes:
    """Return the document's exchanges as they must have been; each page is a client of its own port."""
    pairs = (
        (DUMPS[0].frame, reply(5, 0)),
        (DUMPS[2].frame, DUMPS[3].frame),
        (DUMPS[4].frame, None),
        (DUMPS[5].frame, DUMPS[6].frame),
        (DUMPS[13].frame, DUMPS[14].frame),
        (DUMPS[15].frame, DUMPS[16].frame),
    )
    ports = (50001, 50002, 50003, 50004, 50005, 50005)
    packets = []
    for index, (port, (asked, answered)) in enumerate(zip(ports, pairs, strict=True)):
        network = Datagrams(CLIENT._replace(port=port))
        at = START + index * SECOND
        network.up(at, asked)
        if answered is not None:
            network.down(at + 1200 * US, answered)
        packets += network.packets
    return pcap(packets)


def retry_story() -> bytes:
    """Return the document's retry sequence with the times between that its time-out of 2 ms gives."""
    first, retry_1, retry_2, retry_3, late, accepted = (dump.frame for dump in DUMPS[7:13])
    network = Datagrams()
    network.up(START, first, "a new set point, serial 1232")
    network.up(START + 2010 * US, retry_1, "no answer within 2 ms: retry, serial 1233")
    network.up(START + 4030 * US, retry_2, "retry, serial 1234")
    network.up(START + 6040 * US, retry_3, "retry, serial 1235")
    network.down(
        START + 6420 * US, late, "answers serial 1233, which is no longer the last one sent: discarded"
    )
    network.down(START + 7240 * US, accepted, "answers the last one sent: accepted")
    return pcapng(network.packets, [Interface("eth0")], "one set point, three retries, a late reply")


def damaged_dumps() -> bytes:
    """Return every dump as printed, each as a datagram."""
    network = Datagrams()
    for index, dump in enumerate(DUMPS):
        send = network.up if dump.client else network.down
        send(START + index * 100 * MS, bytes.fromhex(dump.printed))
    return pcap(network.packets, big_endian=True)


def damaged_text() -> bytes:
    """Return every dump as printed, under its page and its caption."""
    page = ""
    lines = ["Hex of How to use the Slave mode/b-CAP, DENSO Wave, 2009, as printed there"]
    for dump in DUMPS:
        if dump.page != page:
            page = dump.page
            lines += ["", page]
        lines += ["", dump.caption, dump.printed]
    return ("\n".join(lines) + "\n").encode()
