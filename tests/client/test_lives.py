"""Client programs come, call, are killed and start again, over a network that does its worst.

All is in one thread and under one clock that only the rules move: requesters, packets on their way and the
simulated controller. Every value that is put is put once and by one call, so that the controller's own report
of what it executed tells whether any call ran twice.
"""

from __future__ import annotations

import heapq
from collections import Counter
from random import Random
from typing import NamedTuple

from hypothesis import settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, initialize, invariant, precondition, rule

from bcapscope.protocol.codec.frame import parse_datagram
from bcapscope.protocol.codec.variant import Variant
from bcapscope.protocol.retry.requester import (
    CallAnswered,
    CallExecuting,
    CallRefused,
    CallTimedOut,
    LateReply,
    Requester,
    RequesterEvent,
    RetryPolicy,
)
from bcapscope.protocol.retry.reserved_convention import ReservedConvention
from bcapscope.protocol.tables.hresult import E_HANDLE
from bcapscope.simulator.argument_values import bstr, i4
from bcapscope.simulator.call_executor import CallReport
from bcapscope.simulator.profile import PROFILES
from bcapscope.simulator.simulator import Peer, Simulator, SimulatorOutput

MS = 1_000_000
_START, _CONNECT, _PUT_TAG, _GET_TAG = 1, 3, 23, 22
_WRONG = 999
_UDP = [ReservedConvention.SEED, ReservedConvention.OWN, ReservedConvention.CHAIN]


class Packet(NamedTuple):
    """A packet on its way; it arrives at `due`."""

    due: int
    number: int
    peer: str
    to_controller: bool
    data: bytes
    life: int


class Weather(NamedTuple):
    """What the network does to packets.

    Attributes:
        loss: share that is lost.
        twice: share that comes twice.
        slowest: ms that a packet takes at most; each takes a random time, so that they overtake each other.
    """

    loss: float
    twice: float
    slowest: float


class Program:
    """A client program on one port; `life` counts how often it was started there."""

    def __init__(self, name: str, convention: ReservedConvention, retries: int, life: int = 1) -> None:
        self.name = name
        self.life = life
        self.requester = Requester(convention)
        self.pace = RetryPolicy(4 * MS, retries)
        self.started = False
        self.handle: Variant | None = None
        self.asked: tuple[int, object] = (0, None)
        self.last_put: object = None
        self.doubtful: set[object] = set()

    @property
    def is_new(self) -> bool:
        """Whether it is the first program on its port, whose answers cannot be meant for another one."""
        return self.life == 1


