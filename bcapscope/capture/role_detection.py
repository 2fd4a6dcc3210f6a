"""Detect the controller of a conversation. Usually, ports or frames show which end is the controller."""

from __future__ import annotations

import socket
from collections.abc import Collection
from typing import NamedTuple

from bcapscope.protocol.codec.frame import EOT, LARGEST_FRAME, SMALLEST_FRAME, SOH, Frame, Malformed
from bcapscope.protocol.codec.stream_splitter import MAX_RESYNC_ARGUMENTS
from bcapscope.protocol.codec.variant import VT
from bcapscope.protocol.tables.function_table import FUNCTIONS
from bcapscope.protocol.tables.hresult import S_EXECUTING, S_FALSE, S_OK
from bcapscope.traffic.observation import (
    Conversation,
    Direction,
    Endpoint,
    Flow,
    ServerEvidence,
    ServerEvidenceKind,
    Transport,
)

BCAP_PORTS = frozenset({5007})
"""Ports on which controllers listen, UDP and TCP (orin_bcap C/include/bcap_common.h)."""

SENT_TYPES: dict[str, tuple[int, ...]] = {
    "VT_I4": (VT.I4, VT.UI4, VT.I2),
    "VT_R4": (VT.R4, VT.R8),
    "VT_BSTR": (VT.BSTR,),
}
"""The types that clients send for an argument type of the function table; VARIANT allows any type."""


HELD_ITEMS_LIMIT = 64
"""Number of held items after which bcapscope guesses the controller. One request whose arguments
fit its function makes a guess unnecessary, because the request shows which end is the controller.
"""

HELD_BYTES_LIMIT = 16 * 1024
"""Number of bytes, held for one conversation, after which bcapscope guesses the controller. Frames of real
sessions have less than 10 KiB. The limit is small, because up to 2,048 conversations can hold bytes at the
same time.
"""


def server_index_by_port(ports: Collection[int], first: int, second: int) -> int | None:
    """Return the index, 0 or 1, of the only port that is in `ports`; else None."""
    known = (first in ports, second in ports)
    return known.index(True) if sum(known) == 1 else None


def direction_evidence(item: Frame | Malformed) -> tuple[Direction, ServerEvidence] | None:
    """Return the direction that the content proves, and the evidence; None if the content proves nothing.

    A code of 0 or 0x900, and a code with the top bit set, can only be a result code. A function id identifies
    a request only if the arguments of the frame fit the function.
    """
    if isinstance(item, Malformed) or item.problems:
        return None
    if item.code in (S_OK, S_EXECUTING) or item.code & 0x80000000:
        return Direction.RESPONSE, ServerEvidence(ServerEvidenceKind.RESULT, item.code)
    if item.code in FUNCTIONS and _arguments_fit(item):
        return Direction.REQUEST, ServerEvidence(ServerEvidenceKind.CALL, item.code)
    return None


def _arguments_fit(frame: Frame) -> bool:
    """Return whether the arguments fit the function; False for code 1 without argument, which may be a reply
    with S_FALSE instead of Service_Start.
    """
    params = FUNCTIONS[frame.code].params
    arguments = frame.arguments
    if len(arguments) != len(params) or (frame.code == S_FALSE and not arguments):
        return False
    return all(
        param.type == "VARIANT" or argument.variant.vt in SENT_TYPES[param.type]
        for param, argument in zip(params, arguments, strict=True)
    )


def may_begin_frame(data: bytes) -> bool:
    """Return whether `data` could be the first bytes of a b-CAP frame in a stream."""
    if data[:1] != bytes((SOH,)):
        return False
    length = int.from_bytes(data[1:5], "little")
    if len(data) >= 5 and not SMALLEST_FRAME <= length <= LARGEST_FRAME:
        return False
    if len(data) >= 15 and int.from_bytes(data[13:15], "little") > MAX_RESYNC_ARGUMENTS:
        return False
    return len(data) < length or len(data) < 5 or data[length - 1] == EOT


def is_whole_frames(data: bytes) -> bool:
    start = 0
    while start < len(data):
        stop = start + int.from_bytes(data[start + 1 : start + 5], "little")
        if data[start] != SOH or not start + SMALLEST_FRAME <= stop <= len(data) or data[stop - 1] != EOT:
            return False
        start = stop
    return bool(data)


