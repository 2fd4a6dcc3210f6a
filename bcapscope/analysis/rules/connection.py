"""How TCP connections end."""

from __future__ import annotations

from bcapscope.analysis.client import Client, Clients
from bcapscope.analysis.finding import Severity
from bcapscope.analysis.rules.rule import SECOND, Incident, Report, Rule, Watcher, last_time
from bcapscope.analysis.speech import Speech, called, span
from bcapscope.protocol.functions import ID
from bcapscope.traffic.observation import Closing, Conversation

HUNG_UP = Rule(
    "controller-hung-up",
    Severity.ERROR,
    "the controller closed the TCP connection before the client had ended its session",
    "Look at the controller at this moment (its log, Reset on the pendant, a restart, too many clients); the "
    "client has to connect again and begin with Service_Start.",
    "RFC 9293, sections 3.5.2 (reset) and 3.6 (closing)",
    ("malformed-request", "executing-forever"),
    60 * SECOND,
)


class Connection(Watcher):
    """Looks at who ended a connection."""

    rules = (HUNG_UP,)

    def __init__(self, report: Report, clients: Clients) -> None:
        super().__init__(report, clients)
        self._judged: set[Conversation] = set()

    def forget(self, conversation: Conversation) -> None:
        client = self.clients.find(conversation)
        if client is not None:  # it is remembered for a while, but its connection is over
            self._judged.add(conversation)
            self._judge(client)

    def gone(self, client: Client, ended: int) -> None:
        if client.conversation in self._judged:
            self._judged.discard(client.conversation)
        else:
            self._judge(client)

    def _judge(self, client: Client) -> None:
        closing = client.hung_up
        stopped = client.closed is not None or client.last.question.function_id == ID["Service_Stop"]
        if closing is not None and not stopped:
            self._hung_up(client, closing)

    def _hung_up(self, client: Client, closing: Closing) -> None:
        last = client.last
        how = "broke off (RST)" if closing.reset else "closed (FIN)"

        def say(speech: Speech) -> str:
            who = speech.client(client.conversation)
            since = span(max(closing.time - last_time(last), 0))
            text = (
                f"at {speech.at(closing.time)} {client.conversation.server} {how} the connection of {who}, "
                f"{since} after {called(last)}"
            )
            return text if last.reply is not None else f"{text}, to which no reply was seen"

        def then(speech: Speech, after: int) -> str:
            return f"{client.conversation.server} {how} the connection"

        frames = tuple(seen.number for seen in (last.request, last.reply) if seen is not None)
        self.report(
            Incident(
                HUNG_UP, closing.time, closing.time, client.conversation, frames, say, then, call=last.call
            )
        )
