# SPDX-License-Identifier: GPL-2.0-or-later
"""b-CAP as a layer of scapy: `BCAP` dissects and builds frames with the codec of bcapscope.

No field of a frame distinguishes a request from a reply. `BCAP` identifies the controller by port 5007. If
both ports or neither port is 5007, `BCAP` treats a frame with a function number as a request.
"""

from __future__ import annotations

import re
import struct
from collections.abc import Callable, Iterable, Iterator, Sequence
from itertools import pairwise, zip_longest
from typing import Any, ClassVar

from scapy.config import conf
from scapy.fields import (
    ConditionalField,
    FieldLenField,
    LEIntEnumField,
    LEShortField,
    RawVal,
    StrField,
    XByteField,
)
from scapy.layers.inet import TCP, UDP
from scapy.packet import Packet, Raw, bind_bottom_up, bind_layers

from bcapscope.errors import InputError, LocalProtocolError
from bcapscope.messages import Message
from bcapscope.messages.message import foreign_text
from bcapscope.protocol.codec.frame import (
    EOT,
    HEADER_SIZE,
    SMALLEST_FRAME,
    SOH,
    Frame,
    Framing,
    parse_datagram,
)
from bcapscope.protocol.codec.stream_splitter import LARGEST_UNCONFIRMED, StreamSplitter
from bcapscope.protocol.codec.variant import VT, Variant, encode_argument, vt_name
from bcapscope.protocol.tables.command_catalogue import command_name
from bcapscope.protocol.tables.function_table import FUNCTIONS, ID, Function, function_by_name, function_name
from bcapscope.protocol.tables.hresult import CODE_BY_NAME, S_EXECUTING, hresult_name
from bcapscope.protocol.variant_values import argument_of, variant_of
from bcapscope.traffic.filter.tokens import with_nearest

__all__ = ["BCAP"]

PORT = 5007

_HEADER = struct.Struct("<BIHHIH")

_MAX_LAYERS = 64
"""Maximum number of layers from one TCP segment; the rest of the segment becomes one raw layer. scapy builds
and copies layers by recursion, and a segment of 64 KiB can hold 4096 frames."""

_UNKNOWN_FUNCTION = re.compile(r"Unknown\((-?\d{1,10})\)", re.ASCII)  # as `function_name` writes


def _function_id(name: str) -> int:
    function = function_by_name(name)
    if function is not None:
        return function.id
    if (unknown := _UNKNOWN_FUNCTION.fullmatch(name)) is not None:
        return int(unknown[1]) & 0xFFFFFFFF
    raise InputError(with_nearest(Message("frame.no-such-function", name=ascii(name)), name, ID))


def _result_code(name: str) -> int:
    code = CODE_BY_NAME.get(name.upper())
    if code is None:
        raise InputError(with_nearest(Message("filter.no-such-code", name=ascii(name)), name, CODE_BY_NAME))
    return code


class _CodeField(LEIntEnumField):  # type: ignore[misc] # mypy skips scapy
    """A number that has a name: the function of a request, or the result code of a reply."""

    __slots__ = ("_find", "_name_of")

    def __init__(
        self, name: str, default: int, find: Callable[[str], int], name_of: Callable[[int], str]
    ) -> None:
        """`find` returns the number of a name, and raises InputError for an unknown name."""
        self._find = find
        self._name_of = name_of
        super().__init__(name, default, {})

    def any2i_one(self, pkt: Packet | None, x: Any) -> Any:
        if isinstance(x, str):
            return self._find(x)
        return x & 0xFFFFFFFF if isinstance(x, int) and -(2**31) <= x < 0 else x

    def i2repr_one(self, pkt: Packet | None, x: Any) -> str:
        """Return the name of the function or result code. Return "None" if the frame has no such field: a
        reply has no function, and a request has no result code.
        """
        if isinstance(pkt, BCAP) and pkt.is_response is not (self.name == "hresult"):
            return "None"
        return self._name_of(x) if isinstance(x, int) else repr(x)

    def i2h(self, pkt: Packet | None, x: Any) -> Any:
        if isinstance(x, list):
            return [self.i2h(pkt, each) for each in x]
        return self._name_of(x) if isinstance(x, int) and self.name == "function" else x


