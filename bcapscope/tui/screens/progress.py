"""How far reading and searching have come, in the few words that a bar has room for."""

from __future__ import annotations

from bcapscope.render.escape import printable
from bcapscope.tui.traffic.report import Progress
from bcapscope.tui.words import say

_BAR = 12


def states(told: Progress, doubt: str, searched: int | None, title: str) -> tuple[str, ...]:
    """Say how reading and searching go, the longest way first.

    Args:
        told: what the process that reads told last.
        doubt: why nothing more may come although it would be read; "" where it may.
        searched: percent of what is there that was searched; None while nothing is left to be searched.
        title: of what is read.
    """
    long, short = [], []
    if searched is not None:
        long.append(say("traffic.searching", percent=searched))
        short.append(f"/{searched}%")
    if told.lost:
        long.append(say("traffic.lost", count=told.lost))
    if doubt:
        long.append(f"○ {printable(doubt)}")
        short.append(f"○ {say('traffic.ended')}")
    elif not told.ended and told.size:
        percent = 100 * told.position // told.size
        long.append(f"{say('traffic.reading')} {_bar(percent)} {percent:>3} %")
        short.append(f"{percent}%")
    elif not told.ended:
        long.append(f"● {say('traffic.live')}")
        short.append("●")
    return "  ".join((*long, printable(title))), "  ".join(long), " ".join(short)


def count(number: int, brief: bool) -> str:
    """Write a count, in a narrow place rounded down to three digits."""
    if not brief or number < 10_000:
        return f"{number:,}"
    return f"{number // 1000}k" if number < 1_000_000 else f"{number // 100_000 / 10}M"


def _bar(percent: int) -> str:
    """Draw how far reading has come."""
    full = _BAR * percent // 100
    return f"{'━' * full}{'╌' * (_BAR - full)}"
