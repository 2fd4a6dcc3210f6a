"""Output of `play`: the controller, a progress line, problems and the summary."""

from __future__ import annotations

from collections.abc import Iterator

import orjson

from bcapscope.messages import ENGLISH_WORDS, Message, MessageFormatter
from bcapscope.messages.message import PlaceValue
from bcapscope.messages.places import Enumeration
from bcapscope.player.lateness import Spread
from bcapscope.player.player_messages import (
    ControllerInfo,
    PlayCounts,
    PlayEnded,
    PlayerProblem,
    PlayOutcome,
    PlayProgress,
)
from bcapscope.protocol.slave_mode.modes import describe_mode
from bcapscope.protocol.tables.hresult import hresult_name
from bcapscope.protocol.text_format import display_width
from bcapscope.render.escape import printable

_COUNTS = ("retries", "late", "unanswered", "repeated", "shifted", "held")

RETRIES_EXPECTED = Message("play.retries-expected")
"""Says that retries are normal. Over UDP, the timeout that DENSO recommends for Sync causes retries (DENSO
Wave 2009, How to use the Slave mode).
"""


def controller_line(peer: ControllerInfo, words: MessageFormatter = ENGLISH_WORDS) -> str:
    """Return a line that describes the controller and the slave mode that the player will enter."""
    kind = words("play.simulator" if peer.simulator else "play.controller")
    facts = [
        words(f"play.fact.{name.replace(' ', '-')}", value=printable(value))
        for name, value in peer.facts.items()
    ]
    mode = f"0x{peer.mode:03X}"
    known = peer.slave_mode
    if known is None:
        entered = words("play.mode", mode=mode)
    else:
        entered = words("play.mode.known", mode=mode, meaning=describe_mode(known))
    return f"{', '.join((kind, peer.generation, *facts))}; {entered}"


def trouble_lines(trouble: PlayerProblem, words: MessageFormatter = ENGLISH_WORDS) -> Iterator[str]:
    """Yield a line for the problem, then one for each active error of the controller."""
    yield from map(printable, words.text(trouble.text).splitlines())
    for code, text in trouble.errors:
        yield f"  {words('play.shown-error', name=hresult_name(code), text=printable(text))}"


def progress_line(progress: PlayProgress, width: int, words: MessageFormatter = ENGLISH_WORDS) -> str:
    """Return the progress of the player as one line of at most `width` columns."""
    index = f"{progress.index}/{progress.of}" if progress.of else str(progress.index)
    places: dict[str, PlaceValue] = {"state": progress.state.message, "index": index}
    places["elapsed"] = f"{progress.elapsed:.1f} s"
    if progress.left is None:
        parts = [words("run.short", **places)]
    else:
        parts = [words("run.short.left", **places, left=f"{progress.left:.1f} s")]
    late = progress.lateness
    if late.count:
        parts.append(words("run.late.short", p999=f"{late.p999 / 1e6:.3f}", most=f"{late.most / 1e6:.3f}"))
    parts.append(words("run.retries", n=progress.counts.retries))
    if progress.returned:
        parts.append(" ".join(f"{value:.2f}" for value in progress.returned))
    line = "  ".join(parts)
    while display_width(line) > width:
        line = line[:-1]
    return line


def play_summary_lines(ended: PlayEnded, words: MessageFormatter = ENGLISH_WORDS) -> Iterator[str]:
    """Yield the lines of the summary that `play` prints at its end."""
    is_unbegun = ended.outcome is PlayOutcome.STOPPED and not ended.index
    head = words("play.ended.stopped-before" if is_unbegun else f"play.ended.{ended.outcome}")
    reason, *more = ("" if ended.reason is None else words.text(ended.reason)).splitlines() or ("",)
    yield f"{head}: {printable(reason)}" if reason else head
    yield from (f"  {printable(line.strip())}" for line in more)
    if ended.counts.sent:
        counts = [(name, getattr(ended.counts, name)) for name in _COUNTS]
        parts = tuple(Message(f"play.count.{name}", count=count) for name, count in counts if count)
        details = Enumeration(parts or (Message("play.count.first-attempts"),))
        yield words("play.set-points", sent=ended.counts.sent, details=details)
        if ended.counts.retries and ended.retries_expected:
            yield words.text(RETRIES_EXPECTED)
        id = "play.lateness.realtime" if ended.realtime else "play.lateness"
        yield words(id, figures=_spread_text(ended.lateness))
        yield words("play.intervals", figures=_spread_text(ended.cycle))
    if ended.logged:
        yield words("play.logged", count=ended.logged)
    if not ended.left:
        yield words("play.not-left")


def play_summary_record(ended: PlayEnded) -> bytes:
    """Return the summary as a JSON object.

    Times are in ms. Non-printable characters in the reason are escaped.
    """
    counts = {name: getattr(ended.counts, name) for name in PlayCounts.__struct_fields__}
    return orjson.dumps(
        {
            "outcome": ended.outcome.value,
            "reason": "" if ended.reason is None else printable(str(ended.reason)),
            "set_points": ended.index,
            **counts,
            "lateness_ms": _spread_record(ended.lateness),
            "cycle_ms": _spread_record(ended.cycle),
            "realtime": ended.realtime,
            "left_in_order": ended.left,
            "log_records": ended.logged,
        }
    )


def _spread_text(spread: Spread) -> str:
    points = (("p50", spread.p50), ("p99", spread.p99), ("p99.9", spread.p999), ("max", spread.most))
    return ", ".join(f"{name} {value / 1e6:.3f}" for name, value in points)


def _spread_record(spread: Spread) -> dict[str, float]:
    return {name: getattr(spread, name) / 1e6 for name in ("p50", "p99", "p999", "most")}
