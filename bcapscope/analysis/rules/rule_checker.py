"""Definition of a rule, of its occurrences, and the base class of the checkers."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from enum import Enum
from typing import Any, ClassVar, NamedTuple, TypeAlias

from bcapscope.analysis.client_state import ClientRegistry, ClientState
from bcapscope.analysis.finding import Severity
from bcapscope.analysis.slave.slave_session import SlaveSession
from bcapscope.messages import Message
from bcapscope.traffic.call import Call, FrameObservation, StrayReply
from bcapscope.traffic.call_kind import CallKind
from bcapscope.traffic.observation import Conversation, Observation

SECOND = 1_000_000_000
MS = 1_000_000

SAME_CALL = 0
"""Value of `cause_within_ns` for a rule whose cause is in the same call."""


@dataclass(frozen=True, slots=True)
class DiagnosisRule:
    """A check that `diagnose` makes, as data.

    Attributes:
        id: Short name, used in JSON.
        possible_causes: Ids of the rules that can be its cause.
        cause_within_ns: How far back a cause is looked for, ns.
    """

    id: str
    severity: Severity
    source: str
    possible_causes: tuple[str, ...] = ()
    cause_within_ns: int = SECOND

    @property
    def title(self) -> Message:
        return Message(f"rule.{self.id}.title")

    @property
    def advice(self) -> Message:
        return Message(f"rule.{self.id}.advice")


@dataclass(slots=True, eq=False)
class Occurrence:
    """One instance of a problem that a rule found.

    Attributes:
        began: Start, ns since 1970; a cause starts no later than its consequence ends.
        completed: End, ns since 1970; delays of consequences count from here.
        frames: Numbers of the frames that prove it.
        fact: What happened: `finding.<rule>`, or `finding.<rule>.<case>`, a whole sentence.
        clause: The same as a consequence: `clause.<rule>`, a sentence without capital and full stop; None
            if it is never named as one.
        call: Number of the call concerned; 0 for none.
        explaining_calls: Numbers of calls that explain it, if something is wrong with them.
        group_key: Occurrences of a rule with different keys become different findings.
        advice: What to do in this case; None for the advice of the rule.
        count: Number of times it stands for, if they are not listed one by one.
        is_update: True if it replaces the earlier occurrence of the same rule and call.
        selected: True to report it for itself; False to report it only as a cause of another one.
    """

    rule: DiagnosisRule
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


class ClientEnd(NamedTuple):
    """A client that makes no more calls.

    Attributes:
        ended_at: Time when the traffic ended, ns since 1970, or time when the client was dropped from memory.
        known_present: The client is known to be still there, even if it is silent.
        silent_session: Latest slave-mode session that ended because the client sent no more set points.
    """

    client: ClientState
    ended_at: int
    known_present: bool
    silent_session: SlaveSession | None


OccurrenceSink: TypeAlias = Callable[[Occurrence], None]


class CallHealth(Enum):
    """How a call went; checkers use it to choose the calls that they check."""

    SMOOTH = "smooth"
    """One request, one reply, success."""
    REFUSED = "refused"
    """The reply reports a failure."""
    TROUBLED = "troubled"
    """No failure, but retries, no reply, or more frames than one request and one reply."""


class RuleChecker:
    """Checks one rule, or a few that need the same data, in one pass and in bounded memory.

    A subclass overrides the methods for the events that it needs. Methods that return occurrences change
    nothing: they are also called for a snapshot, after which the traffic goes on.

    Attributes:
        needs_every_set_point: Whether `on_call` gets every accepted set point (slvMove), maybe millions.
            Otherwise it gets the first of each run of set points that are alike (see `AlikeSetPoints`), and
            all that differ or went wrong. `client` is the state before the first set point of the run.
        by_client: What it keeps for each client, until the client is dropped from memory.
    """

    rules: ClassVar[tuple[DiagnosisRule, ...]]
    needs_every_set_point: ClassVar[bool] = False

    def __init__(self, report_occurrence: OccurrenceSink, clients: ClientRegistry) -> None:
        self.report_occurrence = report_occurrence
        self.clients = clients
        self.by_client: dict[Conversation, Any] = {}

    def report_call(
        self,
        rule: DiagnosisRule,
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
    ) -> None:
        """Report a problem of a call, by default of the whole time from its request to its last frame.

        `evidence_call` is another call whose frames prove it; for the other arguments see `Occurrence`.
        """
        self.report_occurrence(
            Occurrence(
                rule=rule,
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
            )
        )

    def wants_call(self, call_kind: CallKind, health: CallHealth) -> bool:
        """Return whether `on_call` needs calls of this kind and health. The result is cached.

        Set points that are alike are not asked about; see `needs_every_set_point`.
        """
        return health is not CallHealth.SMOOTH

    def on_call(self, call: Call, client: ClientState) -> None:
        """Check a completed call; `client` holds the state before this call."""

    def on_suspect_frame(self, observation: Observation | FrameObservation) -> None:
        """Check bytes that are no frame, a frame with problems, or a large frame."""

    def on_new_flow(self, observation: Observation) -> None:
        """Check the first frame of a flow, or the first bytes that are no frame."""

    def on_stray_reply(self, stray: StrayReply) -> None:
        """Check a reply that belongs to no call."""

    def session_occurrences(self, session: SlaveSession) -> Iterable[Occurrence]:
        """Return what is wrong with a slave-mode session that has ended."""
        return ()

    def on_conversation_closed(self, conversation: Conversation) -> None:
        """Release what is kept for a closed conversation; it may have had no calls."""

    def end_occurrences(self, end: ClientEnd) -> Iterable[Occurrence]:
        """Return what is wrong with a client that makes no more calls."""
        return ()

    def drop_client(self, client: ClientState) -> None:
        """Release what is kept for a client that is dropped from memory."""
        self.by_client.pop(client.conversation, None)


def frame_numbers(*calls: Call | None) -> tuple[int, ...]:
    return tuple(seen.number for call in calls if call is not None for seen in call_observations(call))


def call_observations(call: Call) -> tuple[FrameObservation, ...]:
    """Return all frames of a call, in the order in which they were captured."""
    if call.other_frames:
        return tuple(event.observation for event in call.frames)
    return (call.request,) if call.reply is None else (call.request, call.reply)


def last_frame_time(call: Call) -> int:
    """Return the time of the last frame of a call, ns since 1970."""
    return call.last_activity if call.reply is None else max(call.last_activity, call.reply.time)
