"""Texts on the progress of reading and searching, short enough for the view bar."""

from __future__ import annotations

from bcapscope.render.escape import printable
from bcapscope.tui.reader_language import label
from bcapscope.tui.traffic_processes.process_messages import ReadProgress

_BAR = 12


def progress_texts(
    progress: ReadProgress, source_problem: str, searched: int | None, title: str
) -> tuple[str, ...]:
    """Return texts on the progress of reading and searching, longest text first.

    Args:
        source_problem: Why the source of the traffic may have ended although reading continues; "" otherwise.
        searched: Percentage of rows that the search has examined; None if the search is complete.
    """
    long, short = [], []
    if searched is not None:
        long.append(label("traffic.searching", percent=searched))
        short.append(f"/{searched}%")
    if progress.lost:
        long.append(label("traffic.lost", count=progress.lost))
    if source_problem:
        long.append(f"○ {printable(source_problem)}")
        short.append(f"○ {label('traffic.ended')}")
    elif not progress.ended and progress.size:
        percent = 100 * progress.position // progress.size
        long.append(f"{label('traffic.reading')} {_progress_bar(percent)} {percent:>3} %")
        short.append(f"{percent}%")
    elif not progress.ended:
        long.append(f"● {label('traffic.live')}")
        short.append("●")
    return "  ".join((*long, printable(title))), "  ".join(long), " ".join(short)


def count_text(number: int, brief: bool) -> str:
    """Return a count as text; if `brief`, round counts from 10,000 down, as in ``12k`` or ``1.2M``."""
    if not brief or number < 10_000:
        return f"{number:,}"
    return f"{number // 1000}k" if number < 1_000_000 else f"{number // 100_000 / 10}M"


def _progress_bar(percent: int) -> str:
    full = _BAR * percent // 100
    return f"{'━' * full}{'╌' * (_BAR - full)}"
