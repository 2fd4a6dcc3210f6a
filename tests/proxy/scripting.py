"""Scripts in this process: their answers wait until a test lets them come."""

from __future__ import annotations

from collections.abc import Callable

from bcapscope.messages import Message
from bcapscope.proxy.addons import AddonClient, AddonRunner, PassingMessage
from bcapscope.proxy.rule_policy import RulePolicy
from bcapscope.proxy.script_process import ScriptProcess
from bcapscope.proxy.script_protocol import FrameUnpacker, ScriptOrder, pack
from bcapscope.proxy.script_queue import TIME_LIMIT_NS, ScriptQueue
from tests.faults.traffic import request


class Here(ScriptProcess):
    """Runs addons here, as a link to them.

    Attributes:
        queue: of what waits for them.
        obeys: orders are obeyed; else they are lost in an endless loop.
        arrived: what has come and was not read yet.
        place: what is known about the end of their process.
        located: how often it was asked where they are.
        ended: how often they were ended.
    """

    def __init__(self, *addons: object, limit: int = TIME_LIMIT_NS) -> None:
        self.obeys = True
        self.arrived = b""
        self.place: tuple[Message, ...] = ()
        self.located = self.ended = 0
        self._addons = AddonRunner(addons, clock=lambda: 0)
        self._orders: FrameUnpacker[ScriptOrder] = FrameUnpacker(ScriptOrder)
        self._answers: list[bytes] = []
        self.queue = ScriptQueue("mine.py", self, limit)
        self.queue.on_loaded(self._addons.hooks)

    @property
    def waiting(self) -> int:
        """How many answers have not come."""
        return len(self._answers)

    def send(self, frame: bytes) -> None:
        """Obey an order; its answer waits."""
        self._orders.feed_bytes(frame)
        while (order := self._orders.next_frame()) is not None:
            if self.obeys:
                self._answers.append(pack(self._addons.execute(order)))

    def receive(self) -> bytes | None:
        """Give what `arrived` says has come."""
        found, self.arrived = self.arrived, b""
        return found or None

    def locate(self) -> None:
        """Count that."""
        self.located += 1

    def end(self) -> tuple[Message, ...]:
        """Count that."""
        self.ended += 1
        return self.place

    def finish(self, frame: bytes, is_done: Callable[[bytes], bool]) -> bool:
        """Let all answers come."""
        self.send(frame)
        return is_done(self.take())

    def take(self, count: int | None = None) -> bytes:
        """Give the next answers, all of them unless told."""
        found, self._answers = self._answers[:count], [] if count is None else self._answers[count:]
        return b"".join(found)

    def answer(self, rules: RulePolicy, now: int, count: int | None = None) -> None:
        """Let answers come. If there are none, nothing comes: no bytes would be the end of the process."""
        if data := self.take(count):
            rules.on_script_data(data, now)


class Meddler:
    """Changes, drops and answers by serial."""

    def request(self, message: PassingMessage) -> None:
        assert message.frame is not None
        match message.frame.serial:
            case 1:
                message.drop()
            case 2:
                message.answer("E_FAIL")
            case 3:
                message.data = request(33)
            case 4:
                raise RuntimeError("oh")

    def reply(self, message: PassingMessage) -> None:
        if message.command == "CurJnt":
            message.drop()


class Listener:
    """Hears what has settled, who comes and goes, and of the end."""

    def __init__(self) -> None:
        self.heard: list[object] = []
        self.others: list[str] = []

    def settled(self, call: object) -> None:
        self.heard.append(call)

    def connected(self, client: AddonClient) -> None:
        self.others.append(f"{client.number} {client.address}")

    def gone(self, client: AddonClient) -> None:
        self.others.append("gone")

    def done(self) -> None:
        self.others.append("done")
