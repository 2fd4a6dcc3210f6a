"""Results of a diagnosis: findings, and the amount of traffic examined."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum
from typing import NamedTuple


class Severity(StrEnum):
    """How much a finding matters."""

    ERROR = "error"
    """A request failed or had no effect."""
    WARNING = "warning"
    """The request worked this time, but will not always."""
    NOTE = "note"
    """Background that helps to understand the other findings."""


@dataclass(frozen=True, slots=True)
class Finding:
    """A root cause or a consequence.

    Attributes:
        rule: Id of the rule that found it.
        severity: Severity of the rule.
        sentence: One sentence in plain English. It may contain raw strings from the wire; escape it before
            you show it.
        frames: Numbers of the frames that prove it, in order. For several occurrences these are the frames of
            one occurrence and of the first and last.
        consequence_of: Number of the finding that caused this one, counted from 1 in the order of the report;
            None if no cause was found.
        advice: What to do, one sentence.
        source: Source of the rule.
    """

    rule: str
    severity: Severity
    sentence: str
    frames: tuple[int, ...]
    consequence_of: int | None
    advice: str
    source: str


class TrafficTotals(NamedTuple):
    """Amount of traffic that a diagnosis examined.

    Attributes:
        frames: Number of frames and malformed items.
        calls: Number of calls.
        clients: Number of conversations with at least one call.
        duration_ns: Time from the first frame to the end, ns.
        not_followed: Number of calls that were evicted before a reply arrived.
        selected_calls: Number of selected calls; None if all are selected.
    """

    frames: int
    calls: int
    clients: int
    duration_ns: int
    not_followed: int = 0
    selected_calls: int | None = None
