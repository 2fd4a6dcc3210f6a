"""Summary of what the proxy's rules did, as text."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable
from typing import TYPE_CHECKING

from bcapscope.protocol.codec.frame import Frame
from bcapscope.protocol.tables.command_catalogue import call_name

if TYPE_CHECKING:
    from bcapscope.proxy.rule_policy import RulePolicy

_MAX_NAMED = 8


def report_lines(rules: RulePolicy) -> list[str]:
    """Return a summary of what the rules did."""
    scripts = rules.scripts
    lines = [
        f"fault {name}: injected {_times_text(count)}" for name, count in rules.shaper.hit_counts.items()
    ]
    if rules.guard is not None:
        lines.append(f"guard: refused {_times_text(rules.refused_requests)}")
    if rules.intercept.held_so_far:
        lines.append(f"intercept: held {_times_text(rules.intercept.held_so_far)}")
    if rules.dropped_held:
        lines.append(f"held requests dropped because their client no longer waited: {rules.dropped_held}")
    if scripts is not None and scripts.errors:
        lines.append(f"scripts: went wrong {_times_text(scripts.errors)}")
    if scripts is not None and scripts.off_because:
        lines.append(f"scripts: switched off, {scripts.off_because}")
    return lines


def names_with_counts(lost: Iterable[Frame | bytes]) -> str:
    """Name lost requests, or pieces of a stream, each name with its count."""
    names = Counter(map(_named, lost))
    more = len(names) - _MAX_NAMED
    return ", ".join(f"{count} {name}" for name, count in names.most_common(_MAX_NAMED)) + (
        f" and {more} more" if more > 0 else ""
    )


def _named(lost: Frame | bytes) -> str:
    if isinstance(lost, bytes):
        return "piece of a stream, or bytes that are no frame"
    return call_name(lost.code, lost.variants)[:80]


def _times_text(count: int) -> str:
    return {0: "never", 1: "once"}.get(count, f"{count} times")
