"""Traffic written down by hand: who said what at which millisecond, and how the calls should come out."""

from __future__ import annotations

from collections.abc import Iterable

from bcapscope.protocol.codec.frame import Frame, Malformed, encode_frame
from bcapscope.protocol.codec.variant import VT, Variant
from bcapscope.traffic.call import Call, PairingResult, StrayReply
from bcapscope.traffic.observation import (
    SERVER_PORT,
    Conversation,
    Direction,
    Endpoint,
    Flow,
    Observation,
    Transport,
)
from bcapscope.traffic.pipeline import Pipeline, PipelineSubscriber
from bcapscope.traffic.tracker import Tracker

MS = 1_000_000
START = 1_700_000_000_000_000_000
SERVER = Endpoint("10.0.0.1", 5007)

EXECUTE, SERVICE_START, SERVICE_STOP, CONNECT, DISCONNECT = 64, 1, 2, 3, 4
GET_ROBOT, GET_VARIABLE, GET_VALUE, ROBOT_RELEASE, VARIABLE_RELEASE = 7, 9, 101, 84, 111
S_EXECUTING, S_BUF_FULL, BUSY = 0x900, 0x0F200501, 0x809100AA


def i4(value: int) -> Variant:
    return Variant(VT.I4, value)


def text(value: str) -> Variant:
    return Variant(VT.BSTR, value)


def r8s(*values: float) -> Variant:
    return Variant.array(VT.R8, values)


def slv_move(*joints: float) -> tuple[int, tuple[Variant, ...]]:
    return EXECUTE, (i4(1), text("slvMove"), r8s(*joints))


def execute(command: str, handle: int = 1) -> tuple[int, tuple[Variant, ...]]:
    return EXECUTE, (i4(handle), text(command), i4(0))


POSE = r8s(1.0, 2.0)
MOVE = slv_move(1.0, 2.0)
OTHER = slv_move(3.0, 4.0)
START_SERVICE = (SERVICE_START, (text(""),))


class Script:
    """Observations in the order in which they were seen, numbered from 1."""

    def __init__(self) -> None:
        self.seen: list[Observation] = []

    def client(self, port: int = 50001, transport: Transport = Transport.UDP) -> Client:
        conversation = Conversation(Endpoint("10.0.0.2", port), SERVER, transport, SERVER_PORT)
        return Client(self, conversation)

    def track(self, stop: int | None = None) -> list[PairingResult]:
        """Run a new tracker over the first `stop` observations and give all that it gives out."""
        tracker = Tracker()
        settled = [item for observation in self.seen[:stop] for item in tracker.observe(observation)]
        return [*settled, *tracker.close()]


class Client:
    """One conversation of a script; times are in milliseconds from its start."""

    def __init__(self, script: Script, conversation: Conversation) -> None:
        self.script = script
        self.conversation = conversation
        self.flows = {direction: Flow(conversation, direction) for direction in Direction}

    def ask(
        self, ms: float, serial: int, reserved: int, question: tuple[int, tuple[Variant, ...]]
    ) -> Observation:
        """Send a request or retry."""
        code, arguments = question
        return self.see(ms, Direction.REQUEST, Frame(encode_frame(serial, reserved, code, arguments)))

    def reply(
        self, ms: float, serial: int, reserved: int = 0, code: int = 0, *results: Variant
    ) -> Observation:
        """Send a reply."""
        return self.see(ms, Direction.RESPONSE, Frame(encode_frame(serial, reserved, code, results)))

    def see(self, ms: float, direction: Direction, item: Frame | Malformed) -> Observation:
        time = START + round(ms * MS)
        number = len(self.script.seen) + 1
        observation = Observation(number, time, time, self.flows[direction], item, number)
        self.script.seen.append(observation)
        return observation


def run_pipeline(observations: Iterable[Observation], *subscribers: PipelineSubscriber) -> None:
    """Run observations through a pipeline to the end."""
    pipeline = Pipeline(*subscribers)
    for observation in observations:
        pipeline.add(observation)
    pipeline.finish()


def calls_of(settled: Iterable[PairingResult]) -> list[Call]:
    return [item for item in settled if isinstance(item, Call)]


def strays_of(settled: Iterable[PairingResult]) -> list[StrayReply]:
    return [item for item in settled if isinstance(item, StrayReply)]


def summary(exchange: Call) -> str:
    """Tell a call in one line: each frame's number under its role, outcome and verdict."""
    frames = " ".join(f"{_SIGNS[event.role]}{event.observation.number}" for event in exchange.frames)
    return f"{frames} {exchange.outcome}, {exchange.verdict}"


_SIGNS = {
    "request": ">",
    "retry": ">>",
    "executing": "...",
    "reply": "<",
    "late reply": "late<",
    "lost reply": "lost<",
    "duplicate": "=",
    "captured again": "=",
}


def summaries(settled: Iterable[PairingResult]) -> list[str]:
    return [
        f"{item.number}: {summary(item)}"
        if isinstance(item, Call)
        else f"stray {item.observation.number} of {item.call_number}"
        for item in settled
    ]


def play(script: Script, lines: list[tuple[object, ...]], transport: Transport = Transport.UDP) -> None:
    """Write the lines down: (ms, serial, reserved, question), or (ms, -serial, code, *results) for a reply.

    A reply to serial 0 is written as -0.5.
    """
    client = script.client(transport=transport)
    for ms, serial, *rest in lines:
        assert isinstance(ms, int | float)
        assert isinstance(serial, int | float)
        if serial >= 0:
            client.ask(ms, int(serial), *rest)  # type: ignore[arg-type]  # a table of literals
        else:
            code, *results = rest or (0,)
            client.reply(ms, int(-serial), 0, code, *results)  # type: ignore[arg-type]  # likewise
