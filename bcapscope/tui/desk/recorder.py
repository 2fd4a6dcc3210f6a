"""Makes records of calls out of what a session lets its observer and its listener know.

Whoever makes the calls, the user or the program itself, they end up here, since all pass the same link.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextvars import ContextVar

from bcapscope.errors import Attempt
from bcapscope.protocol.frame import Frame
from bcapscope.protocol.hresult import is_failure
from bcapscope.protocol.requester import Answered, Event, Executing, Late, Refused, TimedOut
from bcapscope.protocol.variant import Variant
from bcapscope.traffic.observation import Direction, Observation
from bcapscope.traffic.opened import Opened
from bcapscope.tui.desk.record import Ending, Record, Who

WHO: ContextVar[Who] = ContextVar("who", default=Who.SCREEN)
"""Who makes the calls of the running task."""

MOST_PACKETS = 256
"""Packets that a record keeps: a peer that floods us shall not fill the memory."""


class Recorder:
    """Follows one session, in which one call comes after the other.

    Attributes:
        last: the call that ended last.
    """

    def __init__(
        self,
        take: Callable[[Record], None],
        subject: Callable[[int, Sequence[Variant]], Opened | None],
        first_number: int = 1,
    ) -> None:
        """Give each record to `take` as soon as its call has ended.

        Args:
            take: is given the records.
            subject: tells what a call was made of, by its function and its arguments.
            first_number: of the first record.
        """
        self._take = take
        self._subject = subject
        self.next_number = first_number
        self.last: Record | None = None
        self._call: _Call | None = None

    def observe(self, seen: Observation) -> None:
        """Take a packet that goes out or came in."""
        call = self._call
        if seen.flow.direction is Direction.REQUEST and call is None:
            call = self._call = _Call(seen, WHO.get())
        if call is not None:
            call.add(seen)

    def hear(self, event: Event, now: int) -> None:
        """Take what happened.

        Args:
            event: as the session tells it.
            now: ns since 1970-01-01 UTC.
        """
        call = self._call
        if call is None:
            return
        if isinstance(event, Executing):
            call.notices += 1
        elif isinstance(event, Late):
            call.late += 1
        elif isinstance(event, Answered):
            self._end(call, Ending.ANSWERED, event.reply, event.attempts, event.took)
        elif isinstance(event, Refused):
            self._end(call, Ending.REFUSED, event.reply, event.attempts, event.took)
        elif isinstance(event, TimedOut):
            self._end(call, Ending.UNANSWERED, None, event.attempts, max(0, now - call.began))

    def give_up(self, now: int) -> Record | None:
        """End the call under way: nobody waits for its answer any more.

        Args:
            now: ns since 1970-01-01 UTC.
        """
        call = self._call
        if call is None:
            return None
        self._end(call, Ending.GIVEN_UP, None, (), max(0, now - call.began))
        return self.last

    def settle(self, now: int) -> None:
        """End a call that was sent as raw bytes: its reply is the frame that came last, if any came.

        Args:
            now: ns since 1970-01-01 UTC.
        """
        call = self._call
        if call is None:
            return
        came = [seen.item for seen in call.packets if seen.flow.direction is Direction.RESPONSE]
        reply = next((item for item in reversed(came) if isinstance(item, Frame)), None)
        attempts = (Attempt(0, 0, 0),)
        if reply is None:
            self._end(call, Ending.UNANSWERED, None, attempts, max(0, now - call.began))
        else:
            ending = Ending.REFUSED if is_failure(reply.code) else Ending.ANSWERED
            self._end(call, ending, reply, attempts, call.lasted)

    def _end(
        self, call: _Call, ending: Ending, reply: Frame | None, attempts: tuple[Attempt, ...], took: int
    ) -> None:
        request = call.packets[0].item
        code = request.code if isinstance(request, Frame) else -1
        given = request.arguments if isinstance(request, Frame) else ()
        arguments = tuple(each.variant for each in given)
        self._call = None
        self.last = Record(
            number=self.next_number,
            who=call.who,
            began=call.began,
            function_id=code,
            arguments=arguments,
            ending=ending,
            reply=reply,
            took=took,
            attempts=attempts,
            packets=tuple(call.packets),
            notices=call.notices,
            late=call.late,
            subject=self._subject(code, arguments),
        )
        self.next_number += 1
        self._take(self.last)


class _Call:
    """A call under way."""

    def __init__(self, first: Observation, who: Who) -> None:
        self.began = first.time
        self.who = who
        self.packets: list[Observation] = []
        self.lasted = 0
        self.notices = 0
        self.late = 0

    def add(self, seen: Observation) -> None:
        self.lasted = max(self.lasted, seen.time - self.began)
        if len(self.packets) < MOST_PACKETS:
            self.packets.append(seen)
