"""A captured packet, and the interface on which the packet was captured."""

from __future__ import annotations

from typing import NamedTuple, TypeAlias


class Interface(NamedTuple):
    """The interface on which packets were captured. `linktype` is a LINKTYPE_ number of
    draft-ietf-opsawg-pcaplinktype. `name` is "" if the capture names no interface.
    """

    linktype: int
    name: str = ""


Packet: TypeAlias = tuple[int, bytes, int, Interface, tuple[str, ...]]
"""Time in ns since 1970; captured bytes; size on the wire in bytes; interface; comments. A plain tuple,
because creating a named tuple takes longer than reading a packet.
"""


class PacketOrigin(NamedTuple):
    """The capture that holds a packet, and the packet's number there, from 1. `name` is the file name, or
    `path` if another capture has the same file name.
    """

    path: str
    name: str
    packet: int
