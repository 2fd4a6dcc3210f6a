"""Playing a playbook: its clients, what is lost on their way, and whether the replies are right."""

from __future__ import annotations

import re
from math import isclose

from bcapscope.faults.document import read_document
from bcapscope.protocol.codec.frame import Frame, encode_frame
from bcapscope.protocol.codec.variant import ARRAY, VT, Value, Variant
from bcapscope.protocol.codec.variant_notation import parse_variant
from bcapscope.protocol.tables.function_table import function_by_name
from bcapscope.protocol.tables.hresult import S_EXECUTING
from bcapscope.simulator.scenario_event import AnyEvent
from bcapscope.simulator.simulator import SimulatorOutput
from tests.simulator.playbook import Playbook, Step, arguments, first_names
from tests.simulator.simulation import MS, Simulation

PATIENCE = 30_000 * MS
TIMEOUT = 16
"""ms that a client waits before it sends a request again: DENSO's ROS driver in slave mode."""

_SHAPE = re.compile(r"([a-z]+\d?)(\[(\d*)\])?")


class Wrong(AssertionError):
    """A reply is not what the playbook says."""


class Speaker:
    """One client: its serials, what it puts into reserved, and what has come for it.

    Reserved is 0 on TCP. On UDP `seed` is 0 and then the serial of the first attempt, `own` the serial of the
    first attempt from the start, `chain` the serial of the attempt before.
    """

    def __init__(self, transport: str, reserved: str) -> None:
        self.tcp = transport == "tcp"
        self.convention = reserved
        self.serial = 1
        self.inbox: list[Frame] = []
        self.asked = 0
        """Serial of the request that `gets` waits for."""

    def encode(self, function_id: int, values: list[Variant], first: int) -> bytes:
        """Make an attempt of the call whose first attempt had the serial `first`."""
        retried = self.serial != first
        previous = {"own": first, "seed": first * retried, "chain": (self.serial - 1) * retried, "zero": 0}
        return encode_frame(self.serial, previous[self.convention], function_id, values)

    def reply(self) -> Frame | None:
        """Take the reply to the request that was sent last; S_EXECUTING and late replies are skipped."""
        found = [each for each in self.inbox if each.serial == self.asked and each.code != S_EXECUTING]
        if found:
            del self.inbox[: self.inbox.index(found[0]) + 1]
        return found[0] if found else None


