"""Results of a diagnosis: findings, and the amount of traffic examined."""

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
    """The request worked this time, but will not always."""
    NOTE = "note"
    """Background that helps to understand the other findings."""


@dataclass(frozen=True, slots=True)
class Repetition:
    """How often a finding occurred.

    Attributes:
        first: Time of the first one, ns since 1970.
        last: End of the last one, ns since 1970; None if the occurrences were counted, not listed.
    """

    count: int
    first: int
    last: int | None


@dataclass(frozen=True, slots=True)
class Consequence:
    """A consequence that the text of a root cause names.

    Attributes:
        after: Time since the cause, or since the consequence before it, ns.
    """

    clause: Message
    after: int


@dataclass(frozen=True, slots=True)
class Finding:
    """A root cause or a consequence, without a word: `render.finding_text` makes the sentences.

    Attributes:
        fact: What happened. Its places may hold raw strings from the wire; escape the text where it is shown.
        frames: Numbers of the frames that prove it, in order. For several occurrences these are the frames of
            one occurrence and of the first and last.
        consequence_of: Number of the finding that caused this one, counted from 1 in the order of the report;
            None if no cause was found.
        began: Time when it began, ns since 1970.
        consequences: The first consequences of a root cause, which its text names.
        followed_by: Numbers of the first and last finding that follow from a root cause, if its text does not
            name all of them.
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
        frames: Number of frames and malformed items.
        duration_ns: Time from the first frame to the end, ns.
        not_followed: Number of calls that were evicted before a reply arrived.
        selected_calls: Number of selected calls; None if all are selected.
        began: Time of the first frame, ns since 1970; sentences count their times from there.
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
        """Whether sentences need no address to say which client they mean."""
        return self.clients <= 1


NO_TRAFFIC = TrafficTotals(0, 0, 0, 0)
