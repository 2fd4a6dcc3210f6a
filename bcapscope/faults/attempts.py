"""Which try of its call a request is, and which try a response answers."""

from __future__ import annotations

from bcapscope.protocol.frame import Frame
from bcapscope.traffic.observation import Conversation, Direction, Flow, Transport
from bcapscope.traffic.question import MOST_CONVERSATIONS, MOST_SERIALS

MOST_TRIES = 16
"""Twice of what any client sends for one call, the one that tries without end left out."""


class _Call:
    """A call and how many packets have asked for it."""

    __slots__ = ("content", "tries")

    def __init__(self, content: bytes, tries: int) -> None:
        self.content = content
        self.tries = tries


class Attempts:
    """Counts tries by the serials that retries name, in every convention of the reserved field.

    Nothing is sent twice on TCP: all that comes there is a first try.
    """

    def __init__(self) -> None:
        self._conversations: dict[Conversation, _Serials] = {}

    def number(self, flow: Flow, frame: Frame) -> int | None:
        """Tell which try of its call a frame is, or answers; 1 is the first.

        None for a response to what was not asked lately.
        """
        if flow.conversation.transport is Transport.TCP:
            return 1
        serials = self._conversations.pop(flow.conversation, None) or _Serials()
        while len(self._conversations) >= MOST_CONVERSATIONS:
            del self._conversations[next(iter(self._conversations))]
        self._conversations[flow.conversation] = serials
        if flow.direction is Direction.RESPONSE:
            found = serials.find(frame.serial)
            return found[1] if found else None
        return serials.ask(frame)


class _Serials:
    """Serials of one conversation with their calls and numbers of tries, in two generations."""

    __slots__ = ("earlier", "latest")

    def __init__(self) -> None:
        self.latest: dict[int, tuple[_Call, int]] = {}
        self.earlier: dict[int, tuple[_Call, int]] = {}

    def find(self, serial: int) -> tuple[_Call, int] | None:
        return self.latest.get(serial) or self.earlier.get(serial)

    def ask(self, frame: Frame) -> int:
        serial, reserved, content = frame.serial, frame.reserved, frame.raw[9:]
        known = self.find(serial)
        if known and known[0].content == content and reserved not in (0, serial):
            return known[1]  # the network has made a copy of it
        call, number = self._call_of(serial, reserved, content)
        call.tries = max(call.tries, number)
        self.latest[serial] = (call, number)
        if len(self.latest) >= MOST_SERIALS:
            self.earlier, self.latest = self.latest, {}
        return number

    def _call_of(self, serial: int, reserved: int, content: bytes) -> tuple[_Call, int]:
        if reserved in (0, serial):
            return _Call(content, 1), 1
        origin = self.find(reserved)
        if origin and origin[0].content == content:
            return origin[0], origin[0].tries + 1
        # The first try was lost before it came here; serials count on from it.
        behind = (serial - reserved) & 0xFFFF
        number = behind + 1 if behind < MOST_TRIES else 2
        call = _Call(content, number)
        self.latest[reserved] = (call, 1)
        return call, number
