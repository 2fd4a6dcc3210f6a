"""Random sessions through a proxy: calls and verdicts are the truth, whatever the proxy loses or delays."""

from __future__ import annotations

import random
from dataclasses import dataclass, field

import pytest

from bcapscope.traffic.call import Call
from bcapscope.traffic.call_verdict import CallVerdict
from bcapscope.traffic.joining.joined_observation import JoinedObservation
from bcapscope.traffic.observation import Endpoint
from tests.traffic.joining.two_places import START_SERVICE, ProxiedClient, ProxiedScript
from tests.traffic.playbook import MOVE, MS, START, execute, i4

POLL = execute("CurJnt")


@dataclass
class Truth:
    """What one call really was.

    Attributes:
        losses: what was lost in the proxy: "request" or "reply", first loss first.
    """

    began: float
    attempts: int = 0
    losses: list[str] = field(default_factory=list)

    @property
    def verdict(self) -> CallVerdict:
        if not self.losses:
            return CallVerdict.ANSWERED
        return CallVerdict.REQUEST_LOST if self.losses[0] == "request" else CallVerdict.REPLY_LOST


class Program:
    """A client that calls without end, and retries after a timeout."""

    def __init__(self, client: ProxiedClient, chance: random.Random, began: float) -> None:
        self.client = client
        self.truths: list[Truth] = []
        self._chance = chance
        self._now = began
        self._serial = 0
        self._timeout = chance.choice([8.0, 20.0, 100.0, 1500.0])  # ms
        self._pause = chance.choice([0.2, 8.0, 50.0])
        self._loss = chance.choice([0.0, 0.05, 0.3])
        self._hold = chance.choice([0.0, 2.0])

    def run(self, calls: int) -> None:
        for number in range(calls):
            self._call(START_SERVICE if number == 0 else self._chance.choice([MOVE, POLL]))
            self._now += self._pause * self._chance.uniform(0.5, 1.5)

    def _call(self, question: tuple[int, tuple[object, ...]]) -> None:
        chance, truth, first = self._chance, Truth(self._now), 0
        self.truths.append(truth)
        while True:
            self._serial += 1
            truth.attempts += 1
            held = 0.1 + chance.expovariate(10) + self._hold * chance.random()
            lost = self._is_lost(truth)
            self.client.ask(self._now, self._serial, first, question, lost=lost, held=held)  # type: ignore[arg-type]
            first = first or self._serial
            if lost:
                truth.losses.append("request")
                self._now += self._timeout
                continue
            replied = self._now + held + chance.uniform(0.2, 1.0)
            back = 0.1 + chance.expovariate(10)
            lost = self._is_lost(truth)
            self.client.reply(replied, self._serial, i4(len(self.truths)), lost=lost, held=back)
            if not lost:
                self._now = replied + back
                return
            truth.losses.append("reply")
            self._now += self._timeout

    def _is_lost(self, truth: Truth) -> bool:
        """Return whether the next frame is lost. The legs of a proxy are known after the first reply."""
        is_first = len(self.truths) == 1
        return self._chance.random() < self._loss and not (is_first and len(truth.losses) == 3)


@pytest.mark.parametrize("seed", range(40))
def test_each_call_is_once_there_with_its_true_verdict(seed: int) -> None:
    chance = random.Random(seed)
    script = ProxiedScript()
    programs = [
        Program(script.proxied_client(50001 + number), chance, chance.uniform(0, 30))
        for number in range(chance.randint(1, 3))
    ]
    for program in programs:
        program.run(40)
    calls = script.calls()
    for number, program in enumerate(programs):
        client = Endpoint("10.0.0.2", 50001 + number)
        own = [call for call in calls if call.conversation.client == client]
        expected = [(round(truth.began * MS), truth.attempts, truth.verdict) for truth in program.truths]
        found = [told(call) for call in own]
        assert found == expected
        for call in own:
            assert all(isinstance(frame.observation, JoinedObservation) for frame in call.frames)
    assert len(calls) == 40 * len(programs)


def told(call: Call) -> tuple[int, int, CallVerdict]:
    return call.request.time - START, len(call.attempts), call.verdict
