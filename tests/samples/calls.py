"""Frames in the vendor's words, and a client and a server that exchange them over UDP."""

from __future__ import annotations

from bcapscope.protocol.codec.frame import encode_frame
from bcapscope.protocol.codec.variant import VT, Variant
from bcapscope.protocol.tables.function_table import FUNCTIONS
from tests.samples.files import Packet
from tests.samples.wire import Host, ethernet, udp

START = 1_700_000_000_000_000_000
"""When each capture begins: 2023-11-14 22:13:20 UTC in nanoseconds since 1970."""

US = 1_000
MS = 1_000_000
SECOND = 1_000_000_000

S_EXECUTING = 0x0900

CLIENT = Host(bytes.fromhex("0200c0a8000a"), "192.168.0.10", 50001)
SERVER = Host(bytes.fromhex("0200c0a80001"), "192.168.0.1", 5007)

_IDS = {function.name: function.id for function in FUNCTIONS.values()}


def request(serial: int, reserved: int, function: str, *arguments: Variant) -> bytes:
    """Return the bytes of a request."""
    return encode_frame(serial, reserved, _IDS[function], arguments)


def reply(serial: int, reserved: int, *arguments: Variant, hresult: int = 0) -> bytes:
    """Return the bytes of a reply."""
    return encode_frame(serial, reserved, hresult, arguments)


def i2(value: int) -> Variant:
    """Make a VT_I2."""
    return Variant(VT.I2, value)


def i4(value: int) -> Variant:
    """Make a VT_I4."""
    return Variant(VT.I4, value)


def text(value: str) -> Variant:
    """Make a VT_BSTR."""
    return Variant(VT.BSTR, value)


def i4s(*values: int) -> Variant:
    """Make an array of VT_I4."""
    return Variant.array(VT.I4, values)


def r4s(*values: float) -> Variant:
    """Make an array of VT_R4."""
    return Variant.array(VT.R4, values)


def r8s(*values: float) -> Variant:
    """Make an array of VT_R8."""
    return Variant.array(VT.R8, values)


def mixed(*values: Variant) -> Variant:
    """Make an array of VT_VARIANT."""
    return Variant.array(VT.VARIANT, values)


class Datagrams:
    """What a card on the network between a client and a controller sees of their UDP traffic."""

    def __init__(
        self,
        client: Host = CLIENT,
        server: Host = SERVER,
        interface: int = 0,
        vlans: tuple[int, ...] = (),
    ) -> None:
        self.packets: list[Packet] = []
        self._client = client
        self._server = server
        self._interface = interface
        self._vlans = vlans

    def up(self, time: int, payload: bytes, comment: str = "") -> None:
        """Send from the client."""
        self._add(time, self._client, self._server, payload, comment)

    def down(self, time: int, payload: bytes, comment: str = "") -> None:
        """Send from the controller."""
        self._add(time, self._server, self._client, payload, comment)

    def _add(self, time: int, src: Host, dst: Host, payload: bytes, comment: str) -> None:
        ident = len(self.packets) + 1
        data = ethernet(src, dst, udp(src, dst, payload, ident), self._vlans)
        self.packets.append(Packet(time, data, comment, self._interface))
