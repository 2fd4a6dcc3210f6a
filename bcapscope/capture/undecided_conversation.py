"""Two ends that talk b-CAP, before and after it is known which of them is the server."""

from __future__ import annotations

import socket
from typing import NamedTuple

from bcapscope.capture.role_detection import direction_evidence
from bcapscope.protocol.codec.frame import Frame, Malformed
from bcapscope.traffic.observation import Conversation, Direction, Endpoint, Flow, Transport

HELD_ITEMS_LIMIT = 64
"""Items kept back until the server is known; at that number it is guessed. A single reply of S_OK, or a
single call, tells it, so that real traffic is known after one or two."""


def endpoints_of(key: bytes) -> tuple[Endpoint, Endpoint]:
    """Return source and destination of both addresses and both ports, as they stand in a packet."""
    size = (len(key) - 4) // 2
    family = socket.AF_INET if size == 4 else socket.AF_INET6
    hosts = (socket.inet_ntop(family, key[:size]), socket.inet_ntop(family, key[size : 2 * size]))
    ports = (int.from_bytes(key[-4:-2]), int.from_bytes(key[-2:]))
    return Endpoint(hosts[0], ports[0]), Endpoint(hosts[1], ports[1])


def reverse_key(key: bytes) -> bytes:
    """Return the key of the other direction."""
    size = (len(key) - 4) // 2
    return key[size:-4] + key[:size] + key[-2:] + key[-4:-2]


HELD_BYTES_LIMIT = 16 * 1024
"""Bytes of these items at which it is guessed as well: frames of real sessions are below 10 KiB, and there
may be 2,048 talks whose server is not known."""


class TimedItem(NamedTuple):
    """A frame, or bytes that are none, and when they were seen.

    Attributes:
        began: when the first byte was seen, nanoseconds since 1970.
        time: when the last byte was seen.
        packet: number of the packet that brought it.
        item: the frame, or the bytes that are none.
    """

    began: int
    time: int
    packet: int
    item: Frame | Malformed


class UndecidedConversation:
    """What two ends say to each other over one transport.

    Attributes:
        flows: by sender, 0 or 1; None until it is known which end is the server.
        is_tentative: whether this may still turn out not to be b-CAP.
    """

    __slots__ = ("_closed", "_ends", "_held_bytes", "_held_items", "_transport", "flows", "is_tentative")

    def __init__(
        self, ends: tuple[Endpoint, Endpoint], transport: Transport, is_tentative: bool = False
    ) -> None:
        """Begin a talk; a tentative one may turn out not to be b-CAP until it shows a sound frame."""
        self._ends = ends
        self._transport = transport
        self.is_tentative = is_tentative
        self._held_items: list[tuple[int, TimedItem]] = []
        self._held_bytes = 0
        self._closed: dict[tuple[int, bool], int] = {}  # when, by sender and whether it was by RST
        self.flows: tuple[Flow, Flow] | None = None

    def set_server(self, server: int, why: str) -> None:
        """Settle which end is the server, and how that is known."""
        conversation = Conversation(self._ends[1 - server], self._ends[server], self._transport, why)
        request, response = Flow(conversation, Direction.REQUEST), Flow(conversation, Direction.RESPONSE)
        self.flows = (response, request) if server == 0 else (request, response)
        for (sender, reset), time in self._closed.items():
            self.record_close(sender, reset, time)

    def guess_server(self) -> None:
        """Settle it for want of proof, if it is not settled: who speaks first mostly asks."""
        if self.flows is None:
            client = self._held_items[0][0] if self._held_items else 0
            self.set_server(1 - client, "a guess: the other end spoke first, and nothing said was proof")

    def record_close(self, sender: int, reset: bool, time: int) -> None:
        """Note that an end closed the connection, or broke it off."""
        if self.flows is None:
            self._closed.setdefault((sender, reset), time)
        else:
            flow = self.flows[sender]
            flow.conversation.record_end(flow.direction, reset, time)

    def add_item(self, sender: int, timed_item: TimedItem) -> bool:
        """Take in what an end said; `release_items` gives it out.

        Returns:
            False if this turns out to be no b-CAP at all.
        """
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
            direction, what = found
            end = self._ends[sender]
            self.set_server(sender if direction is Direction.RESPONSE else 1 - sender, f"{end} sent {what}")
            return
        self._held_bytes += len(item.raw)
        if len(self._held_items) >= HELD_ITEMS_LIMIT or self._held_bytes >= HELD_BYTES_LIMIT:
            self.guess_server()

    def release_items(self) -> list[tuple[Flow, TimedItem]]:
        """Return what was said since the last time; nothing while the server is not known."""
        if self.flows is None or not self._held_items:
            return []
        flows, held = self.flows, self._held_items
        self._held_items = []
        return [(flows[sender], sighting) for sender, sighting in held]
