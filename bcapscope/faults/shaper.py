"""The machine that decides what becomes of each message: seeded, without sockets or clocks.

    shaper = Shaper(faults, seed=7, now=now)
    taken = shaper.take(flow, data, now)         # one message; do all of taken.outputs
    shaper.due()                                 # when to call advance at the latest, or None
    shaper.advance(now)                          # what is due by now

The same seed and the same messages at the same times give the same decisions. Each fault draws from random
numbers that hang on the seed and its own name alone, and draws for each message that it might strike whatever
other faults do to it: adding a fault does not change what the others do.

Faults are applied in their order, each to what the one before has left of the message. A message that is lost
or answered is out of reach of those behind, and so is one that a `pass` has let through.
"""

from __future__ import annotations

import heapq
from collections.abc import Iterable
from typing import Any, TypeAlias

from bcapscope.faults.answers import Manners
from bcapscope.faults.attempts import Attempts
from bcapscope.faults.effects import EFFECTS, Effect, Work
from bcapscope.faults.fault import AnyFault, Ending, Fault
from bcapscope.faults.message import Closing, Message, Output, Send, Taken
from bcapscope.faults.striker import Striker
from bcapscope.traffic.observation import Conversation, Direction, Flow, Transport
from bcapscope.traffic.question import Questions

MOST_WAITING = 16 << 20
"""Bytes that faults hold, each message counted with `_PARCEL_SIZE` more: a second of the traffic that fills a
100 Mbit/s line. Datagrams that would be held beyond it are lost, as in a queue of tc-netem(8)."""

_PARCEL_SIZE = 300
_RESPONSE = Direction.RESPONSE

_Way: TypeAlias = tuple[Conversation, Direction]


class Rule:
    """A fault at work.

    Attributes:
        striker: decides which messages it strikes; has its name, its switch and its count.
        effect: does it.
    """

    __slots__ = ("effect", "striker")

    def __init__(self, striker: Striker) -> None:
        self.striker = striker
        self.effect: Effect[Any] = EFFECTS[type(striker.fault)](striker.fault)


class _Parcel:
    """Something that waits for its time.

    Attributes:
        output: None once it has gone with another.
        behind: how many messages of its flow it still waits for; 0 if it waits for its time only.
        size: bytes that it takes.
    """

    __slots__ = ("behind", "output", "size")

    def __init__(self, output: Output | None, behind: int = 0) -> None:
        self.output = output
        self.behind = behind
        self.size = _PARCEL_SIZE + (len(output.data) if isinstance(output, Send) else 0)


