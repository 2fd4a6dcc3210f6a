"""Findings made by hand, and their sentences."""

from __future__ import annotations

from bcapscope.analysis.finding import NO_TRAFFIC, Finding, Severity, TrafficTotals
from bcapscope.messages import ENGLISH_WORDS, Message, MessageFormatter
from bcapscope.render.findings import finding_sentence, words_for
from bcapscope.traffic.observation import SERVER_PORT, Conversation, Endpoint, Transport

HERE = Conversation(Endpoint("10.0.0.2", 50001), Endpoint("10.0.0.1", 5007), Transport.UDP, SERVER_PORT)


def make_finding(  # noqa: PLR0917 - in the order of the fields
    rule: str,
    severity: Severity,
    sentence: str,
    frames: tuple[int, ...],
    consequence_of: int | None,
    advice: str,
    source: str,
) -> Finding:
    """Make a finding that says these sentences."""
    fact, help_text = Message.from_table("fact", sentence), Message.from_table("advice", advice)
    return Finding(rule, severity, fact, frames, consequence_of, help_text, source, (3,), HERE, 5)


def sentence_of(
    finding: Finding, totals: TrafficTotals = NO_TRAFFIC, words: MessageFormatter = ENGLISH_WORDS
) -> str:
    """Return the text of a finding about traffic of this amount."""
    return finding_sentence(finding, words_for(words, totals))
