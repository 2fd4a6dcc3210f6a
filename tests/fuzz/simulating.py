"""Hostile clients of the simulator: what must hold whatever they send, over UDP and TCP.

An input is a list of steps, each one byte that says what is done and by whom, one byte of length, and so many
bytes. Requests may be sent as they are, or only as function and arguments that get a sound header, since
bytes that are no frame do not come far.
"""

from __future__ import annotations

import struct
from collections.abc import Iterator
from typing import NamedTuple

from bcapscope.protocol.codec.frame import LARGEST_UDP_FRAME, SMALLEST_FRAME, Frame, parse_datagram
from bcapscope.protocol.codec.stream_splitter import LARGEST_GARBAGE, LARGEST_UNCONFIRMED
from bcapscope.simulator.call_executor import MAX_KEPT_REPLIES, CallExecutor
from bcapscope.simulator.function_handlers import MAX_FILES
from bcapscope.simulator.hosted_client import MAX_WAITING
from bcapscope.simulator.machine import MAX_ACTIVE, MAX_RECORDS
from bcapscope.simulator.object_table import MAX_OBJECTS
from bcapscope.simulator.profile import PROFILES
from bcapscope.simulator.simulator import (
    LARGEST_REQUEST,
    MAX_CLIENTS,
    STOP_CLIENTS,
    Simulator,
    SimulatorOutput,
)
from bcapscope.simulator.variable_memory import MAX_FRAMES, VARIABLES_PER_LETTER

RAW, CALL, RETRY, WAIT, HANG_UP, BUTTON = range(6)
"""Kinds of steps: bytes as they are; a call; the last call again; time; end of a connection; the pendant."""

KINDS = 6
PEERS = 4
MS = 1_000_000


class Step(NamedTuple):
    """One step.

    Attributes:
        kind: `RAW` and so on.
        peer: who does it.
        tcp: over a connection.
        data: what it is about.
    """

    kind: int
    peer: int
    tcp: bool
    data: bytes

    def packed(self) -> bytes:
        """Return the bytes that `steps` reads."""
        head = self.kind + KINDS * (self.peer + PEERS * self.tcp)
        return bytes((head, len(self.data))) + self.data


def steps(data: bytes) -> Iterator[Step]:
    """Read steps; the last one may be shorter than it says."""
    at = 0
    while at + 2 <= len(data):
        who, kind = divmod(data[at], KINDS)
        stop = at + 2 + data[at + 1]
        yield Step(kind, who % PEERS, bool(who // PEERS & 1), data[at + 2 : stop])
        at = stop


def simulator(data: bytes) -> None:
    """Let clients do the steps in `data`, behind the byte that chooses the profile."""
    if data:
        stage = Stage(list(PROFILES)[data[0] % len(PROFILES)])
        for step in steps(data[1:]):
            stage.act(step)
            stage.check()


class Stage:
    """A simulator and its clients."""

    def __init__(self, profile: str) -> None:
        self.simulator = Simulator(PROFILES[profile])
        self.now = 0
        self.serials: dict[object, int] = {}
        self.asked: dict[object, bytes] = {}

    def act(self, step: Step) -> None:
        """Do one step."""
        peer = ("tcp" if step.tcp else "udp", step.peer)
        if step.kind == WAIT:
            self.wait(int.from_bytes(step.data[:2], "little"))
        elif step.kind == HANG_UP:
            self.simulator.on_disconnect(peer, self.now)
        elif step.kind == BUTTON:
            self.press(step.data)
        else:
            self.send(peer, step.tcp, self.bytes_of(step, peer))

    def bytes_of(self, step: Step, peer: object) -> bytes:
        """Return what a step sends."""
        if step.kind == RAW or len(step.data) < 2:
            return step.data
        first = self.serials.get(peer, 1)
        if step.kind == RETRY:
            self.serials[peer] = serial = first + step.data[0] & 0xFFFF
            inner, reserved = self.asked.get(peer, b""), first + step.data[1] & 0xFFFF
        else:
            self.serials[peer] = serial = first + 1 & 0xFFFF
            inner, reserved = struct.pack("<IH", step.data[0], step.data[1] % 8) + step.data[2:], 0
        self.asked[peer] = inner
        return struct.pack("<BIHH", 1, 10 + len(inner), serial, reserved) + inner + b"\x04"

    def send(self, peer: object, tcp: bool, data: bytes) -> None:
        """Send bytes, and see that what comes back are frames."""
        if not tcp:
            self.look(self.simulator.on_datagram(peer, data, self.now))
        elif peer in self.simulator._links or self.simulator.on_connect(peer, self.now):
            self.look(self.simulator.on_segment(peer, data, self.now))

    def wait(self, ms: int) -> None:
        """Let time pass, as a server would."""
        end = self.now + ms * MS
        for _ in range(64):
            due = self.simulator.due(self.now)
            if due is None or due > end:
                break
            self.now = max(due, self.now + 1)
            self.look(self.simulator.advance(self.now))
        self.now = end
        self.look(self.simulator.advance(self.now))

    def press(self, data: bytes) -> None:
        """Press a button of the pendant."""
        machine = self.simulator.machine
        if data[:1] == b"r":
            self.look(self.simulator.reset(self.now))
        elif data[:1] == b"s":
            machine.press_emergency_stop(self.now)
        else:
            machine.emergency = False

    def look(self, outputs: list[SimulatorOutput]) -> None:
        """Check what is sent: sound frames, small enough for where they go."""
        for peer, data in outputs:
            assert isinstance(peer, tuple)
            transport = peer[0]
            if data:
                (frame,) = parse_datagram(data)
                assert isinstance(frame, Frame)
                assert not frame.problems
                assert transport == "tcp" or SMALLEST_FRAME <= len(data) <= LARGEST_UDP_FRAME
            else:
                assert transport == "tcp"

    def check(self) -> None:
        """Nothing grows beyond its bound."""
        simulator, machine = self.simulator, self.simulator.machine
        assert simulator.client_count <= 2 * (MAX_CLIENTS + STOP_CLIENTS)
        assert set(simulator._running) <= set(simulator._links)
        assert len(machine.files) <= MAX_FILES
        assert len(machine.active_alarms) <= MAX_ACTIVE
        assert len(machine.log.records) <= MAX_RECORDS
        assert machine.slave.waiting <= 256
        assert len(machine.memory._values) <= 8 * VARIABLES_PER_LETTER + 2 * MAX_FRAMES
        for conversation, splitter in simulator._links.values():
            assert isinstance(conversation, CallExecutor)
            self.check_client(conversation)
            most = max(LARGEST_REQUEST, LARGEST_GARBAGE + LARGEST_UNCONFIRMED)
            assert splitter is None or splitter.pending_bytes <= most

    def check_client(self, conversation: CallExecutor) -> None:
        """Neither does what one client leaves."""
        assert len(conversation.session.objects) <= MAX_OBJECTS
        assert len(conversation._waiting) <= MAX_WAITING
        assert len(conversation._responder._calls) <= MAX_KEPT_REPLIES
        assert (conversation.running is not None) == conversation._responder.is_call_running
