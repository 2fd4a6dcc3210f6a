"""Rules about how TCP connections end."""

from __future__ import annotations

from collections.abc import Iterable, Iterator

from bcapscope.analysis.client_state import ClientRegistry, ClientState
from bcapscope.analysis.finding import Severity
from bcapscope.analysis.rules.rule_checker import (
    SECOND,
    ClientEnd,
    DiagnosisRule,
    Occurrence,
    OccurrenceSink,
    RuleChecker,
    last_frame_time,
)
from bcapscope.analysis.speech import Speech, called, span
from bcapscope.protocol.tables.function_table import ID
from bcapscope.traffic.call import Call
from bcapscope.traffic.observation import ConnectionEnd, Conversation

CONTROLLER_HUNG_UP = DiagnosisRule(
    "controller-hung-up",
    Severity.ERROR,
    "the controller closed the TCP connection before the client had ended its session",
    "Look at the controller at this moment (its log, Reset on the pendant, a restart, too many clients); the "
    "client has to connect again and begin with Service_Start.",
    "RFC 9293, sections 3.5.2 (reset) and 3.6 (closing)",
    ("malformed-request", "executing-forever"),
    60 * SECOND,
)


class ConnectionChecker(RuleChecker):
    """Checks which end closed a connection."""

    rules = (CONTROLLER_HUNG_UP,)

    def __init__(self, report_occurrence: OccurrenceSink, clients: ClientRegistry) -> None:
        super().__init__(report_occurrence, clients)
        self._judged_conversations: set[Conversation] = set()

    def on_conversation_closed(self, conversation: Conversation) -> None:
        client = self.clients.find(conversation)
        if client is not None:  # the client stays registered for a while, but its connection is closed
            self._judged_conversations.add(conversation)
            for occurrence in _closing_occurrences(client):
                self.report_occurrence(occurrence)

    def end_occurrences(self, end: ClientEnd) -> Iterable[Occurrence]:
        judged = end.client.conversation in self._judged_conversations
        return () if judged else _closing_occurrences(end.client)

    def drop_client(self, client: ClientState) -> None:
        self._judged_conversations.discard(client.conversation)


def _closing_occurrences(client: ClientState) -> Iterator[Occurrence]:
    closing = client.controller_closing
    stopped = client.session_end is not None or client.last_call.kind.function_id == ID["Service_Stop"]
    if closing is not None and not stopped:
        yield _hung_up(client.last_call, closing)


def _hung_up(last: Call, closing: ConnectionEnd) -> Occurrence:
    how = "broke off (RST)" if closing.reset else "closed (FIN)"
    conversation = last.conversation

    def say(speech: Speech) -> str:
        who = speech.client(conversation)
        since = span(max(closing.time - last_frame_time(last), 0))
        text = (
            f"at {speech.at(closing.time)} {conversation.server} {how} the connection of {who}, "
            f"{since} after {called(last)}"
        )
        return text if last.reply is not None else f"{text}, to which no reply was seen"

    def then(speech: Speech, after: int) -> str:
        return f"{conversation.server} {how} the connection"

    frames = tuple(seen.number for seen in (last.request, last.reply) if seen is not None)
    return Occurrence(
        CONTROLLER_HUNG_UP,
        closing.time,
        closing.time,
        conversation,
        frames,
        say,
        then,
        call=last.number,
    )
