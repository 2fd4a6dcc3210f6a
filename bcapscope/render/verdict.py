"""What a diagnosis comes to, in one line."""

from __future__ import annotations

from collections.abc import Iterable

from bcapscope.analysis.finding import Seen, Severity
from bcapscope.analysis.speech import span
from bcapscope.protocol.wording import counted
from bcapscope.render.palette import PLAIN, Palette
from bcapscope.render.tongue import Tongue, english


def verdict(found: Iterable[str], seen: Seen, palette: Palette = PLAIN, tongue: Tongue = english) -> str:
    """Say how many findings there are, and in how much traffic.

    Args:
        found: the severity of each finding.
        seen: how much traffic that was.
        palette: `good` is for traffic without problems.
        tongue: of the words.
    """
    if not seen.frames:
        return tongue("No b-CAP was seen.")
    counts = dict.fromkeys(map(str, Severity), 0)
    for severity in found:
        counts[severity] += 1
    told = [tongue(counted(count, severity)) for severity, count in counts.items() if count]
    size = f"{tongue(' in ')}{_size(seen, tongue)}"
    if counts[Severity.ERROR] or counts[Severity.WARNING]:
        return f"{', '.join(told)}{size}"
    notes = f"; {told[0]}" if told else ""
    return f"{palette.good}{tongue('No problem found')}{palette.reset}{size}{notes}"


def _size(seen: Seen, tongue: Tongue) -> str:
    counts = ((seen.frames, "frame"), (seen.calls, "call"), (seen.clients, "client"))
    size = ", ".join((*(tongue(counted(count, noun)) for count, noun in counts), span(seen.nanoseconds)))
    if seen.not_followed:
        size += tongue(f", {counted(seen.not_followed, 'call')} not followed to the end")
    if seen.chosen is None:
        return size
    verb = "fits" if seen.chosen == 1 else "fit"
    return f"what concerns {counted(seen.chosen, 'call')} that {verb} the filter, of {size}"
