# SPDX-License-Identifier: GPL-2.0-or-later
# scapy.contrib.description = b-CAP (DENSO robot controllers)
# scapy.contrib.status = loads
"""b-CAP as a scapy layer, based on the codec of bcapscope.

    >>> from bcapscope.capture.layer import BCAP
    >>> sniff(offline="session.pcap", session=TCPSession, prn=lambda p: p[BCAP].summary())
    >>> sr1(IP(dst="192.168.0.1") / UDP() / BCAP(serial=1, function_id=1, args=[""]))

No field of a frame distinguishes a request from a reply; only the port does. Without a port, a frame whose
code is a function id counts as a request.
"""

from __future__ import annotations

import struct
from typing import Any, ClassVar

from scapy.config import conf
from scapy.fields import (
    ConditionalField,
    FieldLenField,
    LEIntEnumField,
    LEShortField,
    StrField,
    XByteField,
    XLEIntField,
)
from scapy.layers.inet import TCP, UDP
from scapy.packet import Packet, bind_bottom_up, bind_layers

from bcapscope.protocol.codec.frame import (
    EOT,
    HEADER_SIZE,
    LARGEST_FRAME,
    SMALLEST_FRAME,
    SOH,
    Frame,
    Framing,
)
from bcapscope.protocol.codec.variant import EMPTY, VT, Variant, encode_argument
from bcapscope.protocol.tables.function_table import FUNCTIONS, function_name
from bcapscope.protocol.tables.hresult import S_EXECUTING, hresult_name

PORT = 5007

_HEADER = struct.Struct("<BIHHIH")


_TYPES = {bool: VT.BOOL, int: VT.I4, float: VT.R8, str: VT.BSTR}


def _as_variant(value: Any) -> Variant:
    if isinstance(value, Variant):
        return value
    if value is None:
        return EMPTY
    if isinstance(value, bytes):
        return Variant.array(VT.UI1, value)
    vt = _TYPES.get(type(value))
    if vt is None:
        raise ValueError(f"{value!r}: give a Variant, None, or a bool, int, float, str or bytes")
    return Variant(vt, value)


class ArgumentsField(StrField):  # type: ignore[misc] # scapy's classes have no types here
    """The arguments of a frame as a tuple of `Variant`.

    You may set Python values. Python values get the types that DENSO's Python client sends: an int becomes
    I4, a float R8, a str BSTR, bytes an array of UI1, a bool BOOL, and None EMPTY.
    """

    islist = 1

    def any2i(self, pkt: Packet | None, x: Any) -> Any:
        values = x if isinstance(x, (list, tuple)) and not isinstance(x, Variant) else (x,)
        return tuple(map(_as_variant, values))

    def i2m(self, pkt: Packet | None, x: Any) -> bytes:
        return b"".join(map(encode_argument, x or ()))

    def i2len(self, pkt: Packet | None, x: Any) -> int:
        return len(self.i2m(pkt, x))

    def i2count(self, pkt: Packet | None, x: Any) -> int:
        return len(x or ())

    def i2repr(self, pkt: Packet | None, x: Any) -> str:
        """Return the arguments as text with non-ASCII and control characters escaped."""
        return ascii(list(x or ()))


