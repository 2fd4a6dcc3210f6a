"""Reading value by value: where the line's time goes."""

from __future__ import annotations

from bcapscope.analysis.client import Client, Clients
from bcapscope.analysis.finding import Severity
from bcapscope.analysis.rules.rule import Incident, Kind, Report, Rule, Watcher, last_time
from bcapscope.analysis.speech import Speech, shown, span
from bcapscope.protocol.functions import ID
from bcapscope.traffic.exchange import Exchange
from bcapscope.traffic.observation import Conversation
from bcapscope.traffic.question import Question

POLLING = Rule(
    "polling",
    Severity.NOTE,
    "most calls of a client read single variables, one round trip each",
    "Read fewer or less often, or use a command that returns several values at once (GetSrvData, CurPosEx, "
    "the receive format of slvMove).",
    "ShoheiKobata/orin_bcap_python_samples (1.7 ms for each variable)",
)

_MANY = 200
_SHARE = 0.5
_MOST_NAMES = 256


class _Reads:
    """Reads of one client."""

    def __init__(self, call: Exchange) -> None:
        self.first = self.last = call
        self.count = 0
        self.spent = 0
        self.names: dict[str, int] = {}

    def add(self, call: Exchange, name: str) -> None:
        self.last = call
        self.count += 1
        self.spent += call.latency or 0
        if name in self.names or len(self.names) < _MOST_NAMES:
            self.names[name] = self.names.get(name, 0) + 1


class Polling(Watcher):
    """Counts the calls that read one value."""

    rules = (POLLING,)

    def __init__(self, report: Report, clients: Clients) -> None:
        super().__init__(report, clients)
        self._reads: dict[Conversation, _Reads] = {}

    def heeds(self, question: Question, kind: Kind) -> bool:
        return question.function_id == ID["Variable_GetValue"]

    def call(self, call: Exchange, client: Client) -> None:
        reads = self._reads.get(call.conversation)
        if reads is None:
            reads = self._reads[call.conversation] = _Reads(call)
        reads.add(call, client.thing.label if client.thing is not None else "")

    def gone(self, client: Client, ended: int) -> None:
        reads = self._reads.pop(client.conversation, None)
        if reads is None or reads.count < _MANY or reads.count < client.calls * _SHARE:
            return
        calls, took = client.calls, last_time(reads.last) - reads.first.request.time
        top, often = max(reads.names.items(), key=lambda item: item[1])

        def say(speech: Speech) -> str:
            what = f", most of all '{shown(top)}' ({often})" if top else ""
            share = f", {reads.spent / took:.0%} of its time" if took > 0 else ""
            each = span(reads.spent // reads.count)
            return (
                f"{reads.count} of {calls} calls of {speech.client(client.conversation)} read one "
                f"variable{what}, {each} each{share}"
            )

        frames = (reads.first.request.number, reads.last.request.number)
        began, time = reads.first.request.time, reads.last.request.time
        self.report(Incident(POLLING, began, time, client.conversation, frames, say))