def endpoints_of(key: bytes) -> tuple[Endpoint, Endpoint]:
    """Return the source and the destination of a packet. `key` holds both addresses and then both ports."""
    size = (len(key) - 4) // 2
    family = socket.AF_INET if size == 4 else socket.AF_INET6
    hosts = (socket.inet_ntop(family, key[:size]), socket.inet_ntop(family, key[size : 2 * size]))
    ports = (int.from_bytes(key[-4:-2]), int.from_bytes(key[-2:]))
    return Endpoint(hosts[0], ports[0]), Endpoint(hosts[1], ports[1])


def reverse_key(key: bytes) -> bytes:
    size = (len(key) - 4) // 2
    return key[size:-4] + key[:size] + key[-2:] + key[-4:-2]


class TimedItem(NamedTuple):
    """A frame, or bytes that are not a frame, with arrival times.

    Attributes:
        began: Arrival time of the item's first byte, ns since 1970.
        time: Arrival time of the item's last byte, ns since 1970.
        packet: Number of the packet that carried the item's last byte.
    """

    began: int
    time: int
    packet: int
    item: Frame | Malformed


class UndecidedConversation:
    """A conversation that holds its frames and malformed bytes while its controller is unknown.

    Attributes:
        flows: Flow of each sender, by index 0 or 1; None until the controller is known.
        is_tentative: True while it is unknown whether the conversation is b-CAP. The first frame decides: if
            the frame is invalid, the conversation is not b-CAP.
    """

    def __init__(
        self, ends: tuple[Endpoint, Endpoint], transport: Transport, is_tentative: bool = False
    ) -> None:
        self._ends = ends
        self._transport = transport
        self.is_tentative = is_tentative
        self._held_items: list[tuple[int, TimedItem]] = []
        self._held_bytes = 0
        # Times of the first FIN and the first RST of each sender. A key holds the index of the sender, and
        # True for a RST.
        self._closed: dict[tuple[int, bool], int] = {}
        self.flows: tuple[Flow, Flow] | None = None

    def set_server(self, server: int, evidence: ServerEvidence) -> None:
        conversation = Conversation(self._ends[1 - server], self._ends[server], self._transport, evidence)
        request, response = Flow(conversation, Direction.REQUEST), Flow(conversation, Direction.RESPONSE)
        self.flows = (response, request) if server == 0 else (request, response)
        for (sender, reset), time in self._closed.items():
            self.record_close(sender, reset, time)

    def guess_server(self) -> None:
        """If the controller is unknown, take the end that sends first as the client."""
        if self.flows is None:
            client = self._held_items[0][0] if self._held_items else 0
            self.set_server(1 - client, ServerEvidence(ServerEvidenceKind.GUESS))

    def record_close(self, sender: int, reset: bool, time: int) -> None:
        if self.flows is None:
            self._closed.setdefault((sender, reset), time)
        else:
            flow = self.flows[sender]
            flow.conversation.record_end(flow.direction, reset, time)

    def add_item(self, sender: int, timed_item: TimedItem) -> bool:
        """Hold an item until `release_items`. Return False if the traffic cannot be b-CAP."""
        if self.is_tentative:
            if isinstance(timed_item.item, Malformed) or timed_item.item.problems:
                return False
            self.is_tentative = False
        self._held_items.append((sender, timed_item))
        if self.flows is None:
            self._check_evidence(sender, timed_item.item)
        return True

    def _check_evidence(self, sender: int, item: Frame | Malformed) -> None:
        found = direction_evidence(item)
        if found is not None:
            direction, evidence = found
            self.set_server(sender if direction is Direction.RESPONSE else 1 - sender, evidence)
            return
        self._held_bytes += len(item.raw)
        if len(self._held_items) >= HELD_ITEMS_LIMIT or self._held_bytes >= HELD_BYTES_LIMIT:
            self.guess_server()

    def release_items(self) -> list[tuple[Flow, TimedItem]]:
        """Return the items added since the previous call; [] while the controller is unknown."""
        if self.flows is None or not self._held_items:
            return []
        flows, held = self.flows, self._held_items
        self._held_items = []
        return [(flows[sender], sighting) for sender, sighting in held]