class Lives(RuleBasedStateMachine):
    """Up to three programs and one controller."""

    @initialize(profile=st.sampled_from(sorted(PROFILES)), seed=st.integers(0, 2**16))
    def switch_on(self, profile: str, seed: int) -> None:
        self.ran: Counter[object] = Counter()
        # The C server's defects run calls twice, which is what they are for.
        profile = "rc8" if profile == "cserver" else profile
        self.provider = "CaoProv.DENSO.VRC9" if profile == "rc9" else "CaoProv.DENSO.VRC"
        self.simulator = Simulator(PROFILES[profile], report=self._note)
        self.now = 0
        self.weather = Weather(0, 0, 0)
        self.chance = Random(seed)
        self.network: list[Packet] = []
        self.packets = self.values = 0
        self.programs: dict[str, Program] = {}
        self.begun = self.ended = self.killed = 0

    @rule(
        loss=st.sampled_from([0, 0.05, 0.3, 0.7]), twice=st.sampled_from([0, 0.3]), slowest=st.floats(0, 12)
    )
    def weather_changes(self, loss: float, twice: float, slowest: float) -> None:
        self.weather = Weather(loss, twice, slowest)

    @precondition(lambda self: len(self.programs) < 3)
    @rule(convention=st.sampled_from(_UDP), retries=st.integers(0, 7))
    def program_starts(self, convention: ReservedConvention, retries: int) -> None:
        name = f"client {len(self.programs)}"
        self.programs[name] = Program(name, convention, retries)

    @precondition(lambda self: self.programs)
    @rule(which=st.integers(0, 2), convention=st.sampled_from(_UDP))
    def program_is_killed_and_starts_again(self, which: int, convention: ReservedConvention) -> None:
        # No process starts as fast as a packet is on its way.
        self.time_passes(12)
        old = self._program(which)
        self.killed += old.requester.call_in_progress
        self.programs[old.name] = Program(old.name, convention, old.pace.retries, old.life + 1)

    @precondition(lambda self: self.programs)
    @rule(which=st.integers(0, 2), what=st.sampled_from(["put", "put", "get", "wrong"]))
    def program_calls(self, which: int, what: str) -> None:
        program = self._program(which)
        if program.requester.call_in_progress:
            return
        function, arguments, value = self._call(program, what)
        program.asked = function, value
        self.begun += 1
        program.requester.start_call(function, arguments, program.pace, self.now)
        self._settle(program)

    @rule(ms=st.floats(0.1, 60))
    def time_passes(self, ms: float) -> None:
        end = self.now + round(ms * MS)
        while (due := self._due()) is not None and due <= end:
            self.now = max(self.now, due)
            self._step()
        self.now = end

    @invariant()
    def no_call_ran_twice(self) -> None:
        assert not [value for value, times in getattr(self, "ran", {}).items() if times > 1]

    def teardown(self) -> None:
        if not hasattr(self, "programs"):
            return
        # The longest call has eight tries of 4 ms, and its last packet is on its way for 12.
        self.time_passes(200)
        assert not any(program.requester.call_in_progress for program in self.programs.values())
        assert self.begun == self.ended + self.killed
        assert not self.network

    def _note(self, _: Peer, report: CallReport) -> None:
        if report.function_id == _PUT_TAG:
            self.ran[report.arguments[1].value] += 1

    def _program(self, which: int) -> Program:
        names = sorted(self.programs)
        return self.programs[names[which % len(names)]]

    def _call(self, program: Program, what: str) -> tuple[int, tuple[Variant, ...], object]:
        """Return function, arguments and the value that is put."""
        if not program.started:
            return _START, (bstr(""),), None
        if program.handle is None:
            return _CONNECT, (bstr(""), bstr(self.provider), bstr("localhost"), bstr("")), None
        if what == "get":
            return _GET_TAG, (program.handle,), None
        self.values += 1
        value = i4(self.values)
        return _PUT_TAG, (i4(_WRONG) if what == "wrong" else program.handle, value), self.values

    def _due(self) -> int | None:
        times = [program.requester.deadline for program in self.programs.values()]
        times += [self.simulator.due(self.now), self.network[0].due if self.network else None]
        return min((time for time in times if time is not None), default=None)

    def _step(self) -> None:
        """Do all that is due now."""
        while self.network and self.network[0].due <= self.now:
            self._arrive(heapq.heappop(self.network))
        self._reply(self.simulator.advance(self.now))
        for program in list(self.programs.values()):
            program.requester.handle_timeout(self.now)
            self._settle(program)

    def _arrive(self, packet: Packet) -> None:
        if packet.to_controller:
            self._reply(self.simulator.on_datagram(packet.peer, packet.data, self.now))
            return
        program = self.programs[packet.peer]
        for item in parse_datagram(packet.data):
            program.requester.receive_item(item, self.now)
        self._settle(program)

    def _reply(self, outputs: list[SimulatorOutput]) -> None:
        for peer, data in outputs:
            self._send(str(peer), False, data)

    def _send(self, peer: str, to_controller: bool, data: bytes) -> None:
        for _ in range(1 + (self.chance.random() < self.weather.twice)):
            if self.chance.random() >= self.weather.loss:
                due = self.now + round(self.chance.uniform(0, self.weather.slowest) * MS)
                self.packets += 1
                life = self.programs[peer].life
                heapq.heappush(self.network, Packet(due, self.packets, peer, to_controller, data, life))

    def _settle(self, program: Program) -> None:
        for raw in program.requester.data_to_send():
            self._send(program.name, True, raw)
        for event in program.requester.drain_events():
            self._hear(program, event)

    def _hear(self, program: Program, event: RequesterEvent) -> None:
        function, value = program.asked
        if isinstance(event, LateReply | CallExecuting):
            return
        if isinstance(event, CallTimedOut):
            self.ended += 1
            assert len(event.attempts) == program.pace.retries + 1
            if value is not None:
                program.doubtful.add(value)
        elif isinstance(event, CallAnswered):
            self.ended += 1
            self._check_answer(program, function, value, event)
        elif isinstance(event, CallRefused):
            self.ended += 1
            assert event.reply.code == E_HANDLE or not program.is_new
        else:
            assert not program.is_new, f"{event} has a serial that was never asked with"

    def _check_answer(self, program: Program, function: int, value: object, event: CallAnswered) -> None:
        if function == _START:
            program.started = True
        elif function == _CONNECT and not program.is_new:
            # A program that starts anew uses serials again that the controller may still know.
            program.handle = i4(_WRONG)
        elif not program.is_new:
            pass
        elif function == _CONNECT:
            program.handle = event.reply.arguments[0].variant
        elif function == _PUT_TAG:
            assert self.ran[value] == 1
            program.last_put = value
        elif function == _GET_TAG:
            # What had no answer in time may be done later than what was asked after it.
            told = event.reply.arguments[0].variant.value if event.reply.arguments else None
            assert told == program.last_put or told in program.doubtful


TestLives = Lives.TestCase
TestLives.settings = settings(stateful_step_count=60)
