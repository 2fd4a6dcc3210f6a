"""Clients and simulator over a network that loses, doubles, delays and reorders, step by step at any moment.

Nothing is trusted to say what ran: the functions themselves are counted while they run.
"""

from __future__ import annotations

from collections import Counter
from typing import NamedTuple
from unittest.mock import patch

from hypothesis import settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, initialize, invariant, precondition, rule

from bcapscope.protocol.codec.frame import Frame
from bcapscope.protocol.codec.variant import EMPTY, VT, Variant
from bcapscope.protocol.retry.requester import (
    CallAnswered,
    CallRefused,
    CallTimedOut,
    Requester,
    RequesterEvent,
    RequesterOutcome,
    RetryPolicy,
)
from bcapscope.protocol.retry.reserved_convention import ReservedConvention
from bcapscope.simulator.call_context import CallContext, CallHandler
from bcapscope.simulator.call_outcome import HandlerOutcome
from bcapscope.simulator.function_handlers import FUNCTION_HANDLERS
from bcapscope.simulator.profile import PROFILES
from bcapscope.simulator.simulator import Simulator, SimulatorOutput

US, MS = 1_000, 1_000_000
START, CONNECT, GET_ROBOT, GET_VARIABLE, EXECUTE, MOVE, GET_VALUE, PUT_VALUE = 1, 3, 7, 9, 64, 72, 101, 102
COUNTED = (MOVE, PUT_VALUE)

LIFE = 6
"""Calls of its client that a packet lives at most: what arrives when its call is no longer remembered runs
anew. Networks deliver within milliseconds, or never."""

NAMES = st.sampled_from(["a", "b"])
UDP = [ReservedConvention.SEED, ReservedConvention.OWN, ReservedConvention.CHAIN]


class Packet(NamedTuple):
    """A packet on its way; `call` counts the calls of its client."""

    call: int
    up: bool
    data: bytes


class Program:
    """A program that calls, and what became of its calls."""

    def __init__(self, convention: ReservedConvention, serial: int) -> None:
        self.requester = Requester(convention, serial)
        self.identity: int | None = None
        self.settled: list[RequesterOutcome] = []

    def events(self) -> list[RequesterEvent]:
        """Take what happened; at most one thing ends the call."""
        events = self.requester.drain_events()
        self.settled += [
            event for event in events if isinstance(event, CallAnswered | CallRefused | CallTimedOut)
        ]
        return events


def bstr(text: str) -> Variant:
    """Make a VT_BSTR."""
    return Variant(VT.BSTR, text)


