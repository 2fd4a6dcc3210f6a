"""What a diagnosis comes to, in one line."""

from __future__ import annotations

from collections.abc import Iterable

from bcapscope.analysis.finding import Severity, TrafficTotals
from bcapscope.analysis.speech import span
from bcapscope.protocol.text_format import counted
from bcapscope.render.color_palette import PLAIN, Palette
from bcapscope.render.tongue import Tongue, english


def diagnosis_summary(
    severities: Iterable[str], totals: TrafficTotals, palette: Palette = PLAIN, tongue: Tongue = english
) -> str:
    """Say how many findings there are, and in how much traffic.

    Args:
        severities: the severity of each finding.
        totals: how much traffic that was.
        palette: `good` is for traffic without problems.
        tongue: of the words.
    """
    if not totals.frames:
        return tongue("No b-CAP was seen.")
    counts = dict.fromkeys(map(str, Severity), 0)
    for severity in severities:
        counts[severity] += 1
    told = [tongue(counted(count, severity)) for severity, count in counts.items() if count]
    size = f"{tongue(' in ')}{_totals_text(totals, tongue)}"
    if counts[Severity.ERROR] or counts[Severity.WARNING]:
        return f"{', '.join(told)}{size}"
    notes = f"; {told[0]}" if told else ""
    return f"{palette.good}{tongue('No problem found')}{palette.reset}{size}{notes}"


def _totals_text(totals: TrafficTotals, tongue: Tongue) -> str:
    counts = ((totals.frames, "frame"), (totals.calls, "call"), (totals.clients, "client"))
    size = ", ".join((*(tongue(counted(count, noun)) for count, noun in counts), span(totals.duration_ns)))
    if totals.not_followed:
        size += tongue(f", {counted(totals.not_followed, 'call')} not followed to the end")
    if totals.selected_calls is None:
        return size
    verb = "fits" if totals.selected_calls == 1 else "fit"
    return f"what concerns {counted(totals.selected_calls, 'call')} that {verb} the filter, of {size}"
