"""Rules about damaged frames and about gaps in the capture."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import TypeAlias

from bcapscope.analysis.client_state import ClientState
from bcapscope.analysis.finding_places import call_place, client_place
from bcapscope.analysis.rules.rule_checker import SECOND, ClientEnd, Occurrence, RuleChecker
from bcapscope.messages import Message
from bcapscope.messages.message import PlaceValue
from bcapscope.messages.places import Count, FramePlace, Moment
from bcapscope.protocol.codec.arguments import Problem
from bcapscope.protocol.codec.frame import LARGEST_UDP_FRAME, SOH, Frame, Malformed
from bcapscope.protocol.codec.stream_splitter import STREAM_ENDED
from bcapscope.protocol.tables.hresult import S_EXECUTING
from bcapscope.traffic.call import Call, FrameObservation, StrayReply
from bcapscope.traffic.observation import (
    Conversation,
    Direction,
    Flow,
    Observation,
    ServerEvidenceKind,
    Transport,
)

CHECKED_FROM_BYTES = 480
"""Frames of at least this size in bytes are checked against `LARGEST_UDP_FRAME`."""

_MAX_FLOWS = 4096
_FEWEST_REPLIES = 4
_RESYNC_WITHIN_NS = SECOND
_MAX_PROBLEMS_NAMED = 3

_Seen: TypeAlias = "Observation | FrameObservation"


class WireChecker(RuleChecker):
    """Checks damaged frames, and decides whether the capture or the sender damaged a frame."""

    def set_up(self) -> None:
        self._resync_since: dict[Flow, int] = {}
        self._directions: dict[Conversation, set[Direction]] = {}
        self._replies: dict[Conversation, list[FrameObservation]] = {}

    def on_new_flow(self, observation: Observation) -> None:
        flow = observation.flow
        conversation = flow.conversation
        if len(self._directions) >= _MAX_FLOWS:
            self._directions.clear()
        self._directions.setdefault(conversation, set()).add(flow.direction)
        evidence = conversation.server_evidence.kind
        begun_unseen = (
            conversation.transport is Transport.TCP and evidence is not ServerEvidenceKind.PARTICIPANT
        )
        if begun_unseen and isinstance(observation.item, Malformed):
            self._expect_resync(flow, observation.time)  # the capture began in the middle of a TCP frame
        if evidence is ServerEvidenceKind.GUESS and flow.direction is Direction.REQUEST:
            self._report_frame("server-guessed", observation, server=flow.dst_text)

    def on_suspect_frame(self, observation: _Seen) -> None:
        item, conversation = observation.item, observation.flow.conversation
        if isinstance(item, Frame):
            self._check_size(observation, len(item.raw))
        problems = item.problems
        if isinstance(item, Frame) and not problems:
            return
        cuts = [problem for problem in problems if problem.code == "cut"]
        if isinstance(item, Malformed) and item.missing:
            self._expect_resync(observation.flow, observation.time)
            self._report_frame("capture-gap", observation, missing=Count(item.missing, "byte"))
        elif conversation.transport is Transport.TCP and (self._is_resyncing(observation) or cuts):
            ended = any(problem.reason == STREAM_ENDED for problem in problems)
            closed = ended and conversation.connection_end is not None
            advice = Message("rule.capture-gap.advice.closed") if closed else None
            self._report_frame("capture-gap", observation, ".closed" if closed else ".part", advice)
        elif cuts:
            self._report_frame("capture-cut", observation, problems=_problem_message(cuts))
        else:
            self._report_malformed(observation, _problem_message(problems))

    def on_call(self, call: Call, client: ClientState) -> None:
        copies = call.duplicates
        if copies:
            number = Count(len(copies), "copy")
            fact = Message("finding.duplicate-frames", call=call_place(call), copies=number)
            self.report_call("duplicate-frames", call, fact)

    def on_stray_reply(self, stray: StrayReply) -> None:
        """Report a conversation of which the capture has only replies. A few replies without requests are
        normal at the start of a capture.
        """
        reply, conversation = stray.observation, stray.observation.flow.conversation
        if reply.item.code == S_EXECUTING or self._directions.get(conversation) != {Direction.RESPONSE}:
            return
        replies = self._replies.setdefault(conversation, [])
        replies.append(reply)
        if len(replies) == _FEWEST_REPLIES:
            self.report_occurrence(_one_direction("replies", conversation, replies[0], reply))
        elif len(replies) > _FEWEST_REPLIES:
            replies.pop()

    def end_occurrences(self, end: ClientEnd) -> Iterator[Occurrence]:
        client, conversation = end.client, end.client.conversation
        first, last = client.first_call, client.last_call
        if self._directions.get(conversation) == {Direction.REQUEST} and last.reply_not_captured:
            yield _one_direction("requests", conversation, first.request, last.last_attempt)

    def on_conversation_closed(self, conversation: Conversation) -> None:
        self._directions.pop(conversation, None)
        self._replies.pop(conversation, None)
        for flow in [flow for flow in self._resync_since if flow.conversation is conversation]:
            del self._resync_since[flow]

    def _expect_resync(self, flow: Flow, time: int) -> None:
        if len(self._resync_since) >= _MAX_FLOWS:
            self._resync_since.clear()
        self._resync_since[flow] = time

    def _is_resyncing(self, observation: _Seen) -> bool:
        """Return whether bytes look damaged only because the bytes before them were not captured."""
        since = observation.time - self._resync_since.pop(observation.flow, -_RESYNC_WITHIN_NS)
        return isinstance(observation.item, Malformed) and since < _RESYNC_WITHIN_NS

    def _check_size(self, observation: _Seen, size: int) -> None:
        if observation.flow.conversation.transport is not Transport.UDP or size < CHECKED_FROM_BYTES:
            return
        bytes_, limit = Count(size, "byte"), Count(LARGEST_UDP_FRAME, "byte")
        if size > LARGEST_UDP_FRAME:
            self._report_frame("oversize-datagram", observation, size=bytes_, limit=limit)
        elif observation.flow.direction is Direction.REQUEST:
            self._report_frame("near-datagram-limit", observation, size=bytes_, limit=limit)

    def _report_malformed(self, observation: _Seen, reasons: Message | str) -> None:
        if observation.flow.direction is Direction.RESPONSE:
            self._report_frame("malformed-reply", observation, problems=reasons)
            return
        transport = observation.flow.conversation.transport
        stops_server = transport is Transport.UDP and observation.item.raw[:1] == bytes((SOH,))
        case = ".stops-server" if stops_server else ""
        advice = Message("rule.malformed-request.advice.tcp") if transport is Transport.TCP else None
        self._report_frame("malformed-request", observation, case, advice, problems=reasons)

    def _report_frame(
        self,
        rule: str,
        observation: _Seen,
        case: str = "",
        advice: Message | None = None,
        **places: PlaceValue,
    ) -> None:
        conversation = observation.flow.conversation
        fact = Message(
            f"finding.{rule}{case}",
            at=Moment(observation.time),
            frame=FramePlace((observation.number,)),
            sender=observation.flow.src_text,
            **places,
        )
        self.report_occurrence(
            Occurrence(
                rule,
                observation.first_byte_time,
                observation.time,
                conversation,
                (observation.number,),
                fact,
                group_key=conversation.transport if rule == "malformed-request" else "",
                advice=advice,
            )
        )


def _one_direction(
    held: str, conversation: Conversation, first: FrameObservation, last: FrameObservation
) -> Occurrence:
    fact = Message(
        f"finding.one-direction.{held}", client=client_place(conversation), server=str(conversation.server)
    )
    frames = (first.number, last.number)
    return Occurrence("one-direction", first.time, last.time, conversation, frames, fact, group_key=held)


def _problem_message(problems: Sequence[Problem]) -> Message | str:
    *firsts, text = [problem.reason for problem in problems[:_MAX_PROBLEMS_NAMED]]
    more = len(problems) - _MAX_PROBLEMS_NAMED
    message: Message | str = text
    if more > 0:
        message = Message("problems.more", last=text, more=Count(more, "more-problem"))
    for reason in reversed(firsts):
        message = Message("problems.and", first=reason, rest=message)
    return message
