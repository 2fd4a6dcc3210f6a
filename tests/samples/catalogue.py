"""The captures that ship with the project: what each shows, where it is from, how it is made."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

from tests.samples import guide, slave, tcp, trouble, ways

_GUIDE = "DENSO Wave 2009, How to use the Slave mode/b-CAP"
_OWN = "made up"

_HEAD = """\
# Sample captures and trajectories

One scenario each. All are made by `python -m tests.samples`, this page too, and a test holds them to it: the
same code gives the same bytes. None was recorded in a plant. Frames and values of the guide (DENSO Wave 2009,
*How to use the Slave mode/b-CAP*) are its own; addresses, ports and times never are.

| File | Shows | Form | Origin |
|---|---|---|---|
"""


class Sample(NamedTuple):
    """A file in `captures/`.

    Attributes:
        name: of the file.
        shows: what a reader finds in it.
        form: file format and what carries the frames.
        origin: where the traffic is from.
        make: returns its bytes.
    """

    name: str
    shows: str
    form: str
    origin: str
    make: Callable[[], bytes]


SAMPLES: tuple[Sample, ...] = (
    Sample(
        "slave-session.pcapng",
        "a whole slave-mode session without a fault: service, controller, robot, motor (with keep-alives), "
        "first position, formats, mode 0x202, 240 set points at 8 ms with time-stamped replies, and "
        "everything let go in order",
        "pcapng, ns, named interface, comments; UDP",
        f"{_OWN} after the order of calls in DENSO's samples for the RC8; numbered as by DENSO's C library",
        slave.slave_session,
    ),
    Sample(
        "exchanges.pcap",
        "slvChangeMode, slvGetMode, slvMove (no answer printed) and a set point of 2009, then the two calls "
        "of the b-CAP Tester",
        "pcap, µs; UDP, one client port a page",
        f"{_GUIDE}, the function references, Retry sequence (3) and Show packets (1), (2); lost, surplus and "
        "misread bytes put right, the reply to slvChangeMode given the serial of its request",
        guide.exchanges,
    ),
    Sample(
        "retry-story.pcapng",
        "one set point sent four times: the reply to the first retry comes late and is discarded, the reply "
        "to the third is accepted",
        "pcapng, ns, a comment on each packet; UDP",
        f"{_GUIDE}, Retry sequence (2) and (3), damaged bytes put right",
        guide.retry_story,
    ),
    Sample(
        "damaged-dumps.txt",
        "hex that lost bytes on its way through a document, for `bcapscope decode --text`",
        "text",
        f"{_GUIDE}, every dump of a packet as printed",
        guide.damaged_text,
    ),
    Sample(
        "damaged-dumps.pcap",
        "the same bytes as datagrams",
        "pcap, µs, big-endian; UDP",
        f"{_GUIDE}, every dump of a packet as printed",
        guide.damaged_dumps,
    ),
    Sample(
        "tcp-segments.pcap",
        "frames that TCP cut in their header, cut in three with a segment sent twice, glued and swapped; "
        "sequence numbers wrap; nothing is missing",
        "pcap, ns; TCP",
        f"{_OWN}; numbered as by DENSO's Python library",
        tcp.segments,
    ),
    Sample(
        "tcp-gap.pcap",
        "a capture that begins in the middle of a frame, misses a segment of a long reply and ends with a "
        "reply cut off by a reset",
        "pcap, µs; TCP",
        _OWN,
        tcp.gap,
    ),
    Sample(
        "slave-mode-lost.pcapng",
        "a client that pauses for 64 ms while the robot moves: the controller leaves slave mode "
        "(0x84201482), everything after that is refused",
        "pcapng, ns, comments; UDP",
        f"{_OWN} after what users report",
        trouble.slave_mode_lost,
    ),
    Sample(
        "two-robots.pcapng",
        "two controllers on two interfaces, one numbered from 0 in reserved, one with its own serial there, "
        "which wraps from 65535 to 1",
        "pcapng, interfaces of µs and ns, Ethernet and Linux cooked v2; UDP over IPv4 and IPv6",
        _OWN,
        trouble.two_robots,
    ),
    Sample(
        "vlan-ipv6.pcap",
        "variables written and read (Japanese text, an emoji) in two VLAN tags, among packets of ARP, DNS "
        "and NTP",
        "pcap, ns; TCP over IPv6, two VLANs",
        _OWN,
        trouble.vlan_ipv6,
    ),
    Sample(
        "malformed.pcapng",
        "strings that attack a terminal, a browser or a spreadsheet, and frames with one fault each, told in "
        "the packet's comment",
        "pcapng, ns, a comment on each packet; UDP",
        _OWN,
        trouble.malformed,
    ),
    Sample(
        "swing-joints.csv",
        "joints that swing out and back in 4 s, from where the simulator's arm stands at first; begins and "
        "ends at rest, within its limits",
        "CSV as of `bcapscope extract`, 8 ms",
        _OWN,
        ways.joints,
    ),
    Sample(
        "half-circle-positions.csv",
        "positions on half a circle, there and back in 4 s, within the simulator's limits, away from where "
        "its arm stands at first",
        "CSV as of `bcapscope extract`, 8 ms",
        _OWN,
        ways.positions,
    ),
    Sample(
        "control-log.csv",
        "the swing at double speed as a controller would log it, set points and encoder values",
        "CSV of a control log, Shift-JIS, 39 columns, a counter in ms",
        f"{_OWN} with the titles of ShoheiKobata/orin_bcap_python_samples others/Get_Syslog.py",
        ways.control_log,
    ),
    Sample(
        "joint-trajectory.yaml",
        "five way-points in radians, joints listed in another order, not evenly timed: to be resampled",
        "JointTrajectory of ROS 2 as YAML",
        _OWN,
        ways.joint_trajectory,
    ),
)


def index() -> str:
    """Return the page that tells the origin of each capture."""
    rows = (f"| `{name}` | {shows} | {form} | {origin} |" for name, shows, form, origin, _ in SAMPLES)
    return _HEAD + "\n".join(rows) + "\n"


def files() -> dict[str, bytes]:
    """Return everything that `captures/` holds, by name."""
    made = {sample.name: sample.make() for sample in SAMPLES}
    return {**made, "README.md": index().encode()}
