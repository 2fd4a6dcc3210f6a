"""Summary of what the proxy's rules did."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Mapping

from bcapscope.messages import Message
from bcapscope.messages.message import foreign_text
from bcapscope.messages.places import Enumeration
from bcapscope.protocol.codec.frame import Frame
from bcapscope.protocol.tables.command_catalogue import call_name
from bcapscope.proxy.script_queue import ScriptQueue

_MAX_NAMED = 8


def report_lines(
    fault_counts: Mapping[str, int],
    refused: int | None,
    held: int,
    dropped_held: int,
    scripts: ScriptQueue | None,
) -> list[Message]:
    """Return a summary of what the rules did, one message per line.

    Args:
        fault_counts: Number of injections of each fault, by the fault's name.
        refused: Number of refused requests; None without a guard.
        dropped_held: Number of held requests that the proxy dropped because their client no longer waited.
        scripts: Queue of the scripts; None without scripts.
    """
    lines = [
        Message("rules.injected", name=name, times=_times(count)) for name, count in fault_counts.items()
    ]
    if refused is not None:
        lines.append(Message("rules.refused", times=_times(refused)))
    if held:
        lines.append(Message("rules.held", times=_times(held)))
    if dropped_held:
        lines.append(Message("rules.dropped-held", count=dropped_held))
    if scripts is not None and scripts.errors:
        lines.append(Message("rules.script-errors", times=_times(scripts.errors)))
    if scripts is not None and scripts.off_because is not None:
        lines.append(Message("rules.scripts-off", reason=scripts.off_because))
    return lines


def names_with_counts(lost: Iterable[Frame | bytes]) -> Message:
    """Return the names of the lost data, and how often each name occurs. An element of `lost` is a request or
    a piece of a stream.
    """
    names = Counter(map(_named, lost))
    more = len(names) - _MAX_NAMED
    most = names.most_common(_MAX_NAMED)
    items = Enumeration(tuple(Message("rules.lost", count=count, name=name) for name, count in most))
    return Message("list.and-more", items=items, more=more) if more > 0 else Message("list.of", items=items)


def _named(lost: Frame | bytes) -> Message:
    if isinstance(lost, bytes):
        return Message("rules.lost.bytes")
    return foreign_text(call_name(lost.code, lost.variants)[:80])


def _times(count: int) -> Message:
    return Message({0: "rules.never", 1: "rules.once"}.get(count, "rules.times"), count=count)
