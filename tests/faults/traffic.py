"""Messages for the tests of faults, and a way to run them through."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import NamedTuple

from bcapscope.faults.fault_injector import FaultInjector
from bcapscope.faults.fault_notation import read_fault
from bcapscope.faults.wire_message import CloseConnection, FaultOutput, FaultResult, SendBytes
from bcapscope.protocol.codec.frame import encode_frame
from bcapscope.protocol.codec.variant import VT, Variant
from bcapscope.traffic.observation import (
    SERVER_PORT,
    Conversation,
    Direction,
    Endpoint,
    Flow,
    Transport,
)

MS = 1_000_000
ROBOT_EXECUTE = 64
CLIENT, SERVER = Endpoint("10.0.0.2", 50001), Endpoint("10.0.0.1", 5007)


class Talk(NamedTuple):
    """Both directions of one conversation."""

    up: Flow
    down: Flow


def talk(transport: Transport = Transport.UDP, client: Endpoint = CLIENT) -> Talk:
    """Make a conversation."""
    conversation = Conversation(client, SERVER, transport, SERVER_PORT)
    return Talk(Flow(conversation, Direction.REQUEST), Flow(conversation, Direction.RESPONSE))


def request(serial: int, command: str = "slvMove", reserved: int = 0, values: Sequence[float] = ()) -> bytes:
    """Make a Robot_Execute."""
    arguments = (
        Variant(VT.I4, 1),
        Variant(VT.BSTR, command),
        Variant.array(VT.R4, tuple(values or (1.0, 2.0, 3.0))),
    )
    return encode_frame(serial, reserved, ROBOT_EXECUTE, arguments)


def reply(serial: int, code: int = 0, reserved: int = 0) -> bytes:
    """Make a reply with a value."""
    return encode_frame(serial, reserved, code, (Variant(VT.I4, 5),))


def shaper(*faults: str, seed: int = 1) -> FaultInjector:
    """Set up faults at time 0."""
    return FaultInjector(map(read_fault, faults), seed=seed, now=0)


def sent(outputs: Iterable[FaultOutput]) -> list[bytes]:
    """Give the bytes of all that is sent."""
    return [output.data for output in outputs if isinstance(output, SendBytes)]


def passes(machine: FaultInjector, flow: Flow, data: bytes) -> bool:
    """Process a message at time 0. Return whether exactly this message is sent at once."""
    return sent(machine.process_message(flow, data, 0).outputs) == [data]


def closed(outputs: Iterable[FaultOutput]) -> list[CloseConnection]:
    """Give the connections that are ended."""
    return [output for output in outputs if isinstance(output, CloseConnection)]


def run_dry(machine: FaultInjector, now: int) -> list[tuple[int, bytes]]:
    """Let time pass until nothing is held; give what is sent with its time."""
    found = []
    while (due := machine.due()) is not None:
        now = max(now, due)
        found += [(now, data) for data in sent(machine.advance(now))]
    return found


def arrivals(
    machine: FaultInjector, flow: Flow, messages: Sequence[bytes], every: int = MS
) -> list[tuple[int, bytes]]:
    """Let messages pass, one after each `every` ns; give what arrives with its time."""
    found: list[tuple[int, bytes]] = []
    now = 0
    for message in messages:
        while (due := machine.due()) is not None and due <= now:
            found += [(due, data) for data in sent(machine.advance(due))]
        taken: FaultResult = machine.process_message(flow, message, now)
        found += [(now, data) for data in sent(taken.outputs)]
        now += every
    return found + run_dry(machine, 0)