class _ReadArguments(list[Variant]):
    """The arguments of a dissected frame, with their bytes. scapy builds the arguments from these bytes.

    `encode_argument` cannot restore the bytes of damaged arguments.
    """

    def __init__(self, variants: Iterable[Variant], raw: bytes) -> None:
        super().__init__(variants)
        self.raw = raw


class _ArgumentsField(StrField):  # type: ignore[misc] # as above
    """The field `args`: programs set Python values or `Variant` objects, and read `Variant` objects."""

    islist = 1

    def any2i(self, pkt: Packet | None, x: Any) -> Any:
        # The result is a list, because scapy treats a tuple of two or three numbers as a range of numbers.
        values = list(x) if isinstance(x, list | tuple) and not isinstance(x, Variant) else [x]
        for value in values:
            variant_of(value)  # `variant_of` raises an exception for a value without a type
        return values

    def i2h(self, pkt: Packet | None, x: Any) -> Any:
        """Give each argument the type that the function requires. If a value does not fit, `variant_of`
        chooses the type."""
        return x if isinstance(x, RawVal) else tuple(_typed(pkt, x, is_strict=False))

    def do_copy(self, x: Any) -> Any:
        return x if isinstance(x, _ReadArguments) else super().do_copy(x)  # nothing changes it

    def i2m(self, pkt: Packet | None, x: Any) -> bytes:
        if isinstance(x, _ReadArguments):
            return x.raw
        return b"".join(map(encode_argument, _typed(pkt, x or (), is_strict=True)))

    def i2len(self, pkt: Packet | None, x: Any) -> int:
        return len(x if isinstance(x, RawVal) else self.i2m(pkt, x))

    def i2count(self, pkt: Packet | None, x: Any) -> int:
        return 1 if isinstance(x, RawVal) else len(x or ())

    def i2repr(self, pkt: Packet | None, x: Any) -> str:
        """Return arguments as text with names and types. Non-ASCII and control characters are escaped."""
        if isinstance(x, RawVal):
            return repr(x)
        variants = self.i2h(pkt, x or ())
        function = _function_of(pkt)
        params = function.params[: len(variants)] if function is not None else ()
        shown = (
            _shown(variant) if param is None else f"{param.name}: {_shown(variant)}"
            for variant, param in zip_longest(variants, params)
        )
        return f"[{', '.join(shown)}]"


