"""The base class of all checkers, the class of reported problems, and the classes that describe refusals."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable
from dataclasses import dataclass
from enum import Enum, IntEnum
from typing import Any, ClassVar, NamedTuple, TypeAlias

from bcapscope.analysis.client_state import ClientRegistry, ClientState
from bcapscope.analysis.finding_places import call_place
from bcapscope.analysis.rules.rule_table import RULES, DiagnosisRule
from bcapscope.analysis.slave.slave_session import SlaveSession
from bcapscope.messages import Message
from bcapscope.messages.message import PlaceValue
from bcapscope.messages.places import Moment
from bcapscope.traffic.call import Call, FrameObservation, StrayReply
from bcapscope.traffic.call_kind import CallKind
from bcapscope.traffic.observation import Conversation, Observation

SECOND = 1_000_000_000
MS = 1_000_000


class RobotImpact(IntEnum):
    """Effect of a problem on the motion of the robot. The gravest effect has the smallest number."""

    STOPPED = 0
    PREVENTED = 1
    """The client could not connect, prepare or begin a motion."""
    NONE = 2


@dataclass(slots=True, eq=False)
class Occurrence:
    """One instance of a problem, as a rule reports it.

    Attributes:
        began: Time when the problem began, ns since 1970.
        completed: Time when the problem ended, ns since 1970.
        fact: Message `finding.<rule>` or `finding.<rule>.<case>`.
        clause: Message `clause.<rule>`; None if the text of a root cause never names this problem.
        call: Number of the call that has the problem; 0 if no single call has it.
        explaining_calls: Numbers of the calls whose problems are the likeliest causes of this problem.
        group_key: Occurrences of one rule with different group keys become different findings.
        advice: None for the usual advice of the rule.
        is_update: Whether this occurrence replaces the earlier occurrence of the same rule and call.
        selected: False if the problem is reported only as the cause of a problem in selected calls.
        explains: Numbers of the calls whose problems are certainly consequences of this problem.
    """

    rule_id: str
    began: int
    completed: int
    conversation: Conversation
    frames: tuple[int, ...]
    fact: Message
    clause: Message | None = None
    call: int = 0
    explaining_calls: tuple[int, ...] = ()
    group_key: str = ""
    advice: Message | None = None
    count: int = 1
    is_update: bool = False
    selected: bool = True
    explains: tuple[int, ...] = ()
    impact: RobotImpact = RobotImpact.NONE

    @property
    def rule(self) -> DiagnosisRule:
        return RULES[self.rule_id]


class ClientEnd(NamedTuple):
    """The end of a client's traffic at `ended_at` (ns since 1970): the capture ended, or the client was
    dropped from memory. If `known_present` is True, the client is still connected, although it sends nothing.
    """

    client: ClientState
    ended_at: int
    known_present: bool
    silent_session: SlaveSession | None


OccurrenceSink: TypeAlias = Callable[[Occurrence], None]


class CallHealth(Enum):
    SMOOTH = "smooth"
    """One request, one reply, success."""
    REFUSED = "refused"
    TROUBLED = "troubled"
    """The call got no reply, or the call succeeded with retries or other extra frames."""


class RuleChecker:
    """Checks one rule, or a few rules that need the same data, in one pass and in bounded memory.

    A subclass overrides the methods for the events that it needs. Methods that return problems (`Occurrence`)
    must not change the checker, because bcapscope also calls them while live traffic continues. `by_client`
    holds data about each client until the client is dropped from memory.

    Attributes:
        needs_every_set_point: Whether `on_call` gets every accepted set point (slvMove). If False, `on_call`
            gets no set point of a series (see `AlikeSetPoints`), because a capture can contain millions of
            set points. If True, `on_call` may get many set points of a series before bcapscope updates the
            `ClientState`.
    """

    needs_every_set_point: ClassVar[bool] = False

    def __init__(self, report_occurrence: OccurrenceSink, clients: ClientRegistry) -> None:
        self.report_occurrence = report_occurrence
        self.clients = clients
        self.by_client: dict[Conversation, Any] = {}
        self.set_up()

    def set_up(self) -> None:
        """Create the data that a subclass keeps in addition to `by_client`."""

    def report_call(
        self,
        rule: str,
        call: Call,
        fact: Message,
        clause: Message | None = None,
        *,
        evidence_call: Call | None = None,
        explaining_calls: tuple[int, ...] = (),
        began: int = 0,
        completed: int = 0,
        group_key: str = "",
        advice: Message | None = None,
        impact: RobotImpact = RobotImpact.NONE,
        is_update: bool = False,
    ) -> None:
        """Report a problem that, by default, lasts from the call's request to its last frame. The frames of
        `call` and of `evidence_call` prove the problem.
        """
        self.report_occurrence(
            Occurrence(
                rule_id=rule,
                began=began or call.request.time,
                completed=completed or last_frame_time(call),
                conversation=call.conversation,
                frames=frame_numbers(evidence_call, call),
                fact=fact,
                clause=clause,
                call=call.number,
                explaining_calls=explaining_calls,
                group_key=group_key,
                advice=advice,
                is_update=is_update,
                impact=impact,
            )
        )

    def wants_call(self, call_kind: CallKind, health: CallHealth) -> bool:
        """Return whether `on_call` checks calls of this kind and `health`. `Diagnosis` caches the result."""
        return health is not CallHealth.SMOOTH

    def on_call(self, call: Call, client: ClientState) -> None:
        """Check a completed call. The state in `client` does not include this call yet."""

    def on_suspect_frame(self, observation: Observation | FrameObservation) -> None:
        """Check a large frame, a frame with problems, or bytes that are not a frame."""

    def on_new_flow(self, observation: Observation) -> None:
        """Check the first observation of a flow."""

    def on_stray_reply(self, stray: StrayReply) -> None:
        """Check a reply that belongs to no known call."""

    def session_occurrences(self, session: SlaveSession) -> Iterable[Occurrence]:
        """Return the problems of a slave-mode session that has ended."""
        return ()

    def on_conversation_closed(self, conversation: Conversation) -> None:
        """Release the data of a closed conversation. The conversation may have had no calls."""

    def end_occurrences(self, end: ClientEnd) -> Iterable[Occurrence]:
        """Return the problems that become visible only at the end of a client's traffic."""
        return ()

    def drop_client(self, client: ClientState) -> None:
        self.by_client.pop(client.conversation, None)


