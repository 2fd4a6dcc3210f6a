"""Summary of what the proxy's rules did, as text."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Mapping
from typing import Any

from bcapscope.protocol.codec.frame import Frame
from bcapscope.protocol.tables.command_catalogue import call_name
from bcapscope.proxy.script_queue import ScriptQueue

_MAX_NAMED = 8


def report_lines(
    fault_counts: Mapping[str, int],
    refused: int | None,
    held: int,
    dropped_held: int,
    scripts: ScriptQueue[Any] | None,
) -> list[str]:
    """Return a summary of what the rules did.

    Args:
        fault_counts: How often each fault was injected.
        refused: Number of refused requests; None without a guard.
        held: Number of messages that were held.
        dropped_held: Number of held requests that were dropped because their client no longer waited.
        scripts: The scripts; None without any.
    """
    lines = [f"fault {name}: injected {_times_text(count)}" for name, count in fault_counts.items()]
    if refused is not None:
        lines.append(f"guard: refused {_times_text(refused)}")
    if held:
        lines.append(f"intercept: held {_times_text(held)}")
    if dropped_held:
        lines.append(f"held requests dropped because their client no longer waited: {dropped_held}")
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
