"""What a rule is, and the base of what looks for it."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from enum import Enum
from typing import ClassVar, TypeAlias

from bcapscope.analysis.client_state import ClientRegistry, ClientState
from bcapscope.analysis.finding import Severity
from bcapscope.analysis.slave.slave_session import SlaveSession
from bcapscope.analysis.speech import Speech
from bcapscope.traffic.call import Call, FrameObservation, StrayReply
from bcapscope.traffic.call_kind import CallKind
from bcapscope.traffic.observation import Conversation, Observation

SECOND = 1_000_000_000
MS = 1_000_000

SAME_CALL = 0
"""The reach of a rule whose cause is something about the same call."""


@dataclass(frozen=True, slots=True)
class DiagnosisRule:
    """One thing that can be wrong, as data.

    Attributes:
        id: short name, used in JSON.
        severity: how much it matters.
        description: what it finds, one clause for the list of rules.
        advice: what to do about it, one sentence.
        source: where the fact is from.
        possible_causes: ids of rules that can be its cause.
        cause_within_ns: a cause is looked for that many nanoseconds back.
    """

    id: str
    severity: Severity
    description: str
    advice: str
    source: str
    possible_causes: tuple[str, ...] = ()
    cause_within_ns: int = SECOND


@dataclass(slots=True, eq=False)
class Occurrence:
    """One time that a rule fired.

    Attributes:
        rule: which.
        began: when it began, nanoseconds since 1970; what comes first is the cause.
        completed: when it was complete; what follows is counted from here.
        conversation: whose it is.
        frames: numbers of the frames that prove it.
        say: makes the sentence, without its full stop.
        then: makes the clause that tells it as a consequence, given the nanoseconds since its cause.
        call: number of the call that it is about; 0 for none.
        explaining_calls: numbers of calls that explain it, if something is wrong with them.
        group_key: incidents of a rule with different keys are different findings.
        advice: what to do in this case; empty for what the rule says.
        count: how many times it stands for, where not all are listed one by one.
        cause: what it follows from, once that is known.
        selected: whether it is to be told for itself; otherwise only as the cause of what is.
    """

    rule: DiagnosisRule
    began: int
    completed: int
    conversation: Conversation
    frames: tuple[int, ...]
    say: Callable[[Speech], str]
    then: Callable[[Speech, int], str] | None = None
    call: int = 0
    explaining_calls: tuple[int, ...] = ()
    group_key: str = ""
    advice: str = ""
    count: int = 1
    cause: Occurrence | None = None
    selected: bool = True


OccurrenceSink: TypeAlias = Callable[[Occurrence], None]


class CallHealth(Enum):
    """How a call went, for choosing who looks at it."""

    SMOOTH = "smooth"
    """One request, one reply, success."""
    REFUSED = "refused"
    """The reply was a failure."""
    TROUBLED = "troubled"
    """Tried more than once, or not answered, or more came than a request and its reply; no failure."""


class RuleChecker:
    """Looks for one rule or a few that need the same knowledge, in one pass and in bounded memory.

    A watcher overrides the methods for what it needs to see.
    """

    rules: ClassVar[tuple[DiagnosisRule, ...]]

    def __init__(self, report_occurrence: OccurrenceSink, clients: ClientRegistry) -> None:
        self.report_occurrence = report_occurrence
        self.clients = clients

    def report_call(
        self,
        rule: DiagnosisRule,
        call: Call,
        say: Callable[[Speech], str],
        then: Callable[[Speech, int], str] | None = None,
        *,
        evidence_call: Call | None = None,
        explaining_calls: tuple[int, ...] = (),
        began: int = 0,
        completed: int = 0,
        group_key: str = "",
        advice: str = "",
    ) -> None:
        """Report what is wrong with a call.

        Args:
            rule: what it is.
            call: the call.
            say: as in `Occurrence`, as all that follows.
            then: likewise.
            evidence_call: another call whose frames prove it.
            explaining_calls: numbers of calls that explain it.
            began: 0 for the first request.
            completed: 0 for the last frame of the call.
            group_key: tells findings of one rule apart.
            advice: for this case.
        """
        self.report_occurrence(
            Occurrence(
                rule=rule,
                began=began or call.request.time,
                completed=completed or last_frame_time(call),
                conversation=call.conversation,
                frames=frame_numbers(evidence_call, call),
                say=say,
                then=then,
                call=call.number,
                explaining_calls=explaining_calls,
                group_key=group_key,
                advice=advice,
            )
        )

    def wants_call(self, call_kind: CallKind, health: CallHealth) -> bool:
        """Tell whether calls like this are to be shown to `on_call`; asked once for each."""
        return health is not CallHealth.SMOOTH

    def on_call(self, call: Call, client: ClientState) -> None:
        """See a call that has settled; `client` knows all that came before it."""

    def on_suspect_frame(self, observation: Observation | FrameObservation) -> None:
        """See bytes that are no frame, a frame with problems, or one of a size that matters."""

    def on_new_flow(self, observation: Observation) -> None:
        """See the first frame, or bytes that are none, of a flow."""

    def on_stray_reply(self, stray: StrayReply) -> None:
        """See a reply that belongs to no call."""

    def on_slave_session(self, session: SlaveSession) -> None:
        """See a stay in slave mode that has ended."""

    def on_conversation_closed(self, conversation: Conversation) -> None:
        """Forget a conversation that is over, whether it had calls or not."""

    def on_client_ended(self, client: ClientState, ended_at: int) -> None:
        """Say goodbye to a client that will not be heard of any more.

        Args:
            client: with all that it did.
            ended_at: when the traffic ended, or when it was dropped from memory.
        """


def frame_numbers(*calls: Call | None) -> tuple[int, ...]:
    """Return the numbers of all frames of the calls."""
    return tuple(seen.number for call in calls if call is not None for seen in call_observations(call))


def call_observations(call: Call) -> tuple[FrameObservation, ...]:
    """Return all frames of a call, in the order in which they were seen."""
    if call.other_frames:
        return tuple(event.observation for event in call.frames)
    return (call.request,) if call.reply is None else (call.request, call.reply)


def last_frame_time(call: Call) -> int:
    """Return when anything of a call was seen last."""
    return call.last_activity if call.reply is None else max(call.last_activity, call.reply.time)


def checkers_overriding(checkers: Sequence[RuleChecker], method: str) -> list[RuleChecker]:
    """Return those watchers that have a `method` of their own."""
    return [each for each in checkers if getattr(type(each), method) is not getattr(RuleChecker, method)]
