"""Rules about how TCP connections end."""

from __future__ import annotations

from collections.abc import Iterable, Iterator

from bcapscope.analysis.client_state import ClientState
from bcapscope.analysis.finding_places import call_place, client_place
from bcapscope.analysis.rules.rule_checker import (
    ClientEnd,
    Occurrence,
    RobotImpact,
    RuleChecker,
    frame_numbers,
    last_frame_time,
)
from bcapscope.messages import Message
from bcapscope.messages.places import Duration, Moment
from bcapscope.protocol.tables.function_table import ID
from bcapscope.traffic.call import Call
from bcapscope.traffic.observation import ConnectionEnd, Conversation, Direction


class ConnectionChecker(RuleChecker):
    by_client: dict[Conversation, bool]

    def on_conversation_closed(self, conversation: Conversation) -> None:
        client = self.clients.find(conversation)
        if client is not None:  # The registry remembers some clients after their conversation was closed.
            self.by_client[conversation] = True
            for occurrence in _closing_occurrences(client):
                self.report_occurrence(occurrence)

    def end_occurrences(self, end: ClientEnd) -> Iterable[Occurrence]:
        judged = end.client.conversation in self.by_client
        return () if judged else _closing_occurrences(end.client)


def _closing_occurrences(client: ClientState) -> Iterator[Occurrence]:
    if client.session_end is not None or client.last_call.kind.function_id == ID["Service_Stop"]:
        return
    closing, by_proxy = client.controller_closing, client.conversation.connection_end
    if closing is not None:
        yield _hung_up(client.last_call, closing)
    elif by_proxy is not None and by_proxy.by is Direction.RESPONSE:  # the controller's connection was open
        yield _hung_up_by_proxy(client.last_call, by_proxy)


def _hung_up(last: Call, closing: ConnectionEnd) -> Occurrence:
    how = _how(closing)
    answered = "" if last.reply is not None or last.reply_not_captured else ".unanswered"
    leg = last.conversation.controller_leg
    server = str((leg or last.conversation).server)
    fact = Message(
        f"finding.controller-hung-up.{how}{answered}",
        at=Moment(closing.time),
        server=server,
        client=client_place(last.conversation),
        after=Duration(max(closing.time - last_frame_time(last), 0)),
        call=call_place(last),
    )
    passed_on = last.conversation.connection_end
    if leg is not None and passed_on is not None and passed_on.by is Direction.RESPONSE:
        proxy = str(last.conversation.server)
        fact = Message(f"finding.controller-hung-up.proxy-{_how(passed_on)}", fact=fact, proxy=proxy)
    return Occurrence(
        "controller-hung-up",
        closing.time,
        closing.time,
        last.conversation,
        tuple(seen.number for seen in (last.request, last.reply) if seen is not None),
        fact,
        Message(f"clause.controller-hung-up.{how}", server=server),
        call=last.number,
        impact=RobotImpact.PREVENTED,
    )


def _hung_up_by_proxy(last: Call, closing: ConnectionEnd) -> Occurrence:
    near = last.conversation
    server = str((near.controller_leg or near).server)
    fact = Message(
        "finding.controller-hung-up.by-proxy",
        at=Moment(closing.time),
        proxy=str(near.server),
        server=server,
        client=client_place(near),
        after=Duration(max(closing.time - last_frame_time(last), 0)),
        call=call_place(last),
    )
    return Occurrence(
        "controller-hung-up",
        closing.time,
        closing.time,
        near,
        frame_numbers(last),
        fact,
        call=last.number,
        group_key="proxy",
        advice=Message("rule.controller-hung-up.advice.by-proxy"),
    )


def _how(closing: ConnectionEnd) -> str:
    return "reset" if closing.reset else "closed"