class BCAP(Packet):  # type: ignore[misc] # as above
    """One b-CAP frame.

    Requests have the field `function`, replies have `hresult`. If you set `function`, the frame becomes a
    request; if you set `hresult`, the frame becomes a reply. An unchanged frame keeps its bytes, even if they
    are damaged. The arguments keep their bytes until you set `args`.

    Attributes:
        soh, eot: First and last byte.
        length, argc: Size in bytes, and number of arguments. When you build a frame, None means that scapy
            computes the value.
        serial, reserved: Numbers of the header.
        function: Name of the function of a request. You can set `function` to a name or a number.
        hresult: Result code of a reply, unsigned. You can set `hresult` to a name or a number.
        args: Tuple of arguments, which are `Variant` objects. You can set `args` to a list of Python values
            or `Variant` objects.
        trailer: Bytes between the arguments and EOT, such as the CRC of a serial line or the mode of a
            version 1 frame.
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
            _CodeField("function", 1, _function_id, function_name),
            lambda packet: not packet.is_response,
        ),
        ConditionalField(
            _CodeField("hresult", 0, _result_code, hresult_name),
            lambda packet: packet.is_response,
        ),
        FieldLenField("argc", None, fmt="<H", count_of="args"),
        _ArgumentsField("args", ()),
        StrField("trailer", b""),
        XByteField("eot", EOT),
    ]
    deprecated_fields = {"function_id": ("function", "0.2")}  # noqa: RUF012 - scapy declares no ClassVar

    @classmethod
    def dispatch_hook(cls, _pkt: bytes | None = None, *_: Any, **__: Any) -> Any:
        if _pkt is None or (_pkt[:1] == bytes((SOH,)) and len(_pkt) >= HEADER_SIZE):
            return cls
        return conf.raw_layer

    @classmethod
    def tcp_reassemble(cls, data: bytes, metadata: dict[str, Any], session: dict[str, Any]) -> Packet | None:
        """Return complete frames as layers, and an incomplete frame after them as padding.

        Bytes that are not a frame become a raw layer. Return None if more bytes are needed. For scapy's
        `TCPSession`, return all complete frames, but at most `_MAX_LAYERS` of them as layers. With one frame
        per packet, `TCPSession` of scapy 2.8 would lose track of a stream if an unfinished frame follows two
        frames. For a scapy socket, return only one frame, so that scapy's `sr1` can identify a reply.
        """
        packet = metadata.get("original")
        size = 0 if packet is not None else _whole_frame_size(data)
        if size:
            return _with_payloads([cls(data[:size])], data[size:])
        pieces = StreamSplitter().feed(data)
        if not pieces:
            return None
        split = pieces[: 1 if packet is None else _MAX_LAYERS]
        tcp = None if packet is None else packet.getlayer(TCP)
        layers = [
            cls(piece.item.raw, _underlayer=tcp)
            if isinstance(piece.item, Frame)
            else conf.raw_layer(piece.item.raw)
            for piece in split
        ]
        stop = split[-1].stop
        if packet is not None and stop < pieces[-1].stop:
            layers.append(conf.raw_layer(data[stop : pieces[-1].stop]))
            stop = pieces[-1].stop
        return _with_payloads(layers, data[stop:])

    @property
    def is_response(self) -> bool:
        """Whether the frame is a reply. The notice S_EXECUTING is also a reply."""
        if "hresult" in self.fields or "function" in self.fields:
            return "hresult" in self.fields
        return self._is_from_controller() is True

    def _is_from_controller(self) -> bool | None:
        """Return whether the controller sent the frame, or None if the ports do not show the sender."""
        ports = (getattr(self.underlayer, "sport", None), getattr(self.underlayer, "dport", None))
        return ports[0] == PORT if ports.count(PORT) == 1 else None

    @property
    def function_id(self) -> int | None:
        """The number of the function; None in a reply."""
        number: int | None = None if self.is_response else self.getfieldval("function")
        return number

    @property
    def command_name(self) -> str | None:
        """The command of an ..._Execute request, such as `slvMove`; None for all other frames."""
        function_id = self.function_id
        return None if function_id is None else command_name(function_id, self.args) or None

    @property
    def retry_of(self) -> int | None:
        """Serial of an earlier attempt, if the frame is a retry; None for all other frames."""
        if (
            self.is_response
            or self.reserved in (0, self.serial)
            or isinstance(self.underlayer, TCP | BCAP | Raw)
        ):
            return None
        is_version_1 = self.frame.framing in (Framing.VERSION_1, Framing.VERSION_1_ZLIB)
        return None if is_version_1 else self.reserved

    @property
    def frame(self) -> Frame:
        """The frame, as `bcapscope.decode` returns it; its attribute `problems` describes any damage."""
        return Frame(self.self_build())

    def do_dissect(self, s: bytes) -> bytes:
        frame = parse_datagram(s)[0]
        assert isinstance(frame, Frame)  # by `dispatch_hook`
        size = len(frame.raw)
        soh, length, serial, reserved, _, _ = _HEADER.unpack_from(s)
        from_controller = self._is_from_controller()
        is_reply = frame.code not in FUNCTIONS if from_controller is None else from_controller
        code_name = "hresult" if is_reply else "function"
        arguments = frame.arguments
        self.fields.update(soh=soh, length=length, serial=serial, reserved=reserved, argc=frame.argc)
        self.fields[code_name] = frame.code
        stop = arguments[-1].stop if arguments else HEADER_SIZE
        # In a frame that is cut off, the last byte is both `eot` and part of an argument.
        self.fields["args"] = _ReadArguments(frame.variants, frame.body[HEADER_SIZE:-1][: stop - HEADER_SIZE])
        self.fields["trailer"] = s[stop : size - 1]
        # scapy builds the frame without compression if you change a field
        if frame.framing is Framing.VERSION_1_ZLIB:
            self.fields.update(length=None, trailer=b"\0")
        if size > HEADER_SIZE:
            self.fields["eot"] = s[size - 1]
        self.raw_packet_cache_fields: dict[str, Any] = {}
        self.raw_packet_cache = frame.raw
        self.explicit = 1
        return s[size:]

    def extract_padding(self, s: bytes) -> tuple[bytes, bytes]:
        """Return all bytes as padding, since a frame has no payload."""
        return b"", s

    def setfieldval(self, attr: str, val: Any) -> None:
        """Setting `function` makes the frame a request. Setting `hresult` makes the frame a reply."""
        super().setfieldval(attr, val)
        if attr in ("function", "function_id"):
            self.fields.pop("hresult", None)
        elif attr == "hresult":
            self.fields.pop("function", None)

    def hide_defaults(self) -> None:
        kept = {name: self.fields[name] for name in ("function", "hresult") if name in self.fields}
        super().hide_defaults()
        self.fields.update(kept)

    def self_build(self) -> bytes:
        """Raises LocalProtocolError if a value does not fit its field."""
        if self.raw_packet_cache is None:
            args = self.getfieldval("args")
            self.get_field("args").i2len(self, args)  # scapy cannot pass on an exception of bcapscope
        try:
            raw: bytes = super().self_build()
        except ValueError as error:
            raise LocalProtocolError(foreign_text(str(error))) from error
        return raw

    def hashret(self) -> bytes:
        """Return the serial, by which scapy finds the reply to a request."""
        return struct.pack("<H", self.serial)

    def answers(self, other: Packet) -> bool:
        """Return whether this frame is a reply to the request `other`, but not the notice S_EXECUTING."""
        if not isinstance(other, BCAP) or not self.is_response or other.is_response:
            return False
        return bool(self.serial == other.serial and self.hresult != S_EXECUTING)

    def mysummary(self) -> str:
        if self.is_response:
            text = f"b-CAP {hresult_name(self.hresult)} serial {self.serial}"
        else:
            command = self.command_name
            what = self.function if command is None else f"{self.function} {command!a}"
            text = f"b-CAP {what} serial {self.serial}"
            text += "" if self.retry_of is None else f" retry of {self.retry_of}"
        is_damaged = self.raw_packet_cache is not None and bool(self.frame.problems)
        return f"{text} [damaged]" if is_damaged else text


def _function_of(packet: Packet | None) -> Function | None:
    """Return the function of a request, or None if the packet does not have exactly one known function."""
    function_id = packet.function_id if isinstance(packet, BCAP) else None
    return FUNCTIONS.get(function_id) if isinstance(function_id, int) else None


def _typed(packet: Packet | None, values: Sequence[object], *, is_strict: bool) -> Iterator[Variant]:
    """Give each value the type that the function requires. Raise LocalProtocolError only if `is_strict`."""
    function = _function_of(packet)
    params = () if function is None else function.params[: len(values)]
    for value, param in zip_longest(values, params):
        try:
            yield variant_of(value) if not function or not param else argument_of(function, param, value)
        except LocalProtocolError:
            if is_strict:
                raise
            yield variant_of(value)


def _whole_frame_size(data: bytes) -> int:
    """Return the size of a complete frame of at most 64 KiB at the start of `data`, or 0 for other data."""
    length = int.from_bytes(data[1:5], "little")
    is_whole = SMALLEST_FRAME <= length <= min(len(data), LARGEST_UNCONFIRMED)
    return length if is_whole and data[0] == SOH and data[length - 1] == EOT else 0


def _with_payloads(layers: list[Packet], padding: bytes) -> Packet:
    if padding:
        layers.append(conf.padding_layer(padding))
    for outer, inner in reversed(list(pairwise(layers))):
        outer.add_payload(inner)
    return layers[0]


def _shown(variant: Variant) -> str:
    if variant.vt in (VT.EMPTY, VT.NULL):
        return vt_name(variant.vt)
    values = variant.value
    if isinstance(values, tuple):
        items = (_shown(each) if isinstance(each, Variant) else ascii(each) for each in values)
        return f"{vt_name(variant.vt)} ({', '.join(items)})"
    return f"{vt_name(variant.vt)} {values!a}"


for _transport in (UDP, TCP):
    bind_bottom_up(_transport, BCAP, sport=PORT)
    bind_bottom_up(_transport, BCAP, dport=PORT)
    bind_layers(_transport, BCAP, sport=PORT, dport=PORT)