class Shaper:
    """Applies faults to messages. Datagrams go in as they come, streams cut into frames.

    Attributes:
        rules: the faults at work, in their order.
    """

    def __init__(self, faults: Iterable[AnyFault] = (), *, seed: int = 0, now: int, epoch: int = 0) -> None:
        """Set up faults.

        Args:
            faults: in the order in which they are applied.
            seed: of all random numbers.
            now: ns of the clock that all methods are given; `after` of the faults counts from here.
            epoch: what to add to it for ns since 1970-01-01 UTC, for filters that ask for the time.

        Raises:
            ValueError: two faults have the same name.
        """
        self.rules: list[Rule] = []
        self._seed = seed
        self._epoch = epoch
        self._messages = 0
        self._learns = False
        self._questions, self._attempts, self._manners = Questions(), Attempts(), Manners()
        self._waiting: list[tuple[int, int, _Parcel]] = []
        self._counted = 0
        self._waiting_bytes = 0
        self._stream_until: dict[_Way, int] = {}
        self._overtaken: dict[_Way, list[_Parcel]] = {}
        self._dead: dict[Conversation, str] = {}
        for fault in faults:
            self.add(fault, now)

    # faults

    def add(self, fault: AnyFault, now: int) -> str:
        """Set up one more fault, behind all others, and return its name.

        Raises:
            ValueError: another one has its name.
        """
        names = {rule.striker.name for rule in self.rules}
        if fault.name in names:
            raise ValueError(f"there is a fault {fault.name} already")
        name = fault.name or _made_up(fault, names)
        self.rules.append(Rule(Striker(fault, name, self._seed, now)))
        self._switched()
        return name

    def remove(self, name: str) -> None:
        """Take a fault away; what it holds goes on at its time.

        Raises:
            KeyError: there is none of this name.
        """
        self.rules.remove(self.rule(name))
        self._switched()

    def switch(self, name: str, on: bool) -> None:
        """Switch a fault on or off.

        Raises:
            KeyError: there is none of this name.
        """
        self.rule(name).striker.on = on
        self._switched()

    def rule(self, name: str) -> Rule:
        """Find a fault.

        Raises:
            KeyError: there is none of this name.
        """
        for rule in self.rules:
            if rule.striker.name == name:
                return rule
        raise KeyError(name)

    @property
    def counts(self) -> dict[str, int]:
        """How often each fault has struck, by name."""
        return {rule.striker.name: rule.striker.struck for rule in self.rules}

    def idle(self, now: int) -> bool:
        """Tell whether nothing is held and no fault can strike any more, so that nothing need pass here."""
        return (
            not self._waiting
            and not self._dead
            and all(not rule.striker.on or rule.striker.is_over(now) for rule in self.rules)
        )

    def needs_frames(self, now: int) -> bool:
        """Tell whether a stream must be cut into frames; else its bytes may come as they are."""
        return any(
            rule.striker.fault.needs_frames
            for rule in self.rules
            if rule.striker.on and not rule.striker.is_over(now)
        )

    def _switched(self) -> None:
        self._learns = any(rule.striker.on and rule.striker.learns for rule in self.rules)

    # messages

    def take(self, flow: Flow, data: bytes, now: int) -> Taken:
        """Decide about a message that came now.

        Args:
            flow: who spoke to whom; the same object for all of one direction of a conversation.
            data: a datagram, or one piece of a stream: a frame, or bytes that are none.
            now: ns; never less than before.
        """
        outputs = self.advance(now) if self._waiting else []
        if flow.conversation in self._dead:
            return self._swallow(flow.conversation, outputs)
        if not self.rules:
            return self._untouched(flow, data, now, outputs)
        self._messages += 1
        message = Message(self._messages, flow, data, now, now + self._epoch)
        if self._learns:
            message.learn(self._questions, self._attempts)
        self._manners.see(flow, data)
        struck = self._struck(message)
        if not struck:
            return self._untouched(flow, data, now, outputs)
        work = Work(message, self._manners)
        touched = tuple(self._applied(work, struck))
        if work.half_open:
            self._dead[flow.conversation] = touched[-1].partition(":")[0]
        if self.is_full and message.datagram and not work.gone:
            touched = (*touched, *_thinned(work))
        self._schedule(work, touched)
        return Taken(outputs + self.advance(now), touched, not work.gone)

    def due(self) -> int | None:
        """Tell when something held is to go on, ns; None if nothing is held."""
        return self._waiting[0][0] if self._waiting else None

    @property
    def is_full(self) -> bool:
        """Whether so much is held that no stream should be read before `advance` has let some go."""
        return self._waiting_bytes > MOST_WAITING

    def advance(self, now: int) -> list[Output]:
        """Give out all that is due by now, in order."""
        outputs: list[Output] = []
        while self._waiting and self._waiting[0][0] <= now:
            parcel = heapq.heappop(self._waiting)[2]
            self._waiting_bytes -= parcel.size
            if parcel.output is not None:
                outputs.append(parcel.output)
                if parcel.behind:
                    self._overtake(parcel)
        return outputs

    def holds(self, flow: Flow) -> bool:
        """Tell whether something of this flow is still to be sent, before its end is passed on, or never."""
        return not self.passes_end(flow.conversation) or any(
            _is_of(parcel.output, _way(flow)) for _, _, parcel in self._waiting
        )

    def passes_end(self, conversation: Conversation) -> bool:
        """Tell whether the end of one side of a connection is to be heard of: not of a half-open one."""
        return conversation not in self._dead

    def abandon(self, flow: Flow) -> list[bytes]:
        """Let go of all that is held of one direction, and return it in the order in which it was to go.

        Of a half-open conversation nothing is returned.
        """
        way = _way(flow)
        found = [entry for entry in self._waiting if _is_of(entry[2].output, way)]
        self._waiting = [entry for entry in self._waiting if not _is_of(entry[2].output, way)]
        self._recount()
        self._stream_until.pop(way, None)
        self._overtaken.pop(way, None)
        if flow.conversation in self._dead:
            return []
        outputs = [parcel.output for _, _, parcel in sorted(found, key=_order)]
        return [output.data for output in outputs if isinstance(output, Send)]

    def forget(self, conversation: Conversation) -> None:
        """Forget a conversation that is over; what is held of it is lost."""
        self._dead.pop(conversation, None)
        self._manners.forget(conversation)
        self._questions.forget(conversation)
        self._attempts.forget(conversation)
        for rule in self.rules:
            rule.effect.forget(conversation)
        for direction in Direction:
            self._stream_until.pop((conversation, direction), None)
            self._overtaken.pop((conversation, direction), None)
        self._waiting = [entry for entry in self._waiting if not _belongs(entry[2].output, conversation)]
        self._recount()

    def _recount(self) -> None:
        heapq.heapify(self._waiting)
        self._waiting_bytes = sum(parcel.size for _, _, parcel in self._waiting)

    def _struck(self, message: Message) -> list[tuple[Rule, Any]]:
        struck = []
        for rule in self.rules:
            striker = rule.striker
            if striker.matches(message) and striker.wins():
                drawn = rule.effect.draw(striker.lots, message)
                if drawn is not None:
                    struck.append((rule, drawn))
        return struck

    def _applied(self, work: Work, struck: list[tuple[Rule, Any]]) -> Iterable[str]:
        for rule, drawn in struck:
            if work.done:
                return
            what = rule.effect.apply(work, drawn, rule.striker.ends)
            if what:
                rule.striker.count()
                yield f"{rule.striker.name}: {what}"

    def _swallow(self, conversation: Conversation, outputs: list[Output]) -> Taken:
        return Taken(outputs, (f"{self._dead[conversation]}: dropped, the conversation is dead",), False)

    def _untouched(self, flow: Flow, data: bytes, now: int, outputs: list[Output]) -> Taken:
        if not self._waiting and not self._overtaken:
            outputs.append(Send(flow, data))
            return Taken(outputs)
        self._put(flow, Send(flow, data), now)
        return Taken(outputs + self.advance(now))

    def _schedule(self, work: Work, touched: tuple[str, ...]) -> None:
        message = work.message
        flow, now = message.flow, message.now
        back = _to_client(flow) if work.back else flow
        for late, raw in work.back:
            self._put(back, Send(back, raw, touched), now + late)
        if work.ending is not None:
            closing = Closing(flow.conversation, work.ending, touched)
            self._push(self._end_of(closing, now + work.delay), _Parcel(closing))
        if work.gone:
            return
        send = Send(flow, work.data, touched)
        if work.overtaken is None:
            self._put(flow, send, now + work.delay)
        else:
            behind, patience = work.overtaken
            parcel = _Parcel(send, behind)
            self._overtaken.setdefault(_way(flow), []).append(parcel)
            self._push(now + work.delay + patience, parcel)
        for late in work.copies:
            self._put(flow, send, now + work.delay + late)

    def _end_of(self, closing: Closing, when: int) -> int:
        """Tell when a connection ends that was to end at a time: in order only after what is held of it."""
        if closing.how is Ending.RESET:
            return when
        conversation = closing.conversation
        held = (due for due, _, each in self._waiting if each.output and _belongs(each.output, conversation))
        return max((when, *held))

    def _put(self, flow: Flow, send: Send, when: int) -> None:
        """Let something go at a time; bytes of a stream never before those ahead of them."""
        way = _way(flow)
        if flow.conversation.transport is Transport.TCP:
            self._stream_until[way] = when = max(when, self._stream_until.get(way, when))
        self._push(when, _Parcel(send))
        for parcel in list(self._overtaken.get(way, ())):
            parcel.behind -= 1
            if not parcel.behind:
                self._overtake(parcel)
                self._push(when, _Parcel(parcel.output))
                parcel.output = None

    def _push(self, when: int, parcel: _Parcel) -> None:
        self._counted += 1
        self._waiting_bytes += parcel.size
        heapq.heappush(self._waiting, (when, self._counted, parcel))

    def _overtake(self, parcel: _Parcel) -> None:
        """Take a parcel from those that wait to be overtaken."""
        assert isinstance(parcel.output, Send)
        way = _way(parcel.output.flow)
        waiting = self._overtaken[way]
        waiting.remove(parcel)
        if not waiting:
            del self._overtaken[way]


def _thinned(work: Work) -> Iterable[str]:
    """Lose what would be held of a datagram."""
    if work.delay or work.overtaken:
        work.lose()
        yield "dropped, too much is held already"
    elif any(work.copies):
        work.copies = [late for late in work.copies if not late]
        yield "copies dropped, too much is held already"


def _made_up(fault: Fault, names: set[str]) -> str:
    number = 1
    while (name := fault.action if number == 1 else f"{fault.action}-{number}") in names:
        number += 1
    return name


def _way(flow: Flow) -> _Way:
    return flow.conversation, flow.direction


def _to_client(flow: Flow) -> Flow:
    return flow if flow.direction is _RESPONSE else Flow(flow.conversation, _RESPONSE)


def _order(entry: tuple[int, int, _Parcel]) -> tuple[int, int]:
    return entry[:2]


def _is_of(output: Output | None, way: _Way) -> bool:
    return isinstance(output, Send) and _way(output.flow) == way


def _belongs(output: Output | None, conversation: Conversation) -> bool:
    match output:
        case Send(flow=flow):
            return flow.conversation is conversation
        case Closing(conversation=closing):
            return closing is conversation
    return True
