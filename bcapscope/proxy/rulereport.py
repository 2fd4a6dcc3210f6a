"""What the proxy's rules did, as sentences for people."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable
from typing import TYPE_CHECKING

from bcapscope.protocol.commands import call_name
from bcapscope.protocol.frame import Frame

if TYPE_CHECKING:
    from bcapscope.proxy.rules import Rules

_MOST_NAMED = 8


def report_lines(rules: Rules) -> list[str]:
    """Sum up what rules did."""
    scripts = rules.scripts
    lines = [f"fault {name}: struck {_times(count)}" for name, count in rules.shaper.counts.items()]
    if rules.guard is not None:
        lines.append(f"guard: refused {_times(rules.refused)}")
    if rules.intercept.count:
        lines.append(f"intercept: held {_times(rules.intercept.count)}")
    if rules.lost:
        lines.append(f"held requests dropped because their client no longer waited: {rules.lost}")
    if scripts is not None and scripts.errors:
        lines.append(f"scripts: went wrong {_times(scripts.errors)}")
    if scripts is not None and scripts.off_because:
        lines.append(f"scripts: switched off, {scripts.off_because}")
    return lines


def names_of(lost: Iterable[Frame | bytes]) -> str:
    """Name requests, or pieces of a stream, that were lost, each name with its count."""
    names = Counter(map(_named, lost))
    more = len(names) - _MOST_NAMED
    return ", ".join(f"{count} {name}" for name, count in names.most_common(_MOST_NAMED)) + (
        f" and {more} more" if more > 0 else ""
    )


def _named(lost: Frame | bytes) -> str:
    if isinstance(lost, bytes):
        return "piece of a stream, or bytes that are no frame"
    return call_name(lost.code, lost.variants)[:80]


def _times(count: int) -> str:
    return {0: "never", 1: "once"}.get(count, f"{count} times")
