"""What a rule is, and the base of what looks for it."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from enum import Enum
from typing import ClassVar, TypeAlias

from bcapscope.analysis.client import Client, Clients
from bcapscope.analysis.finding import Severity
from bcapscope.analysis.speech import Speech
from bcapscope.analysis.stay import Stay
from bcapscope.traffic.exchange import Exchange, FrameObservation, Stray
from bcapscope.traffic.observation import Conversation, Observation
from bcapscope.traffic.question import Question

SECOND = 1_000_000_000
MS = 1_000_000

OF_ITSELF = 0
"""The reach of a rule whose cause is something about the same call."""


@dataclass(frozen=True, slots=True)
class Rule:
    """One thing that can be wrong, as data.

    Attributes:
        id: short name, used in JSON.
        severity: how much it matters.
        finds: what it finds, one clause for the list of rules.
        advice: what to do about it, one sentence.
        source: where the fact is from.
        follows: ids of rules that can be its cause.
        reach: a cause is looked for that many nanoseconds back.
    """

    id: str
    severity: Severity
    finds: str
    advice: str
    source: str
    follows: tuple[str, ...] = ()
    reach: int = SECOND


@dataclass(slots=True, eq=False)
class Incident:
    """One time that a rule fired.

    Attributes:
        rule: which.
        began: when it began, nanoseconds since 1970; what comes first is the cause.
        time: when it was complete; what follows is counted from here.
        conversation: whose it is.
        frames: numbers of the frames that prove it.
        say: makes the sentence, without its full stop.
        then: makes the clause that tells it as a consequence, given the nanoseconds since its cause.
        call: number of the call that it is about; 0 for none.
        because: numbers of calls that explain it, if something is wrong with them.
        key: incidents of a rule with different keys are different findings.
        advice: what to do in this case; empty for what the rule says.
        count: how many times it stands for, where not all are listed one by one.
        cause: what it follows from, once that is known.
        asked: whether it is to be told for itself; otherwise only as the cause of what is.
    """

    rule: Rule
    began: int
    time: int
    conversation: Conversation
    frames: tuple[int, ...]
    say: Callable[[Speech], str]
    then: Callable[[Speech, int], str] | None = None
    call: int = 0
    because: tuple[int, ...] = ()
    key: str = ""
    advice: str = ""
    count: int = 1
    cause: Incident | None = None
    asked: bool = True


Report: TypeAlias = Callable[[Incident], None]


class Kind(Enum):
    """How a call went, for choosing who looks at it."""

    SMOOTH = "smooth"
    """One request, one reply, success."""
    REFUSED = "refused"
    """The reply was a failure."""
    TROUBLED = "troubled"
    """Tried more than once, or not answered, or more came than a request and its reply; no failure."""


class Watcher:
    """Looks for one rule or a few that need the same knowledge, in one pass and in bounded memory.

    A watcher overrides the methods for what it needs to see.
    """

    rules: ClassVar[tuple[Rule, ...]]

    def __init__(self, report: Report, clients: Clients) -> None:
        self.report = report
        self.clients = clients

    def tell(
        self,
        rule: Rule,
        call: Exchange,
        say: Callable[[Speech], str],
        then: Callable[[Speech, int], str] | None = None,
        *,
        before: Exchange | None = None,
        because: tuple[int, ...] = (),
        began: int = 0,
        time: int = 0,
        key: str = "",
        advice: str = "",
    ) -> None:
        """Report what is wrong with a call.

        Args:
            rule: what it is.
            call: the call.
            say: as in `Incident`, as all that follows.
            then: likewise.
            before: another call whose frames prove it.
            because: numbers of calls that explain it.
            began: 0 for the first request.
            time: 0 for the last frame of the call.
            key: tells findings of one rule apart.
            advice: for this case.
        """
        self.report(
            Incident(
                rule=rule,
                began=began or call.request.time,
                time=time or last_time(call),
                conversation=call.conversation,
                frames=frames_of(before, call),
                say=say,
                then=then,
                call=call.call,
                because=because,
                key=key,
                advice=advice,
            )
        )

    def heeds(self, question: Question, kind: Kind) -> bool:
        """Tell whether calls like this are to be shown to `call`; asked once for each."""
        return kind is not Kind.SMOOTH

    def call(self, call: Exchange, client: Client) -> None:
        """See a call that has settled; `client` knows all that came before it."""

    def odd(self, seen: Observation | FrameObservation) -> None:
        """See bytes that are no frame, a frame with problems, or one of a size that matters."""

    def fresh(self, seen: Observation) -> None:
        """See the first frame, or bytes that are none, of a flow."""

    def stray(self, stray: Stray) -> None:
        """See a reply that belongs to no call."""

    def stay(self, stay: Stay) -> None:
        """See a stay in slave mode that has ended."""

    def forget(self, conversation: Conversation) -> None:
        """Forget a conversation that is over, whether it had calls or not."""

    def gone(self, client: Client, ended: int) -> None:
        """Say goodbye to a client that will not be heard of any more.

        Args:
            client: with all that it did.
            ended: when the traffic ended, or when it was dropped from memory.
        """


def frames_of(*calls: Exchange | None) -> tuple[int, ...]:
    """Return the numbers of all frames of the calls."""
    return tuple(seen.number for call in calls if call is not None for seen in all_seen(call))


def all_seen(call: Exchange) -> tuple[FrameObservation, ...]:
    """Return all frames of a call, in the order in which they were seen."""
    if call.others:
        return tuple(event.seen for event in call.events)
    return (call.request,) if call.reply is None else (call.request, call.reply)


def last_time(call: Exchange) -> int:
    """Return when anything of a call was seen last."""
    return call.activity if call.reply is None else max(call.activity, call.reply.time)


def overrides(watchers: Sequence[Watcher], method: str) -> list[Watcher]:
    """Return those watchers that have a `method` of their own."""
    return [each for each in watchers if getattr(type(each), method) is not getattr(Watcher, method)]
