"""A captured packet, and the interface it was captured on."""

from __future__ import annotations

from typing import NamedTuple, TypeAlias


class Interface(NamedTuple):
    """The interface on which packets were captured.

    Attributes:
        linktype: Type of the packets' link header, a number of the LINKTYPE_ list that pcap and pcapng share
            (draft-ietf-opsawg-pcaplinktype).
        name: Name in the capture; "" where the capture has none.
    """

    linktype: int
    name: str = ""


Packet: TypeAlias = tuple[int, bytes, int, Interface, tuple[str, ...]]
"""Time in ns since 1970-01-01 UTC; captured bytes; size on the wire in bytes; interface; comments.

It is a plain tuple because captures hold millions of packets. A named tuple costs more to create than the
rest of reading a packet."""