class Performance:
    """A controller, the clients of a playbook and what they have stored."""

    def __init__(self, playbook: Playbook, profile: str) -> None:
        self.simulation = Simulation.of(playbook.scenario)
        self.names = first_names(profile)
        self.speakers = {name: Speaker(*how) for name, how in playbook.clients.items()}
        self.connect()

    def connect(self) -> None:
        """Connect the clients that use TCP."""
        for name, speaker in self.speakers.items():
            assert not speaker.tcp or self.simulation.answerer.on_connect(name, self.simulation.now)

    def play(self, step: Step) -> None:
        """Do one step.

        Raises:
            Wrong: the reply is another than the playbook says.
        """
        if step.subject == "wait":
            number, unit = step.words
            assert unit == "ms"
            self.deliver(self.simulation.wait(float(number)))
        elif step.subject == "controller":
            event: AnyEvent = read_document(step.words[0], AnyEvent)  # type: ignore[arg-type]  # a union
            self.deliver(event.apply(self.simulation.simulator, self.simulation.now) or [])
        else:
            for repetition in range(step.times):
                self._speak(step, repetition)

    def _speak(self, step: Step, repetition: int) -> None:
        began = self.simulation.now
        if step.verb != "gets":
            self._send(step, repetition)
        if step.reply is None:
            return
        frame = self._wait(self.speakers[step.subject], step)
        took = (self.simulation.now - began) / MS
        values = frame.variants
        said = f"{frame.code:08X} {values[0] if values else 'no argument'} in {took:g} ms"
        right = frame.code == step.reply.result and self._fits(step.reply.value, values)
        if not right or (step.reply.ms is not None and not isclose(took, step.reply.ms, abs_tol=0.01)):
            raise Wrong(
                f"{step.place} ({repetition}): {' '.join(step.words)}\n  {step.reply}\n  came: {said}"
            )

    def _send(self, step: Step, repetition: int) -> None:
        speaker = self.speakers[step.subject]
        function = function_by_name(step.words[0])
        assert function is not None, f"{step.place}: {step.words[0]!r} is no function"
        values = arguments(step.words[1:], self.names, repetition)
        first = speaker.serial
        for fate in (*step.fates, ""):
            raw = speaker.encode(function.id, values, first)
            speaker.asked = speaker.serial
            speaker.serial += 1
            if fate != "request lost":
                self.deliver(self.transmit(step.subject, raw))
            if step.verb == "abandons":
                speaker.serial -= 1  # the Python client advances it only with a reply
            if fate:
                self.deliver(self.simulation.wait(TIMEOUT))
                speaker.inbox.clear()

    def transmit(self, name: str, raw: bytes) -> list[SimulatorOutput]:
        """Send a request of a client to the controller; return what is to be delivered."""
        answerer, now = self.simulation.answerer, self.simulation.now
        return (
            answerer.on_segment(name, raw, now)
            if self.speakers[name].tcp
            else answerer.on_datagram(name, raw, now)
        )

    def _wait(self, speaker: Speaker, step: Step) -> Frame:
        end = self.simulation.now + PATIENCE
        while (frame := speaker.reply()) is None:
            due = self.simulation.answerer.due(self.simulation.now)
            if due is None or due > end:
                raise Wrong(f"{step.place}: {' '.join(step.words)}: no reply")
            self.simulation.now = max(due, self.simulation.now + 1)
            self.deliver(self.simulation.answerer.advance(self.simulation.now))
        return frame

    def deliver(self, outputs: list[SimulatorOutput]) -> None:
        """Bring the clients what the controller sends."""
        for peer, data in outputs:
            self.speakers[str(peer)].inbox.append(Frame(data))

    def _fits(self, tokens: tuple[str, ...], values: tuple[Variant, ...]) -> bool:
        """Return whether the arguments of a reply are what `tokens` say; a name is given to what fits."""
        if not tokens:
            return True
        if tokens == ("none",):
            return not values
        return len(values) == 1 and self._matches(list(tokens), values[0])

    def _matches(self, tokens: list[str], value: Variant) -> bool:
        """Return whether a value is what the first tokens say, which are taken off."""
        token = tokens.pop(0)
        if token == "(":
            items = value.value if value.vt == ARRAY | VT.VARIANT else ()
            assert isinstance(items, tuple)
            fits = all([isinstance(item, Variant) and self._matches(tokens, item) for item in items])
            return value.vt == ARRAY | VT.VARIANT and fits and tokens.pop(0) == ")"
        if token.startswith("$"):
            self.names[token] = value
            return value.vt == VT.I4
        if token == "EMPTY":
            return value.vt == VT.EMPTY
        if token.startswith('"'):
            return (value.vt, value.value) == (VT.BSTR, token.strip('"'))
        shape = _SHAPE.fullmatch(token)
        return _has_shape(value, shape) if shape else _equals(value, parse_variant(token))


def _has_shape(value: Variant, shape: re.Match[str]) -> bool:
    vt = VT[shape[1].upper()]
    if not shape[2]:
        return value.vt == vt
    assert isinstance(value.value, tuple | bytes | str | int | float | None)
    length = len(value.value) if isinstance(value.value, tuple | bytes) else None
    return value.vt == ARRAY | vt and (not shape[3] or length == int(shape[3]))


def _equals(value: Variant, other: Variant) -> bool:
    if value.vt != other.vt:
        return False
    ours, others = value.value, other.value
    if isinstance(ours, tuple) and isinstance(others, tuple):
        return len(ours) == len(others) and all(map(_same, ours, others))
    return _same(ours, others)


def _same(one: Value | Variant, other: Value | Variant) -> bool:
    if isinstance(one, float) and isinstance(other, float):
        return isclose(one, other, abs_tol=1e-4)
    return one == other
