"""Summary of what the proxy's rules did."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable
from typing import TYPE_CHECKING

from bcapscope.messages import Message
from bcapscope.messages.message import foreign_text
from bcapscope.messages.places import Enumeration
from bcapscope.protocol.codec.frame import Frame
from bcapscope.protocol.tables.command_catalogue import call_name

if TYPE_CHECKING:
    from bcapscope.proxy.rule_policy import RulePolicy

_MAX_NAMED = 8


def report_lines(rules: RulePolicy) -> list[Message]:
    lines = [
        Message("rules.injected", name=name, times=_times(count))
        for name, count in rules.shaper.hit_counts.items()
    ]
    if rules.guard is not None:
        lines.append(Message("rules.refused", times=_times(rules.refused_requests)))
    if rules.intercept.held_so_far:
        lines.append(Message("rules.held", times=_times(rules.intercept.held_so_far)))
    if rules.dropped_held:
        lines.append(Message("rules.dropped-held", count=rules.dropped_held))
    scripts = rules.scripts
    if scripts is not None and scripts.errors:
        lines.append(Message("rules.script-errors", times=_times(scripts.errors)))
    if scripts is not None and scripts.off_because is not None:
        lines.append(Message("rules.scripts-off", reason=scripts.off_because))
    return lines


def names_with_counts(lost: Iterable[Frame | bytes]) -> Message:
    """Return the most frequent names of the lost requests, with a count for each name. Items of `lost` that
    are bytes, not frames, are counted together under the name of the message `rules.lost.bytes`.
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