class BCAP(Packet):  # type: ignore[misc] # as above
    """One b-CAP frame.

    A request has the field `function_id`; a reply has `hresult`. If you set `function_id`, the frame becomes
    a request; if you set `hresult`, it becomes a reply. `trailer` holds the bytes between the arguments and
    EOT. The trailer is the CRC of a serial line, the mode of a version 1 frame, or bytes that belong to no
    argument. An unchanged frame keeps its original bytes.
    """

    name = "b-CAP"
    fields_desc: ClassVar[list[Any]] = [
        XByteField("soh", SOH),
        FieldLenField(
            "length",
            None,
            fmt="<I",
            length_of="args",
            adjust=lambda packet, size: size + SMALLEST_FRAME + len(packet.trailer),
        ),
        LEShortField("serial", 1),
        LEShortField("reserved", 0),
        ConditionalField(
            LEIntEnumField("function_id", 1, {id_: function.name for id_, function in FUNCTIONS.items()}),
            lambda packet: not packet.is_response,
        ),
        ConditionalField(XLEIntField("hresult", 0), lambda packet: packet.is_response),
        FieldLenField("argc", None, fmt="<H", count_of="args"),
        ArgumentsField("args", ()),
        StrField("trailer", b""),
        XByteField("eot", EOT),
    ]

    @classmethod
    def dispatch_hook(cls, _pkt: bytes | None = None, *_: Any, **__: Any) -> Any:
        """Select this layer for bytes that begin like a frame, and scapy's raw layer for all other bytes."""
        if _pkt is None or (_pkt[:1] == bytes((SOH,)) and len(_pkt) >= HEADER_SIZE):
            return cls
        return conf.raw_layer

    @classmethod
    def tcp_reassemble(cls, data: bytes, metadata: dict[str, Any], session: dict[str, Any]) -> Packet | None:
        """Return the first frame of a stream, with the remaining bytes as padding; None while the frame is
        incomplete.

        scapy passes the padding to this method again. Bytes outside any frame become a raw layer.
        """
        garbage = _garbage_size(data)
        if garbage:
            found = conf.raw_layer(data[:garbage])
            return found / conf.padding_layer(data[garbage:]) if garbage < len(data) else found
        length = int.from_bytes(data[1:5], "little")
        if len(data) < max(length, 5):
            if len(data) >= 5:
                metadata["tcp_min_len"] = length
            return None
        packet = metadata.get("original")
        return cls(data, _underlayer=packet[TCP] if packet is not None and TCP in packet else None)

    @property
    def is_response(self) -> bool:
        if "hresult" in self.fields or "function_id" in self.fields:
            return "hresult" in self.fields
        ports = (getattr(self.underlayer, "sport", None), getattr(self.underlayer, "dport", None))
        if ports.count(PORT) == 1:
            return ports[0] == PORT
        code = self.original[9:HEADER_SIZE]
        return len(code) == HEADER_SIZE - 9 and int.from_bytes(code[:4], "little") not in FUNCTIONS

    @property
    def function_name(self) -> str | None:
        """The vendor's name of the function; None in a reply."""
        return None if self.is_response else function_name(self.function_id)

    @property
    def command_name(self) -> str | None:
        """The command of a request such as `Robot_Execute`, for example `slvMove`; None for all other
        frames.
        """
        if self.is_response or self.function_id not in FUNCTIONS:
            return None
        params = FUNCTIONS[self.function_id].params
        for param, variant in zip(params, self.args, strict=False):
            if param.name == "bstrCommand" and variant.vt == VT.BSTR:
                return str(variant.value)
        return None

    @property
    def frame(self) -> Frame:
        return Frame(self.self_build())

    def do_dissect(self, s: bytes) -> bytes:
        """Parse the frame at the beginning of `s` and return the bytes after it."""
        length = int.from_bytes(s[1:5], "little")
        size = length if HEADER_SIZE < length <= len(s) else len(s)
        frame = Frame(s[:size])
        code_name = "hresult" if self.is_response else "function_id"
        names = ("soh", "length", "serial", "reserved", code_name, "argc")
        self.fields.update(zip(names, _HEADER.unpack_from(s), strict=True))
        arguments = frame.arguments
        stop = (
            arguments[-1].stop if arguments and frame.framing is not Framing.VERSION_1_ZLIB else HEADER_SIZE
        )
        self.fields["args"] = tuple(argument.variant for argument in arguments)
        self.fields["trailer"] = s[stop : size - 1]
        if size > HEADER_SIZE:
            self.fields["eot"] = s[size - 1]
        self.raw_packet_cache_fields: dict[str, Any] = {}
        self.raw_packet_cache = s[:size]
        self.explicit = 1
        return s[size:]

    def extract_padding(self, s: bytes) -> tuple[bytes, bytes]:
        """Return all bytes after the frame as padding. A frame has no payload, but another frame may
        follow.
        """
        return b"", s

    def hashret(self) -> bytes:
        """Return the serial as bytes. scapy compares these bytes to find the reply to a request."""
        return struct.pack("<H", self.serial)

    def answers(self, other: Packet) -> bool:
        """Return whether this frame is the reply to the request `other`.

        A notice (S_EXECUTING) is not a reply.
        """
        if not isinstance(other, BCAP) or not self.is_response or other.is_response:
            return False
        return bool(self.serial == other.serial and self.hresult != S_EXECUTING)

    def mysummary(self) -> str:
        if self.is_response:
            return f"b-CAP {hresult_name(self.hresult)} serial {self.serial}"
        command = self.command_name
        what = self.function_name if command is None else f"{self.function_name} {command!a}"
        return f"b-CAP {what} serial {self.serial}"


def _garbage_size(data: bytes) -> int:
    """Return the number of bytes at the start of a stream that cannot belong to a frame."""
    length = int.from_bytes(data[1:5], "little")
    if data[:1] == bytes((SOH,)) and (len(data) < 5 or SMALLEST_FRAME <= length <= LARGEST_FRAME):
        return 0
    following = data.find(SOH, 1)
    return following if following > 0 else len(data)


for _transport in (UDP, TCP):
    bind_bottom_up(_transport, BCAP, sport=PORT)
    bind_bottom_up(_transport, BCAP, dport=PORT)
    bind_layers(_transport, BCAP, sport=PORT, dport=PORT)
