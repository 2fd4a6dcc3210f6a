"""The summary line of a diagnosis."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable
from typing import Any

from bcapscope.analysis.finding import Severity, TrafficTotals
from bcapscope.messages import ENGLISH_WORDS, Message, MessageFormatter
from bcapscope.messages.places import Count, Duration
from bcapscope.render.color_palette import PLAIN, Palette


def diagnosis_summary(
    severities: Iterable[str],
    totals: TrafficTotals,
    palette: Palette = PLAIN,
    words: MessageFormatter = ENGLISH_WORDS,
) -> str:
    """Return the summary line: the number of findings of each severity, and how much traffic was examined."""
    if not totals.frames:
        return words("diagnosis.nothing")
    counts = Counter(severities)
    found, size = severity_counts_text(counts, words), _size_message(totals)
    if counts[Severity.ERROR] or counts[Severity.WARNING]:
        return words("diagnosis.problems", found=found, size=size)
    none = f"{palette.good}{words('diagnosis.no-problem')}{palette.reset}"
    if found:
        return words("diagnosis.notes", none=none, size=size, found=found)
    return words("diagnosis.healthy", none=none, size=size)


def severity_counts_text(counts: Counter[Any], words: MessageFormatter) -> str:
    """Return the number of findings for each severity that occurs, highest severity first."""
    found = (words.plural(f"count.{each}", counts[each]) for each in Severity if counts[each])
    return words("list.comma").join(found)


def _size_message(totals: TrafficTotals) -> Message:
    size = Message(
        "diagnosis.size",
        frames=Count(totals.frames, "frame"),
        calls=Count(totals.calls, "call"),
        clients=Count(totals.clients, "client"),
        duration=Duration(totals.duration_ns),
    )
    if totals.not_followed:
        size = Message("diagnosis.size.not-followed", size=size, calls=Count(totals.not_followed, "call"))
    if totals.selected_calls is None:
        return size
    return Message("diagnosis.size.selected", size=size, calls=Count(totals.selected_calls, "call"))
