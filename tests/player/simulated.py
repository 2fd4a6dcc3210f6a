"""The player's channel and desk in memory: a simulator at the other end, a clock that jumps, a script."""

from __future__ import annotations

import heapq
from collections.abc import Callable, Mapping
from math import cos, pi
from random import Random

from bcapscope.client.target import Target
from bcapscope.player.desk import Desk
from bcapscope.player.exchanger import run
from bcapscope.player.journal import Journal
from bcapscope.player.messages import Ended, Message, Order, Pacing, Plan, Point, Question, Topic
from bcapscope.player.visit import YES, Visit
from bcapscope.protocol.commands import call_name
from bcapscope.protocol.frame import Frame
from bcapscope.protocol.slavemode import mode_value
from bcapscope.simulator.machine import Start
from bcapscope.simulator.profile import PROFILES
from bcapscope.simulator.simulator import Output, Simulator
from bcapscope.transport.link import Address

MS = 1_000_000
HOME = (0.0, 0.0, 90.0, 0.0, 90.0, 0.0, 0.0, 0.0)
_SLVMOVE = "slvMove".encode("utf-16-le")
TARGET = Target("simulator")


class SimulatedChannel:
    """A way to a simulator, over a network that takes its time and loses some.

    Attributes:
        sent: frames that the player sent, with the time.
        points: how many of them are set points, retries included.
        heard: serials of replies that the player took, with the time.
        arrived: when the last of them came.
        delay: ns that a packet takes.
        asleep: from when to when the simulator gets no processor; what comes meanwhile waits.
        silent_from: time from which on nothing arrives any more; None for never.
    """

    datagrams = True
    local: Address = ("127.0.0.1", 50000)
    peer: Address = ("127.0.0.1", 5007)

    def __init__(
        self, simulator: Simulator, loss: float = 0.0, delay: int = MS // 10, began: int = 0
    ) -> None:
        self.simulator = simulator
        self.sent: list[tuple[int, Frame]] = []
        self.points = 0
        self.heard: list[tuple[int, int]] = []
        self.silent_from: int | None = None
        self._time = self.arrived = began
        self.delay = delay
        self.asleep = (0, 0)
        self._loss = loss
        self._chance = Random(3).random
        self._up: list[tuple[int, int, bytes]] = []
        self._down: list[tuple[int, int, bytes]] = []
        self._count = 0

    def now(self) -> int:
        return self._time

    def wait(self, until: int) -> None:
        while self._step(until):
            pass

    rest = wait

    def send(self, data: bytes) -> None:
        self.sent.append((self._time, Frame(data)))
        self.points += _SLVMOVE in data
        self._push(self._up, data)

    def receive(self, until: int) -> bytes | None:
        while True:
            if self._down and self._down[0][0] <= self._time:
                self.arrived, _, data = heapq.heappop(self._down)
                self.heard.append((Frame(data).serial, self._time))
                return data
            due = min(until, self._down[0][0]) if self._down else until
            if not self._step(due) and self._time >= until:
                return None

    def close(self) -> None:
        self.silent_from = 0

    def _push(self, queue: list[tuple[int, int, bytes]], data: bytes) -> None:
        dead = self.silent_from is not None and self._time >= self.silent_from
        if not dead and self._chance() >= self._loss:
            self._count += 1
            heapq.heappush(queue, (self._time + self.delay, self._count, data))

    def _step(self, until: int) -> bool:
        """Let time pass until something happens; return False once it is `until`."""
        if self._time >= until:
            return False
        if self.asleep[0] <= self._time < self.asleep[1]:
            self._time = min(until, self.asleep[1])
            return True
        due = self.simulator.due(self._time)
        times = [until, *(max(due, self._time + 1) for due in (due,) if due is not None)]
        if self._up:
            times.append(max(self._up[0][0], self._time))
        self._time = min(times)
        outputs: list[Output] = []
        while self._up and self._up[0][0] <= self._time:
            outputs += self.simulator.datagram("player", heapq.heappop(self._up)[2], self._time)
        outputs += self.simulator.advance(self._time)
        for output in outputs:
            self._push(self._down, output.data)
        return True


class ScriptedDesk(Desk):
    """Gives orders and answers as a script says.

    Attributes:
        told: all messages.
        asked: what was asked for.
    """

    def __init__(self, answers: Mapping[Topic, str] | None = None) -> None:
        self.order: Order | None = None
        self.reason = ""
        self.orders = 0
        self.told: list[Message] = []
        self.asked: list[Topic] = []
        self.at_poll: Callable[[int], Order | None] = lambda _: None
        self._polls = 0
        self._script = {Topic.BEGIN: YES, **(answers or {})}

    def poll(self) -> Order | None:
        self._polls += 1
        order = self.at_poll(self._polls)
        if order is not None:
            self.note(order, "the script says so")
        return self.order

    def tell(self, message: Message) -> bool:
        self.told.append(message)
        return True

    def deliver(self, message: Message) -> None:
        self.told.append(message)

    def ask(self, question: Question) -> str:
        self.asked.append(question.topic)
        no = question.choices[0]
        return no if self.poll() is not None else self._script.get(question.topic, no)


class Stage:
    """A simulator, a player and what came of it."""

    def __init__(
        self,
        profile: str = "rc8",
        start: Start | None = None,
        loss: float = 0.0,
        answers: Mapping[Topic, str] | None = None,
    ) -> None:
        self.simulator = Simulator(PROFILES[profile], start)
        self.channel = SimulatedChannel(self.simulator, loss)
        self.desk = ScriptedDesk(answers)

    def play(self, plan: Plan) -> Ended:
        """Play a plan to its end."""
        self.visit = Visit(plan, self.channel, self.desk, Journal(self.desk.deliver, None))
        return run(self.visit.perform())

    @property
    def said(self) -> list[str]:
        """Calls that the player made, by function or command: set points once in a row, no reading."""
        names: list[str] = []
        for _, frame in self.channel.sent:
            if frame.reserved in (0, frame.serial):
                name = named(frame)
                is_reading = "Variable" in name or name == "slvGetMode"
                if not is_reading and (name != "slvMove" or names[-1:] != [name]):
                    names.append(name)
        return names


def named(frame: Frame) -> str:
    """Name a call: a command, slvChangeMode with its mode, else the function."""
    arguments = [argument.variant for argument in frame.arguments]
    name = call_name(frame.code, arguments).removeprefix("Robot_Execute ")
    return f"{name} {mode_value(arguments[2])}" if name == "slvChangeMode" else name


def wave(points: int = 120, height: float = 8.0) -> list[Point]:
    """Make a way of J1 there and back, at rest at both ends, from HOME."""
    return [(height * (1 - cos(2 * pi * number / (points - 1))), *HOME[1:6]) for number in range(points)]


def plan(mode: int | Pacing, **more: object) -> Plan:
    """Make a plan for the usual way."""
    return Plan(**{"target": TARGET, "mode": mode, "points": wave(), **more})  # type: ignore[arg-type]


def fall_silent(stage: Stage, count: int) -> None:
    """Let nothing arrive any more once so many packets with set points were sent."""

    def look(_: int) -> None:
        if stage.channel.points > count:
            stage.channel.silent_from = 0

    stage.desk.at_poll = look
