"""When the set points of a stay were sent and answered, for people."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from bcapscope.analysis.slave.session_slices import SessionSlice
from bcapscope.analysis.slave.slave_session import SlaveSession
from bcapscope.analysis.slave.timing_model import TimingFacts
from bcapscope.analysis.statistics.distribution import DistributionSummary
from bcapscope.render.captioned import captioned_line, continued_line, frames_text, wrapped_lines
from bcapscope.render.color_palette import Palette
from bcapscope.render.columns import align_columns
from bcapscope.render.histogram import edges_around, edges_by_decades, histogram
from bcapscope.render.tongue import Tongue, english

_SLICE_TIMES = ("cycle p50", "p99", "max", "latency p99", "max", "slack")


def timing_lines(timing: TimingFacts, palette: Palette, tongue: Tongue = english) -> Iterator[str]:
    """Write how the times are spread, with histograms of cycles and latencies."""
    names = ("cycle", "jitter", "latency", "round trip")
    found = (timing.cycle, timing.jitter, timing.latency, timing.rtt)
    rows: list[tuple[str, ...]] = [tuple(map(tongue, ("ms", "mean", "p50", "p90", "p99", "p99.9", "max")))]
    rows += [
        (tongue(name), *_points(each)) for name, each in zip(names, found, strict=True) if each is not None
    ]
    first, *others = align_columns(rows, "<>>>>>>")
    yield f"  {palette.dim}{first}{palette.reset}"
    yield from (f"  {line}" for line in others)
    rate = "" if timing.rate_hz is None else f", {timing.rate_hz:.2f} set points a second"
    yield captioned_line("grid", f"{timing.grid_ms:g} ms{rate}", palette, tongue)
    yield from wrapped_lines(timing.grid_known_by, tongue=tongue)
    if timing.cycle is not None:
        yield continued_line(_on_grid(timing, timing.cycle), tongue)
        if timing.gaps:
            late = [fact.request_frame for fact in timing.gap_list]
            text = f"{timing.gaps} longer than the {timing.slack_ms:g} ms that the buffer can bridge"
            text = f"{text}; {frames_text(late, timing.gaps)}"
            yield from wrapped_lines(text, palette.problem, palette.reset, tongue)
        yield captioned_line("cycles", "in ms", palette, tongue)
        yield from _drawn(timing.cycle, edges_around(timing.grid_ms), palette)
    if timing.latency is not None:
        text = "in ms, from the first request to the accepted reply"
        yield captioned_line("latencies", text, palette, tongue)
        yield from _drawn(timing.latency, edges_by_decades(), palette)


def _drawn(distribution: DistributionSummary, edges: Sequence[float], palette: Palette) -> Iterator[str]:
    return (f"  {line}" for line in histogram(distribution.bins, edges, palette))


def _on_grid(timing: TimingFacts, cycle: DistributionSummary) -> str:
    told = [f"{timing.on_grid / cycle.count:.2%} of the cycles within {timing.grid_ms / 10:g} ms of it"]
    told += [f"{timing.skipped} of {timing.grid_ms * 1.5:g} ms or more"] if timing.skipped else []
    told += [f"{timing.backwards} out of order"] if timing.backwards else []
    return ", ".join(told)


def _points(found: DistributionSummary) -> tuple[str, ...]:
    values = found.mean, found.p50, found.p90, found.p99, found.p999, found.most
    return tuple(f"{value:.3f}" for value in values)


def deadline_lines(timing: TimingFacts, palette: Palette, tongue: Tongue = english) -> Iterator[str]:
    """Write how many set points would have missed each recommended time-out."""
    rows = [tuple(map(tongue, ("time-outs", "later than one try", "than all tries")))]
    for deadline in timing.deadlines:
        name = ("* " if deadline.applies else "  ") + tongue(deadline.name)
        rows.append((name, str(deadline.late), str(deadline.given_up)))
    first, *others = align_columns(rows, "<>>")
    yield f"  {palette.dim}{first}{palette.reset}"
    yield from (f"  {line}" for line in others)
    sources = dict.fromkeys(deadline.source for deadline in timing.deadlines if deadline.applies)
    if sources:
        yield from wrapped_lines(f"* recommended for this mode by {'; '.join(sources)}", tongue=tongue)


def slice_lines(slave_session: SlaveSession, palette: Palette, tongue: Tongue = english) -> Iterator[str]:
    """Write the figures of each slice of time, times in ms."""
    header = tuple(map(tongue, ("from s", "sent", "retries", "refused", *_SLICE_TIMES)))
    rows = [header, *(_slice(each, slave_session.slices[0].begin) for each in slave_session.slices)]
    first, *others = align_columns(rows, ">" * len(header))
    yield f"  {palette.dim}{first}{palette.reset}"
    yield from (f"  {line}" for line in others)
    if slave_session.slices_left_off:
        yield f"  {tongue(f'and {slave_session.slices_left_off} slices more')}"


def _slice(each: SessionSlice, begin: int) -> tuple[str, ...]:
    cycle, latency = each.cycle, each.latency
    return (
        f"+{(each.begin - begin) / 1e9:g}",
        str(each.sent),
        str(each.retries or ""),
        str(each.refused or ""),
        *(("", "", "") if cycle is None else _cells(cycle.p50, cycle.p99, cycle.most)),
        *(("", "") if latency is None else _cells(latency.p99, latency.most)),
        "" if each.smallest_slack_ms is None else f"{each.smallest_slack_ms:.3f}",
    )


def _cells(*values: float) -> tuple[str, ...]:
    return tuple(f"{value:.3f}" for value in values)
