"""The player's channel and pipe in memory: a simulator at the other end, a clock that jumps, a script."""

from __future__ import annotations

import heapq
from collections.abc import Callable, Mapping
from math import cos, pi
from random import Random

from bcapscope.client.controller_target import ControllerTarget
from bcapscope.messages import Message
from bcapscope.player.blocking_caller import Channel, run_blocking
from bcapscope.player.frame_recorder import FrameRecorder
from bcapscope.player.play_session import YES, PlaySession
from bcapscope.player.player_messages import (
    Order,
    PlayEnded,
    PlayerMessage,
    PlayerQuestion,
    PlayPlan,
    QuestionTopic,
    SetPointValues,
    SlaveModePacing,
)
from bcapscope.player.player_pipe import PARENT_GONE, PlayerPipe
from bcapscope.protocol.codec.frame import Frame
from bcapscope.protocol.codec.variant import integer_value
from bcapscope.protocol.tables.command_catalogue import call_name
from bcapscope.simulator.machine import InitialState
from bcapscope.simulator.profile import PROFILES
from bcapscope.simulator.simulator import Simulator, SimulatorOutput
from bcapscope.transport.peer_link import Address

MS = 1_000_000
HOME = (0.0, 0.0, 90.0, 0.0, 90.0, 0.0, 0.0, 0.0)
_SLVMOVE = "slvMove".encode("utf-16-le")
TARGET = ControllerTarget("simulator")


class SimulatedChannel(Channel):
    """A way to a simulator, over a network that takes its time and loses some.

    Attributes:
        sent: frames that the player sent, with the time.
        points: how many of them are set points, retries included.
        heard: serials of replies that the player took, with the time.
        arrival_time: when the last of them came.
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
        self._time = self.arrival_time = began
        self.delay = delay
        self.asleep = (0, 0)
        self._loss = loss
        self._chance = Random(3).random
        self._up: list[tuple[int, int, bytes]] = []
        self._down: list[tuple[int, int, bytes]] = []
        self._count = 0

    def now(self) -> int:
        return self._time

    def wait_until(self, until: int) -> None:
        while self._step(until):
            pass

    sleep_until = wait_until

    def send(self, data: bytes) -> None:
        self.sent.append((self._time, Frame(data)))
        self.points += _SLVMOVE in data
        self._push(self._up, data)

    def receive(self, until: int) -> bytes | None:
        while True:
            if self._down and self._down[0][0] <= self._time:
                self.arrival_time, _, data = heapq.heappop(self._down)
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
        outputs: list[SimulatorOutput] = []
        while self._up and self._up[0][0] <= self._time:
            outputs += self.simulator.on_datagram("player", heapq.heappop(self._up)[2], self._time)
        outputs += self.simulator.advance(self._time)
        for output in outputs:
            self._push(self._down, output.data)
        return True


class ScriptedPipe(PlayerPipe):
    """Gives orders and answers as a script says.

    Attributes:
        messages: all messages that the player sent.
        asked: topics of the questions.
    """

    def __init__(self, answers: Mapping[QuestionTopic, str] | None = None) -> None:
        self.order: Order | None = None
        self.reason: Message | None = None
        self.order_count = 0
        self.messages: list[PlayerMessage] = []
        self.asked: list[QuestionTopic] = []
        self.at_poll: Callable[[int], Order | None] = lambda _: None
        self._polls = 0
        self._script = {QuestionTopic.BEGIN: YES, **(answers or {})}

    def poll_order(self) -> Order | None:
        self._polls += 1
        order = self.at_poll(self._polls)
        if order is not None:
            self.set_order(order, PARENT_GONE)
        return self.order

    def try_send(self, message: PlayerMessage) -> bool:
        self.messages.append(message)
        return True

    def send(self, message: PlayerMessage) -> None:
        self.messages.append(message)

    def ask(self, question: PlayerQuestion) -> str:
        self.asked.append(question.topic)
        no = question.choices[0]
        return no if self.poll_order() is not None else self._script.get(question.topic, no)


class Stage:
    """A simulator, a player and what came of it."""

    def __init__(
        self,
        profile: str = "rc8",
        start: InitialState | None = None,
        loss: float = 0.0,
        answers: Mapping[QuestionTopic, str] | None = None,
    ) -> None:
        self.simulator = Simulator(PROFILES[profile], start)
        self.channel = SimulatedChannel(self.simulator, loss)
        self.pipe = ScriptedPipe(answers)

    def play(self, plan: PlayPlan) -> PlayEnded:
        """Play a plan to its end."""
        self.session = PlaySession(plan, self.channel, self.pipe, FrameRecorder(self.pipe.send, None))
        return run_blocking(self.session.run())

    @property
    def calls(self) -> list[str]:
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
    return f"{name} {integer_value(arguments[2])}" if name == "slvChangeMode" else name


def wave(points: int = 120, height: float = 8.0) -> list[SetPointValues]:
    """Make a way of J1 there and back, at rest at both ends, from HOME."""
    return [(height * (1 - cos(2 * pi * number / (points - 1))), *HOME[1:6]) for number in range(points)]


def plan(mode: int | SlaveModePacing, **more: object) -> PlayPlan:
    """Make a plan for the usual way."""
    return PlayPlan(**{"target": TARGET, "mode": mode, "points": wave(), **more})  # type: ignore[arg-type]


def fall_silent(stage: Stage, count: int) -> None:
    """Let nothing arrive any more once so many packets with set points were sent."""

    def look(_: int) -> None:
        if stage.channel.points > count:
            stage.channel.silent_from = 0

    stage.pipe.at_poll = look