def frame_numbers(*calls: Call | None) -> tuple[int, ...]:
    return tuple(seen.number for call in calls if call is not None for seen in call_observations(call))


def call_observations(call: Call) -> tuple[FrameObservation, ...]:
    if call.other_frames:
        return tuple(event.observation for event in call.frames)
    return (call.request,) if call.reply is None else (call.request, call.reply)


def last_frame_time(call: Call) -> int:
    return call.last_activity if call.reply is None else max(call.last_activity, call.reply.time)


class RefusalReason(NamedTuple):
    """What the traffic shows about the reason for a refusal.

    Attributes:
        text: Reason as text, for the message `finding.refused.because`; None for `finding.refused`.
        fact: Message for the finding; None for `finding.refused` or `finding.refused.because`.
        clause: Message that names the refusal as a consequence; None for `clause.refused`.
    """

    text: Message | None = None
    fact: Message | None = None
    clause: Message | None = None
    explaining_calls: tuple[int, ...] = ()
    evidence_call: Call | None = None
    group_key: str = ""
    advice: Message | None = None


NO_REASON = RefusalReason()

ExplainRefusal: TypeAlias = Callable[[Call, ClientState], "RefusalReason | None"]


def reason_from_call(id: str, earlier: Call, **places: PlaceValue) -> RefusalReason:
    """Return the call `earlier` as the reason for a refusal. The message `id` states this reason."""
    text = Message(id, call=call_place(earlier), at=Moment(earlier.request.time), **places)
    return RefusalReason(text, explaining_calls=(earlier.number,), evidence_call=earlier)


def failure_case(failed: Call) -> str:
    return "unanswered" if failed.reply is None else "refused"


class Refusal(NamedTuple):
    """One kind of refusal, and the rule that reports it.

    Attributes:
        codes: Result codes to which this kind of refusal applies; empty for all codes.
        explain: Function that returns the reason for a refusal; None if the refusal is of another kind.
    """

    rule: str
    codes: Collection[int]
    explain: ExplainRefusal = lambda call, client: NO_REASON
