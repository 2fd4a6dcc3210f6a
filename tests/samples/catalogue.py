"""The captures of the project: what each shows, its origin, and the function that makes it."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

from tests.samples import guide, slave, tcp, trouble, ways

_GUIDE = "guide"
_OWN = "made up"

_HEAD = """\
# Sample captures and trajectories

Each file shows one situation. None was recorded in a plant. "Guide" is DENSO Wave 2009, *How to use the Slave
mode/b-CAP*. Frames and values from the guide are unchanged; addresses, ports and times are made up.

`python -m tests.samples` makes all files and this page. A test checks that the code makes the same bytes.

| File | Shows | Format | Origin |
|---|---|---|---|
"""


class Sample(NamedTuple):
    """A file in `captures/`.

    Attributes:
        name: of the file.
        shows: the situation in the file.
        form: file format and transport of the frames.
        origin: source of the traffic.
        make: returns the bytes of the file.
    """

    name: str
    shows: str
    form: str
    origin: str
    make: Callable[[], bytes]


SAMPLES: tuple[Sample, ...] = (
    Sample(
        "slave-session.pcapng",
        "a complete slave-mode session without a fault: service, controller, robot, motor (with "
        "keep-alives), first position, formats, mode 0x202, 240 set points at 8 ms with time-stamped "
        "replies, and the release of everything in order",
        "pcapng, ns, named interface, comments; UDP",
        f"{_OWN}; calls in the order of DENSO's samples for the RC8, serials as in DENSO's C library",
        slave.slave_session,
    ),
    Sample(
        "exchanges.pcap",
        "slvChangeMode, slvGetMode, slvMove (the guide prints no reply) and a set point of 2009, then the "
        "two calls of b-CAP Tester",
        "pcap, µs; UDP, one client port per page of the guide",
        f"{_GUIDE}, the function references, Retry sequence (3) and Show packets (1), (2); lost, surplus and "
        "misread bytes are corrected, and the reply to slvChangeMode has the serial of its request",
        guide.exchanges,
    ),
    Sample(
        "retry-story.pcapng",
        "one set point sent four times: the client discards the late reply to the first retry, and accepts "
        "the reply to the third",
        "pcapng, ns, a comment on each packet; UDP",
        f"{_GUIDE}, Retry sequence (2) and (3); damaged bytes are corrected",
        guide.retry_story,
    ),
    Sample(
        "damaged-dumps.txt",
        "hex that lost bytes when it was copied into a document, for `bcapscope decode --text`",
        "text",
        f"{_GUIDE}, every dump of a packet as printed",
        guide.damaged_text,
    ),
    Sample(
        "damaged-dumps.pcap",
        "the bytes of `damaged-dumps.txt` as datagrams",
        "pcap, µs, big-endian; UDP",
        f"{_GUIDE}, every dump of a packet as printed",
        guide.damaged_dumps,
    ),
    Sample(
        "tcp-segments.pcap",
        "frames in unusual TCP segments: cut inside the header, cut into three segments of which one is sent "
        "twice, several in one segment, and in the wrong order; sequence numbers wrap; no byte is missing",
        "pcap, ns; TCP",
        f"{_OWN}; serials as in DENSO's Python library",
        tcp.segments,
    ),
    Sample(
        "tcp-gap.pcap",
        "a capture that begins in the middle of a frame, lacks a segment of a long reply, and ends with a "
        "reply cut off by a reset",
        "pcap, µs; TCP",
        _OWN,
        tcp.gap,
    ),
    Sample(
        "slave-mode-lost.pcapng",
        "a client that pauses for 64 ms while the robot moves: the controller leaves slave mode "
        "(0x84201482) and refuses everything after that",
        "pcapng, ns, comments; UDP",
        f"{_OWN}, based on reports of users",
        trouble.slave_mode_lost,
    ),
    Sample(
        "two-robots.pcapng",
        "two controllers on two interfaces; the requests of one client have 0 in reserved, those of the "
        "other their own serial, which wraps from 65535 to 1",
        "pcapng, interfaces in µs and ns, Ethernet and Linux cooked v2; UDP over IPv4 and IPv6",
        _OWN,
        trouble.two_robots,
    ),
    Sample(
        "vlan-ipv6.pcap",
        "variables written and read (Japanese text, an emoji) inside two VLAN tags, among packets of ARP, "
        "DNS and NTP",
        "pcap, ns; TCP over IPv6, two VLANs",
        _OWN,
        trouble.vlan_ipv6,
    ),
    Sample(
        "malformed.pcapng",
        "strings that attack a terminal, a browser or a spreadsheet, and frames with one defect each, which "
        "the comment on the packet names",
        "pcapng, ns, a comment on each packet; UDP",
        _OWN,
        trouble.malformed,
    ),
    Sample(
        "swing-joints.csv",
        "joints that swing out and back in 4 s, from the start position of the simulator's arm and within "
        "its limits; begins and ends at rest",
        "CSV table with titles, 8 ms",
        _OWN,
        ways.joints,
    ),
    Sample(
        "half-circle-positions.csv",
        "positions on half a circle, there and back in 4 s, within the limits of the simulator's arm, away "
        "from its start position",
        "CSV table with titles, 8 ms",
        _OWN,
        ways.positions,
    ),
    Sample(
        "control-log.csv",
        "the motion of `swing-joints.csv` at double speed as a controller would log it, with set points and "
        "encoder values",
        "CSV of a control log, Shift-JIS, 39 columns, a counter in ms",
        f"{_OWN}, with the titles of ShoheiKobata/orin_bcap_python_samples others/Get_Syslog.py",
        ways.control_log,
    ),
    Sample(
        "joint-trajectory.yaml",
        "five way-points in radians with uneven times and the joints in another order; play it with "
        "`--resample`",
        "ROS 2 JointTrajectory, YAML",
        _OWN,
        ways.joint_trajectory,
    ),
)


def index() -> str:
    """Return the page that describes each file."""
    rows = (f"| `{name}` | {shows} | {form} | {origin} |" for name, shows, form, origin, _ in SAMPLES)
    return _HEAD + "\n".join(rows) + "\n"


def files() -> dict[str, bytes]:
    """Return the contents of every file in `captures/`, by name."""
    made = {sample.name: sample.make() for sample in SAMPLES}
    return {**made, "README.md": index().encode()}
