"""Rule about clients that make a separate call for each value, and therefore often wait for replies."""

from __future__ import annotations

from collections.abc import Iterator

from bcapscope.analysis.client_state import ClientState
from bcapscope.analysis.finding_places import client_place
from bcapscope.analysis.rules.rule_checker import (
    CallHealth,
    ClientEnd,
    Occurrence,
    RuleChecker,
    last_frame_time,
)
from bcapscope.messages import Message
from bcapscope.messages.places import Count, Duration, Quantity, WireText
from bcapscope.protocol.tables.function_table import ID
from bcapscope.traffic.call import Call
from bcapscope.traffic.call_kind import CallKind
from bcapscope.traffic.observation import Conversation

_FEWEST_READS = 200
_LEAST_SHARE = 0.5
_LEAST_TIME_SHARE = 0.1
_MAX_NAMES = 256


class _VariableReads:
    def __init__(self, call: Call) -> None:
        self.first = self.last = call
        self.count = 0
        self.spent_ns = 0
        self.names: dict[str, int] = {}

    @property
    def took_ns(self) -> int:
        return last_frame_time(self.last) - self.first.request.time

    def add(self, call: Call, name: str) -> None:
        self.last = call
        self.count += 1
        self.spent_ns += call.latency or 0
        if name in self.names or len(self.names) < _MAX_NAMES:
            self.names[name] = self.names.get(name, 0) + 1


class PollingChecker(RuleChecker):
    by_client: dict[Conversation, _VariableReads]

    def wants_call(self, call_kind: CallKind, health: CallHealth) -> bool:
        return call_kind.function_id == ID["Variable_GetValue"]

    def on_call(self, call: Call, client: ClientState) -> None:
        reads = self.by_client.get(call.conversation)
        if reads is None:
            reads = self.by_client[call.conversation] = _VariableReads(call)
        reads.add(call, client.target_object.label if client.target_object is not None else "")

    def end_occurrences(self, end: ClientEnd) -> Iterator[Occurrence]:
        reads, calls = self.by_client.get(end.client.conversation), end.client.call_count
        if reads is None or reads.count < max(_FEWEST_READS, calls * _LEAST_SHARE):
            return
        if reads.spent_ns >= reads.took_ns * _LEAST_TIME_SHARE:
            yield _polling(reads, calls)


def _polling(reads: _VariableReads, calls: int) -> Occurrence:
    first, last = reads.first, reads.last
    top, often = max(reads.names.items(), key=lambda item: item[1])
    fact = Message(
        f"finding.polling{'' if top else '.unnamed'}",
        reads=reads.count,
        calls=Count(calls, "call"),
        client=client_place(first.conversation),
        name=WireText(top),
        often=often,
        each=Duration(reads.spent_ns // reads.count),
        share=Quantity(round(100 * reads.spent_ns / max(reads.took_ns, 1)), "%"),
    )
    frames = (first.request.number, last.request.number)
    return Occurrence("polling", first.request.time, last.request.time, first.conversation, frames, fact)
