"""All rules in one pass over the traffic."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import TypeAlias

from bcapscope.analysis.casebook import Casebook
from bcapscope.analysis.choice import Choice
from bcapscope.analysis.client import Client, Clients
from bcapscope.analysis.finding import Finding, Seen
from bcapscope.analysis.rules import WATCHERS
from bcapscope.analysis.rules.rule import Kind, all_seen, overrides
from bcapscope.analysis.rules.wire import LARGE
from bcapscope.analysis.slave import ChosenStays, SlaveWatcher
from bcapscope.analysis.speech import Speech
from bcapscope.analysis.stay import Stay
from bcapscope.protocol.frame import Malformed
from bcapscope.protocol.hresult import is_failure
from bcapscope.traffic.exchange import Exchange, FrameObservation, Settled
from bcapscope.traffic.handles import Handles
from bcapscope.traffic.observation import Conversation, Flow, Observation
from bcapscope.traffic.question import Question

MOST_QUESTIONS = 4096
"""Kinds of calls whose watchers are remembered; when more are met, all are forgotten and asked again."""

MOST_FLOWS = 65536
"""Flows that are known not to be new; when there are more, all are forgotten."""

_See: TypeAlias = Callable[[Exchange, Client], None]


class Diagnosis:
    """Looks for what went wrong; memory is bounded, whatever the traffic.

    Every observation goes to `take_observation` and everything that a tracker makes of it to `take`.
    """

    def __init__(
        self,
        chosen: Callable[[Exchange], bool] | None = None,
        heed: Callable[[Stay], object] | None = None,
    ) -> None:
        """Begin.

        Args:
            chosen: tells which calls are asked about; None for all. What is found is told if it concerns one
                of them or is what that follows from; all calls count for what happened before and after.
            heed: is given each stay in slave mode of the calls asked about, for who wants those as well.
        """
        self._book = Casebook()
        self._choice = None if chosen is None else Choice(chosen, self._book.report)
        report = self._book.report if self._choice is None else self._choice.report
        self._clients = Clients(self._drop)
        self._handles = Handles(most_over=0)
        self._slave = SlaveWatcher()
        watchers = [watcher(report, self._clients) for watcher in WATCHERS]
        self._callers = overrides(watchers, "call")
        self._odd = [each.odd for each in overrides(watchers, "odd")]
        self._strays = [each.stray for each in overrides(watchers, "stray")]
        self._stays: list[Callable[[Stay], object]] = [each.stay for each in overrides(watchers, "stay")]
        self._asked: ChosenStays | None = None
        if heed is not None and chosen is None:
            self._stays.append(heed)
        elif heed is not None:
            self._asked, self._heed = ChosenStays(chosen), heed
        self._gone = [each.gone for each in overrides(watchers, "gone")]
        self._fresh = [each.fresh for each in overrides(watchers, "fresh")]
        self._forgetters = [each.forget for each in overrides(watchers, "forget")]
        self._calls = self._not_followed = self._ended = 0
        self._seers: dict[tuple[Question, Kind], tuple[_See, ...]] = {}
        self._flows: set[Flow] = set()
        self._first: Observation | None = None
        self._last: Observation | None = None
        # The stay in slave mode of which the next set point is expected.
        self._client: Client
        self._conversation: Conversation | None = None
        self._question: Question | None = None

    def take_observation(self, seen: Observation) -> None:
        """See the next frame, or the next bytes that are none, before what the tracker makes of it."""
        item = seen.item
        if self._choice is not None:
            self._choice.look(seen)
        if seen.flow not in self._flows:
            self._meet(seen)
        self._last = seen
        if item.__class__ is Malformed or len(item.raw) >= LARGE:
            for look in self._odd:
                look(seen)

    def take(self, settled: Settled) -> None:
        """See a call that has settled, or a reply that belongs to none."""
        if self._choice is not None:
            self._choice.settle(settled)
        if isinstance(settled, Exchange):
            if self._asked is not None:
                self._hand_over(self._asked.take(settled))
            if settled.question is self._question and settled.conversation is self._conversation:
                reply, frame = settled.reply, settled.request.item
                if (
                    reply is not None
                    and not reply.item.code
                    and not settled.others
                    and frame.reserved in (0, frame.serial)
                ):
                    self._client.take_point(settled)
                    stays = self._slave.take(settled)
                    if stays:
                        self._tell(stays)
                    return
            self._take_call(settled)
        else:
            self._look_inside(settled.seen)
            for judge in self._strays:
                judge(settled)

    def _take_call(self, call: Exchange) -> None:
        client = self._clients.of(call)
        client.thing = self._handles.follow(call)
        for seen in all_seen(call):
            self._look_inside(seen)
        self._not_followed += call.let_go
        kind = _kind(call)
        seers = self._seers.get((call.question, kind))
        if seers is None:
            seers = self._learn((call.question, kind))
        for see in seers:
            see(call, client)
        self._tell(self._slave.take(call))
        client.learn(call)
        # Of set points, of which there may be millions, the first of a stay is looked at by all, and then
        # only those that went wrong.
        is_point = bool(client.points) and client.points[-1] is call
        self._question = call.question if is_point else None
        self._client, self._conversation = client, call.conversation

    def _look_inside(self, seen: FrameObservation) -> None:
        """Show a frame with problems; a large one was seen by now."""
        if seen.item.problems and len(seen.item.raw) < LARGE:
            for look in self._odd:
                look(seen)

    def _tell(self, stays: Sequence[Stay]) -> None:
        for stay in stays:
            for tell in self._stays:
                tell(stay)

    def _hand_over(self, stays: Sequence[Stay]) -> None:
        for stay in stays:
            self._heed(stay)

    def forget(self, conversation: Conversation) -> None:
        """Let go of a conversation that is over, all of whose calls were taken."""
        self._flows = {flow for flow in self._flows if flow.conversation is not conversation}
        if conversation is self._conversation:
            self._conversation = self._question = None
        self._handles.forget(conversation)
        self._tell(self._slave.forget(conversation))
        self._clients.depart(conversation)
        for forget in self._forgetters:
            forget(conversation)

    def finish(self, ended: int = 0, present: bool = False) -> tuple[Finding, ...]:
        """Tell all that was found, the first cause first; nothing more is to be taken after that.

        Args:
            ended: when the traffic ended, nanoseconds since 1970; the last frame at the earliest.
            present: clients that fell silent are known to be still there.
        """
        self._ended = max(self._ended, ended)
        if self._choice is not None:
            self._choice.close()
        self._tell(self._slave.finish(self._end))
        if self._asked is not None:
            self._hand_over(self._asked.finish(self._end))
        for client in self._clients:
            client.present = present
            self._goodbye(client)
        return self._book.findings(self._speech)

    def news(self) -> tuple[Finding, ...]:
        """Tell what was found since the last time; what it follows from shows when all is seen."""
        return self._book.news(self._speech)

    @property
    def seen(self) -> Seen:
        """How much was seen so far."""
        first, last = self._first, self._last
        if first is None or last is None:
            return Seen(0, 0, 0, 0)
        calls = self._calls + sum(client.calls for client in self._clients)
        chosen = None if self._choice is None else self._choice.calls
        frames, lasted = last.number - first.number + 1, self._end - first.time
        return Seen(frames, calls, self._clients.seen, lasted, self._not_followed, chosen)

    @property
    def _speech(self) -> Speech:
        start = self._first.time if self._first is not None else 0
        return Speech(start, self._clients.seen <= 1)

    @property
    def _end(self) -> int:
        return max(self._ended, self._last.time if self._last is not None else 0)

    def _meet(self, seen: Observation) -> None:
        """See a flow for the first time."""
        if self._first is None:
            self._first = seen
        if len(self._flows) >= MOST_FLOWS:
            self._flows.clear()
        self._flows.add(seen.flow)
        for look in self._fresh:
            look(seen)

    def _learn(self, key: tuple[Question, Kind]) -> tuple[_See, ...]:
        if len(self._seers) >= MOST_QUESTIONS:
            self._seers.clear()
        seers = self._seers[key] = tuple(each.call for each in self._callers if each.heeds(*key))
        return seers

    def _drop(self, client: Client) -> None:
        self._calls += client.calls
        self._goodbye(client)

    def _goodbye(self, client: Client) -> None:
        for tell in self._gone:
            tell(client, self._end)


def _kind(call: Exchange) -> Kind:
    reply = call.reply
    if reply is not None and is_failure(reply.item.code):
        return Kind.REFUSED
    return Kind.SMOOTH if reply is not None and call.is_plain else Kind.TROUBLED
