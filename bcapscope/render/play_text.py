"""Output of `play`: the controller, progress, charts, problems and the summary."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import orjson

from bcapscope.analysis.statistics.distribution_summary import Bin
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
from bcapscope.protocol.slave_mode.modes import PERIOD_MS, PoseType
from bcapscope.protocol.slave_mode.poses import AXES
from bcapscope.protocol.tables.hresult import hresult_name
from bcapscope.protocol.text_format import display_width
from bcapscope.render.color_palette import PLAIN, Palette
from bcapscope.render.escape import printable
from bcapscope.render.text_charts import braille_chart, histogram

_COUNTS = ("retries", "late", "unanswered", "repeated", "shifted", "held")

RETRIES_EXPECTED = Message("play.retries-expected")
"""Over UDP, the timeout that DENSO recommends for Sync causes retries (DENSO Wave 2009, How to use the Slave
mode)."""


def controller_line(peer: ControllerInfo, words: MessageFormatter = ENGLISH_WORDS) -> str:
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
        entered = words("play.mode.known", mode=mode, meaning=known.description)
    return f"{', '.join((kind, peer.generation, *facts))}; {entered}"


def trouble_lines(trouble: PlayerProblem, words: MessageFormatter = ENGLISH_WORDS) -> Iterator[str]:
    yield from map(printable, words.text(trouble.text).splitlines())
    for code, text in trouble.errors:
        yield f"  {words('play.shown-error', name=hresult_name(code), text=printable(text))}"


def progress_line(progress: PlayProgress, width: int, words: MessageFormatter = ENGLISH_WORDS) -> str:
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
    """Return the summary as a JSON object. Times are in ms. The reason is escaped."""
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


_MAX_CHART_ROWS = 16  # a taller chart would not show more detail

_LARGEST_POSITION = 1e9

PoseHistory = Sequence[tuple[float, Sequence[float], Sequence[float]]]
"""For each set point: the elapsed time in seconds, the commanded pose and the returned pose."""


def axis_charts(
    kind: PoseType,
    history: PoseHistory,
    axes: Sequence[int],
    *,
    width: int,
    height: int,
    palette: Palette = PLAIN,
    words: MessageFormatter = ENGLISH_WORDS,
) -> Iterator[str]:
    """Yield one chart per axis, titled with the latest values. The charts share `height` lines."""
    each = min(_MAX_CHART_ROWS, max(4, height // max(1, len(axes))))
    for axis in axes:
        commanded = [(time, point[axis]) for time, point, _ in history if axis < len(point)]
        actual = [(time, pose[axis]) for time, _, pose in history if axis < len(pose)]
        yield _title(AXES[kind][axis].name, commanded, actual, palette, words)
        curves = [(actual, palette.good), (commanded, palette.number)]
        yield from braille_chart(curves, width, each - 1, palette, AXES[kind][axis].unit.replace("deg", "°"))


def _title(
    name: str,
    commanded: Sequence[tuple[float, float]],
    actual: Sequence[tuple[float, float]],
    palette: Palette,
    words: MessageFormatter,
) -> str:
    text = f"{palette.name}{name}{palette.reset}"
    if commanded:
        position = _position_text(commanded[-1][1])
        text += f"  {palette.number}{words('run.commanded')} {position}{palette.reset}"
    if actual:
        text += f"  {palette.good}{words('run.actual')} {_position_text(actual[-1][1])}{palette.reset}"
    if commanded and actual:
        behind = commanded[-1][1] - actual[-1][1]
        text += f"  {palette.dim}{words('run.behind')} {_position_text(behind)}{palette.reset}"
    return text


def _position_text(value: float) -> str:
    return f"{value:.3f}" if abs(value) < _LARGEST_POSITION else f"{value:.3g}"


def cycle_histogram_lines(progress: PlayProgress, palette: Palette = PLAIN) -> Iterator[str]:
    """Yield the lines of a histogram of the cycle times in ms."""
    bins = [Bin(low / 1e6, (high + 1) / 1e6, count) for low, high, count in progress.cycle]
    edges = sorted({edge for each in bins for edge in (each.low, each.high)})
    yield from histogram(bins, edges, palette)


def run_figure_lines(
    progress: PlayProgress,
    slack: tuple[int, float, float] | None,
    palette: Palette = PLAIN,
    words: MessageFormatter = ENGLISH_WORDS,
) -> Iterator[str]:
    """Yield lines with elapsed and remaining time, lateness, retries and the estimated level of the buffer.

    `slack` holds the number of buffer slots, the duration of a full buffer (ms), and the duration left after
    the longest pause (ms). `slack` is None if the buffer cannot run empty.
    """

    def number(text: str) -> str:
        return f"{palette.number}{text}{palette.reset}"

    yield _progress_line(progress, palette, words)
    late, counts = progress.lateness, progress.counts
    if late.count:
        figures = {"p50": late.p50, "p99": late.p99, "p999": late.p999, "most": late.most}
        yield words("run.late", **{name: number(f"{each / 1e6:.3f}") for name, each in figures.items()})
    color = palette.problem if counts.unanswered or counts.shifted else palette.number
    yield words(
        "run.counts",
        retries=number(str(counts.retries)),
        late=number(str(counts.late)),
        unanswered=f"{color}{counts.unanswered}{palette.reset}",
        postponed=f"{color}{counts.shifted}{palette.reset}",
    )
    if slack is not None:
        slots, whole, rest = slack
        shown = palette.good if rest > whole / 3 else palette.bad
        yield words(
            "run.buffer",
            slots=slots,
            period=f"{PERIOD_MS} ms",
            rest=f"{shown}{max(0.0, rest):.1f}{palette.reset}",
            whole=f"{whole:.0f} ms",
        )


def _progress_line(progress: PlayProgress, palette: Palette, words: MessageFormatter) -> str:
    number, reset = palette.number, palette.reset
    index = f"{number}{progress.index}"
    point = (
        words("run.point.of", index=index, total=f"{progress.of}{reset}")
        if progress.of
        else words("run.point", index=f"{index}{reset}")
    )
    places: dict[str, PlaceValue] = {
        "state": f"{palette.name}{words.text(progress.state.message)}{reset}",
        "point": point,
        "elapsed": f"{number}{progress.elapsed:.1f} s{reset}",
    }
    if progress.left is None:
        return words("run.progress", **places)
    return words("run.progress.left", **places, left=f"{number}{progress.left:.1f} s{reset}")


def progress_bar(progress: PlayProgress, width: int, palette: Palette = PLAIN) -> str:
    """Return a progress bar, or "" if `play` continues without end."""
    if not progress.of:
        return ""
    done = round(min(1.0, progress.index / progress.of) * width)
    return f"{palette.good}{'━' * done}{palette.dim}{'─' * (width - done)}{palette.reset}"
