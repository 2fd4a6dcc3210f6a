"""What a diagnosis says: one finding a rule, in words for people, and how much was looked at."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum
from typing import NamedTuple


class Severity(StrEnum):
    """How much a finding matters."""

    ERROR = "error"
    """Something did not happen that was asked for."""
    WARNING = "warning"
    """It went well, but it will not always."""
    NOTE = "note"
    """Worth knowing when reading the rest."""


@dataclass(frozen=True, slots=True)
class Finding:
    """One cause, or one consequence.

    Attributes:
        rule: id of the rule that found it.
        severity: of the rule.
        sentence: one sentence in plain English. It may hold strings from the wire as they came, so it has to
            be escaped before it is shown.
        frames: numbers of the frames that prove it, in order; where it happened more than once, those of one
            time and of the first and last.
        consequence_of: number of the finding, counted from 1 in the order in which they were given out, that
            this one follows from; None where no earlier cause was found.
        advice: what to do, one sentence.
        source: where the rule is from.
    """

    rule: str
    severity: Severity
    sentence: str
    frames: tuple[int, ...]
    consequence_of: int | None
    advice: str
    source: str


class TrafficTotals(NamedTuple):
    """How much a diagnosis saw.

    Attributes:
        frames: frames and malformed items.
        calls: calls.
        clients: conversations that asked at least once.
        duration_ns: from the first frame to the end.
        not_followed: of the calls those that were let go before a reply was seen.
        selected_calls: of the calls those that were asked for; None where all were.
    """

    frames: int
    calls: int
    clients: int
    duration_ns: int
    not_followed: int = 0
    selected_calls: int | None = None
