"""Read the classic capture file of libpcap: a header of 24 bytes, then records (draft-ietf-opsawg-pcap)."""

from __future__ import annotations

import struct
from collections.abc import Iterator

from bcapscope.capture.byte_source import ByteSource
from bcapscope.capture.packet import Interface, Packet
from bcapscope.errors import CaptureError
from bcapscope.messages import Message
from bcapscope.messages.message import PlaceValue

MAGICS = {
    b"\xd4\xc3\xb2\xa1": ("<", 1000),
    b"\xa1\xb2\xc3\xd4": (">", 1000),
    b"\x4d\x3c\xb2\xa1": ("<", 1),
    b"\xa1\xb2\x3c\x4d": (">", 1),
}
"""For each magic number of a pcap file: the byte order, and the resolution of packet times in ns."""

RECORD_LIMIT = 256 * 1024
"""Largest packet in bytes, as in libpcap for every link type with IP (pcap-int.h, MAXIMUM_SNAPLEN)."""

_HEADER_SIZE = 24
_RECORD_HEADER_SIZE = 16
_LINKTYPE = 0x03FFFFFF  # higher bits hold the length of a frame check sequence (pcap-common.c)


def read_pcap(source: ByteSource) -> Iterator[Packet]:
    """Yield the packets of a capture that begins with one of `MAGICS`. Raises CaptureError if a packet is
    incomplete or has more than `RECORD_LIMIT` bytes.
    """
    if not source.ensure_bytes(_HEADER_SIZE):
        raise CaptureError(Message("capture.cut-header", length=len(source.data)), 0)
    order, scale = MAGICS[source.data[:4]]
    (linktype,) = struct.unpack_from(order + "I", source.data, 20)
    interface = Interface(linktype & _LINKTYPE)
    unpack = struct.Struct(order + "IIII").unpack_from
    comments = ()
    position, count, data = _HEADER_SIZE, 0, source.data
    while True:
        end = len(data)
        while position + _RECORD_HEADER_SIZE <= end:
            seconds, fraction, kept, original = unpack(data, position)
            start = position + _RECORD_HEADER_SIZE
            stop = start + kept
            if stop > end or kept > RECORD_LIMIT:
                if kept > RECORD_LIMIT:
                    reason = Message("capture.packet-too-large", length=kept, limit=RECORD_LIMIT)
                    raise _record_error(
                        "capture.damaged.packet", count, source.offset + position, reason=reason
                    )
                break
            count += 1
            position = stop
            yield seconds * 1_000_000_000 + fraction * scale, data[start:stop], original, interface, comments
        if not source.advance(position):
            break
        position, data = 0, source.data
    if source.data:
        raise _record_error("capture.cut-packet", count, source.offset, length=len(source.data))


def _record_error(id: str, count: int, offset: int, **places: PlaceValue) -> CaptureError:
    return CaptureError(Message(id, packet=count + 1, offset=offset, **places), offset)