class BadNetwork(RuleBasedStateMachine):
    """Two clients; what they want done is numbered, so that each number may run once.

    A program that starts anew from the same port has serials of its own here: where they meet those of the
    old one, `tests.client.test_lives` is the place.
    """

    def __init__(self) -> None:
        super().__init__()
        self.now = 0
        self.ran: Counter[int] = Counter()
        self.asked = 0
        self.begun: Counter[str] = Counter()
        self.packets: dict[str, list[Packet]] = {"a": [], "b": []}
        self.programs: dict[str, Program] = {}
        self.handles: dict[str, tuple[Variant, Variant]] = {}
        self.simulator = Simulator(PROFILES["rc8"])
        counting = dict(FUNCTION_HANDLERS)
        for each in COUNTED:
            owner, run = FUNCTION_HANDLERS[each]
            assert run is not None
            counting[each] = owner, self.counting(run)
        self.counted = patch("bcapscope.simulator.client_session.FUNCTION_HANDLERS", counting)
        self.counted.start()

    def counting(self, run: CallHandler) -> CallHandler:
        """Return the same function, which counts how often it runs for each number."""

        def counted(context: CallContext) -> HandlerOutcome:
            self.ran[_number(context.arguments)] += 1
            return run(context)

        return counted

    @initialize(conventions=st.tuples(*[st.sampled_from(UDP)] * 2), serial=st.sampled_from([1, 65520]))
    def open(self, conventions: tuple[ReservedConvention, ReservedConvention], serial: int) -> None:
        """Begin with a network without faults."""
        for name, convention in zip("ab", conventions, strict=True):
            self.start(name, convention, serial)
        for command, parameter in (("TakeArm", EMPTY), ("Motor", Variant.array(VT.I4, (1, 1)))):
            self.ask("a", EXECUTE, self.handles["a"][0], bstr(command), parameter)
        self.pass_time(500 * MS)

    def start(self, name: str, convention: ReservedConvention, serial: int) -> None:
        """Start a program that opens a robot and a variable."""
        self.programs[name] = Program(convention, serial)
        self.ask(name, START, bstr(",WDT=80"))
        controller = self.ask(name, CONNECT, *map(bstr, ("", "CaoProv.DENSO.VRC", "", "")))
        robot = self.ask(name, GET_ROBOT, controller, bstr("Arm"), bstr(""))
        self.handles[name] = robot, self.ask(name, GET_VARIABLE, controller, bstr("I1"), bstr(""))

    def ask(self, name: str, function_id: int, *arguments: Variant) -> Variant:
        """Make a call over a network without faults; return its result."""
        self.call(name, function_id, *arguments, pace=RetryPolicy(1000 * MS, 4))
        while self.programs[name].requester.call_in_progress:
            while self.packets[name]:
                self.arrive(name, self.packets[name].pop(0))
            self.pass_time(1 * MS)
        (settled,) = self.programs[name].settled
        assert isinstance(settled, CallAnswered), settled
        values = settled.reply.arguments
        return values[0].variant if values else EMPTY

    def call(self, name: str, function_id: int, *arguments: Variant, pace: RetryPolicy) -> None:
        """Begin a call."""
        self.end(name)
        program = self.programs[name]
        program.settled.clear()
        self.begun[name] += 1
        alive = self.begun[name] - LIFE
        self.packets[name] = [packet for packet in self.packets[name] if packet.call >= alive]
        program.requester.start_call(function_id, arguments, pace, self.now)
        self.pump(name)

    def end(self, name: str) -> None:
        """See how the last call ended: in one way; what was answered has run."""
        program = self.programs[name]
        if self.begun[name]:
            assert not program.requester.call_in_progress
            assert len(program.settled) <= 1
        if program.identity is not None:
            (settled,) = program.settled
            assert not isinstance(settled, CallAnswered) or self.ran[program.identity] == 1
            program.identity = None

    def pump(self, name: str) -> None:
        """Put on the way what is to be sent."""
        program = self.programs[name]
        program.events()
        call = self.begun[name]
        self.packets[name] += [Packet(call, True, data) for data in program.requester.data_to_send()]

    def arrive(self, name: str, packet: Packet) -> None:
        """Let a packet arrive."""
        if packet.up:
            self.put_on_the_way(self.simulator.on_datagram(name, packet.data, self.now))
        else:
            self.programs[name].requester.receive_item(Frame(packet.data), self.now)
            self.pump(name)

    def put_on_the_way(self, outputs: list[SimulatorOutput]) -> None:
        """Send what the simulator sends."""
        for peer, data in outputs:
            name = str(peer)
            self.packets[name].append(Packet(self.begun[name], False, data))

    def pass_time(self, span: int) -> None:
        """Let time pass, stopping at every moment at which something is due."""
        end = self.now + span
        while self.now < end:
            dues = [
                self.simulator.due(self.now),
                *(each.requester.deadline for each in self.programs.values()),
            ]
            due = min((each for each in dues if each is not None), default=end)
            self.now = min(max(due, self.now + 10 * US), end)
            self.put_on_the_way(self.simulator.advance(self.now))
            for name, program in self.programs.items():
                program.requester.handle_timeout(self.now)
                self.pump(name)

    @rule(
        name=NAMES, what=st.sampled_from([PUT_VALUE, PUT_VALUE, GET_VALUE, MOVE]), retries=st.integers(0, 7)
    )
    def begin(self, name: str, what: int, retries: int) -> None:
        """Begin a call; where one is under way, it is time for its next try."""
        program = self.programs[name]
        if program.requester.call_in_progress:
            self.pass_time(2 * MS)
            return
        robot, variable = self.handles[name]
        self.asked += 1
        arguments: tuple[Variant, ...] = (variable,)
        if what == PUT_VALUE:
            arguments = (variable, Variant(VT.I4, self.asked))
        elif what == MOVE:
            arguments = (robot, Variant(VT.I4, 1), bstr(f"J(0,0,90,0,90,{self.asked})"), bstr(""))
        self.call(name, what, *arguments, pace=RetryPolicy(2 * MS, retries))
        program.identity = None if what == GET_VALUE else self.asked

    @rule(name=NAMES, index=st.integers(0, 30), fate=st.sampled_from(["arrive", "arrive", "double", "lose"]))
    def network(self, name: str, index: int, fate: str) -> None:
        """Let any of the packets arrive next, be there twice, or be lost."""
        if not self.packets[name]:
            return
        place = index % len(self.packets[name])
        packet = self.packets[name][place]
        if fate == "double":
            self.packets[name].append(packet)
            return
        del self.packets[name][place]
        if fate == "arrive":
            self.arrive(name, packet)

    @rule(name=NAMES)
    def calm(self, name: str) -> None:
        """Let all packets arrive in order."""
        while self.packets[name]:
            self.arrive(name, self.packets[name].pop(0))

    @rule(span=st.sampled_from([300 * US, 1 * MS, 3 * MS, 90 * MS]))
    def wait(self, span: int) -> None:
        """Let time pass."""
        self.pass_time(span)

    @precondition(lambda self: self.asked % 6 == 5)
    @rule(name=NAMES, convention=st.sampled_from(UDP))
    def restart(self, name: str, convention: ReservedConvention) -> None:
        """Let another program begin at the same port; what was on the way is gone until it does."""
        self.packets[name].clear()
        self.programs.pop(name)
        self.start(name, convention, 1000 * self.asked)

    @invariant()
    def nothing_runs_twice(self) -> None:
        """No number was seen twice by the function that it was for."""
        assert all(times == 1 for times in self.ran.values())

    def teardown(self) -> None:
        """Let time pass until every call has ended."""
        for name in self.programs:
            for _ in range(100):
                if not self.programs[name].requester.call_in_progress:
                    break
                self.packets[name].clear()
                self.pass_time(20 * MS)
            self.end(name)
        self.counted.stop()


def _number(arguments: tuple[Variant, ...]) -> int:
    """Return the number that a counted function was called with; its handle is not among `arguments`."""
    if len(arguments) == 1:
        return int(str(arguments[0].value))
    return int(str(arguments[1].value).rpartition(",")[2].rstrip(")"))


TestBadNetwork = BadNetwork.TestCase
TestBadNetwork.settings = settings(max_examples=100, stateful_step_count=60)
