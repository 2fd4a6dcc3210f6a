"""Traffic through a proxy, written down by hand: what both legs show."""

from __future__ import annotations

from bcapscope.protocol.codec.variant import Variant
from bcapscope.traffic.call import Call
from bcapscope.traffic.joining.joiner import Joiner
from bcapscope.traffic.observation import SERVER_PORT, Conversation, Endpoint, Observation, Transport
from bcapscope.traffic.pipeline import CallCollector, Pipeline
from tests.traffic.playbook import Client, Script, text

Question = tuple[int, tuple[Variant, ...]]

PROXY, CONTROLLER = Endpoint("10.0.0.3", 5008), Endpoint("10.0.0.1", 5007)
LEG_MS = 0.2
"""Time from one leg of the proxy to the other."""

START_SERVICE: Question = (1, (text(""),))


class ProxiedScript(Script):
    """Observations of clients whose traffic goes through a proxy."""

    def proxied_client(self, port: int = 50001, transport: Transport = Transport.UDP) -> ProxiedClient:
        near = Conversation(Endpoint("10.0.0.2", port), PROXY, transport, SERVER_PORT)
        far = Conversation(Endpoint("10.0.0.3", port + 10_000), CONTROLLER, transport, SERVER_PORT)
        return ProxiedClient(Client(self, near), Client(self, far))

    def in_order(self) -> list[Observation]:
        """Return the observations by time, with new numbers."""
        by_time = sorted(self.seen, key=lambda seen: (seen.time, seen.number))
        return [seen._replace(number=number, packet=number) for number, seen in enumerate(by_time, 1)]

    def calls(self, comments: dict[int, tuple[str, ...]] | None = None) -> list[Call]:
        """Return the calls of the joined traffic, in starting order."""
        collector = CallCollector()
        pipeline = Pipeline(collector, joiner=Joiner(comments or {}))
        for seen in self.in_order():
            pipeline.add(seen)
        pipeline.finish()
        return sorted(collector.calls, key=lambda call: call.number)


class ProxiedClient:
    """A client, on both legs of the proxy."""

    def __init__(self, near: Client, far: Client) -> None:
        self.near, self.far = near, far

    def ask(
        self,
        ms: float,
        serial: int,
        reserved: int,
        question: Question,
        *,
        lost: bool = False,
        held: float = LEG_MS,
    ) -> None:
        """Send a request, which the proxy forwards after `held` ms unless it is lost in the proxy."""
        self.near.ask(ms, serial, reserved, question)
        if not lost:
            self.far.ask(ms + held, serial, reserved, question)

    def reply(
        self,
        ms: float,
        serial: int,
        *results: Variant,
        code: int = 0,
        lost: bool = False,
        held: float = LEG_MS,
    ) -> None:
        """Let the controller reply, at the time `ms` on its leg."""
        self.far.reply(ms, serial, 0, code, *results)
        if not lost:
            self.near.reply(ms + held, serial, 0, code, *results)

    def call(self, ms: float, serial: int, question: Question, *results: Variant) -> None:
        """Make a call that is answered after 1 ms."""
        self.ask(ms, serial, 0, question)
        self.reply(ms + 0.8, serial, *results)

    def calls(self, first_ms: float, count: int, question: Question, first_serial: int = 1) -> None:
        """Make `count` calls, one every 8 ms."""
        for index in range(count):
            self.call(first_ms + 8 * index, first_serial + index, question)
