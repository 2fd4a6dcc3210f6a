"""A captured packet, and the interface on which the packet was captured."""

from __future__ import annotations

from typing import NamedTuple, TypeAlias


class Interface(NamedTuple):
    """The interface on which packets were captured.

    Attributes:
        linktype: Type of the packets' link header, a number of the LINKTYPE_ list that pcap and pcapng share
            (draft-ietf-opsawg-pcaplinktype).
        name: Name of the interface in the capture; "" if the capture names no interface.
    """

    linktype: int
    name: str = ""


Packet: TypeAlias = tuple[int, bytes, int, Interface, tuple[str, ...]]
"""A packet: time in ns since 1970-01-01 UTC; captured bytes; size on the wire in bytes; interface; comments.
A packet is a plain tuple because captures hold millions of packets. Creating a named tuple would take longer
than reading the packet.
"""


class PacketOrigin(NamedTuple):
    """The capture that holds a packet, and the packet's number there.

    Attributes:
        path: Path of the capture, as it was given.
        name: Name of the capture that users see: the file name, or `path` if another capture has the same
            file name.
        packet: Number of the packet in the capture, from 1.
    """

    path: str
    name: str
    packet: int
