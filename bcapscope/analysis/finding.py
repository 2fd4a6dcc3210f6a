"""Results of a diagnosis: the findings, and the amount of traffic that was examined."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum
from typing import NamedTuple

from bcapscope.messages import Message
from bcapscope.traffic.observation import Conversation


class Severity(StrEnum):
    """How much a finding matters."""

    ERROR = "error"
    """A request failed or had no effect."""
    WARNING = "warning"
    """The request succeeded this time, but the same request can fail later."""
    NOTE = "note"
    """Information that helps you to understand the other findings."""


@dataclass(frozen=True, slots=True)
class Repetition:
    """How often the problem of a finding occurred.

    Attributes:
        first: Time of the first occurrence, ns since 1970.
        last: End of the last occurrence, ns since 1970; None if occurrences were only counted, without their
            times.
    """

    count: int
    first: int
    last: int | None


@dataclass(frozen=True, slots=True)
class Consequence:
    """A consequence that is named in the text of its root cause.

    Attributes:
        after: Time in ns from the previous consequence to this consequence. For the first consequence,
            `after` is the time from the root cause.
    """

    clause: Message
    after: int


@dataclass(frozen=True, slots=True)
class Finding:
    """A root cause or a consequence, as data. `ReportedFinding.text` writes the sentences.

    Attributes:
        rule: Id of the rule, such as `set-point-gap`.
        severity: How much the finding matters.
        advice: Message that says what you can do.
        source: Document, library or report that the rule comes from.
        calls: Numbers of the calls that the finding concerns.
        repetition: How often the problem occurred; None if it occurred only once.
        fact: Message that says what happened; the message can contain raw text from the wire, which must be
            escaped for output.
        frames: Numbers, in ascending order, of the frames that prove the described problem; if the problem
            occurred several times, one frame of the first and one of the last occurrence are included.
        consequence_of: Number of the finding that caused this finding, counted from 1 in the order of the
            report; None if no cause was found.
        began: Time when the described problem began, ns since 1970.
        consequences: The consequences that the text of a root cause names; empty for a consequence.
        followed_by: Numbers of the findings that are the first and the last consequence of a root cause; None
            if `consequences` contains all of them.
        explains_rest: Whether all later errors and warnings are consequences of this root cause.
    """

    rule: str
    severity: Severity
    fact: Message
    frames: tuple[int, ...]
    consequence_of: int | None
    advice: Message
    source: str
    calls: tuple[int, ...]
    conversation: Conversation
    began: int
    repetition: Repetition | None = None
    consequences: tuple[Consequence, ...] = ()
    followed_by: tuple[int, int] | None = None
    explains_rest: bool = False


class TrafficTotals(NamedTuple):
    """Amount of traffic that a diagnosis examined.

    Attributes:
        frames: Number of frames, including damaged items that are not frames.
        duration_ns: Time from the first frame to the end of the traffic, ns.
        not_followed: Number of calls that bcapscope dropped from memory before a reply arrived.
        selected_calls: Number of calls that the filter selected; None if there is no filter.
        began: Time of the first frame, ns since 1970; the sentences of findings state times relative to this
            time.
    """

    frames: int
    calls: int
    clients: int
    duration_ns: int
    not_followed: int = 0
    selected_calls: int | None = None
    began: int = 0

    @property
    def has_only_client(self) -> bool:
        """Whether there is at most one client. If so, the sentences of findings need not name the client."""
        return self.clients <= 1


NO_TRAFFIC = TrafficTotals(0, 0, 0, 0)
