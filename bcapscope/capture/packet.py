"""A captured packet, and the interface it was captured on."""

from __future__ import annotations

from typing import NamedTuple, TypeAlias


class Interface(NamedTuple):
    """Where packets were captured.

    Attributes:
        linktype: what a packet begins with, a number of the LINKTYPE_ list that pcap and pcapng share
            (draft-ietf-opsawg-pcaplinktype).
        name: as the capture names it, "" where it does not.
    """

    linktype: int
    name: str = ""


Packet: TypeAlias = tuple[int, bytes, int, Interface, tuple[str, ...]]
"""Time in nanoseconds since 1970-01-01 UTC; the bytes captured; how many bytes the packet had on the
wire; the interface; comments. A bare tuple: there are millions, and a named one costs more to make than
the rest of reading it."""
