"""The timing of a slave-mode session as text: when the client sent set points, and when replies came."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from bcapscope.analysis.slave.session_slices import SessionSlice
from bcapscope.analysis.slave.slave_session import SlaveSession
from bcapscope.analysis.slave.timing_model import TimingFacts
from bcapscope.analysis.statistics.distribution_summary import DistributionSummary
from bcapscope.messages import Message
from bcapscope.messages.message import PlaceValue
from bcapscope.messages.places import Count, Quantity
from bcapscope.render.captioned import CaptionWriter, frames_message
from bcapscope.render.histogram import edges_around, edges_by_decades, histogram

_SLICE_COLUMNS = (
    *("from", "sent", "retries", "refused", "cycle-p50", "p99", "max", "latency-p99", "max", "slack"),
)
"""Ids of the columns in the table of time slices."""


def timing_lines(timing: TimingFacts, writer: CaptionWriter) -> Iterator[str]:
    """Yield a table of the time distributions in ms, and histograms of cycle times and latencies."""
    names = ("cycle", "jitter", "latency", "round-trip")
    found = (timing.cycle, timing.jitter, timing.latency, timing.rtt)
    mean, most = writer.label("slave.column.mean"), writer.label("slave.column.max")
    rows: list[tuple[str, ...]] = [("ms", mean, "p50", "p90", "p99", "p99.9", most)]
    rows += [
        (writer.label(f"slave.row.{name}"), *_points(each))
        for name, each in zip(names, found, strict=True)
        if each is not None
    ]
    yield from writer.table(rows, "<>>>>>>")
    places: dict[str, PlaceValue] = {"period": Quantity(timing.grid_ms, "ms")}
    grid = Message("slave.grid.no-rate", **places)
    if timing.rate_hz is not None:
        grid = Message("slave.grid", **places, rate=Quantity(timing.rate_hz, "", 2))
    yield writer.captioned("grid", grid)
    if timing.grid_known_by is not None:
        yield from writer.wrapped(timing.grid_known_by)
    if timing.cycle is not None:
        yield from _cycle_lines(timing, timing.cycle, writer)
    if timing.latency is not None:
        yield writer.captioned("latencies", Message("slave.latencies"))
        yield from _histogram(timing.latency, edges_by_decades(), writer)


def _cycle_lines(timing: TimingFacts, cycle: DistributionSummary, writer: CaptionWriter) -> Iterator[str]:
    yield writer.continued(writer.joined(_grid_messages(timing, cycle)))
    if timing.gaps:
        frames = frames_message([fact.request_frame for fact in timing.gap_list], timing.gaps)
        text = Message("slave.gaps", n=timing.gaps, slack=Quantity(timing.slack_ms, "ms"), frames=frames)
        yield from writer.wrapped(text, writer.palette.problem)
    yield writer.captioned("cycles", Message("slave.cycles"))
    yield from _histogram(cycle, edges_around(timing.grid_ms), writer)


def _histogram(
    distribution: DistributionSummary, edges: Sequence[float], writer: CaptionWriter
) -> Iterator[str]:
    return (f"  {line}" for line in histogram(distribution.bins, edges, writer.palette))


def _grid_messages(timing: TimingFacts, cycle: DistributionSummary) -> Iterator[Message]:
    share = Quantity(100 * timing.on_grid / cycle.count, "%", 2)
    yield Message("slave.grid.within", share=share, limit=Quantity(timing.grid_ms / 10, "ms"))
    if timing.skipped:
        limit = Quantity(timing.grid_ms * 1.5, "ms")
        yield Message("slave.grid.skipped", n=timing.skipped, limit=limit)
    if timing.backwards:
        yield Message("slave.grid.backwards", n=timing.backwards)


def _points(found: DistributionSummary) -> tuple[str, ...]:
    values = found.mean, found.p50, found.p90, found.p99, found.p999, found.most
    return tuple(f"{value:.3f}" for value in values)


def deadline_lines(timing: TimingFacts, writer: CaptionWriter) -> Iterator[str]:
    """Yield a table of the recommended timeouts, and how many set points would have exceeded each timeout."""
    rows = [tuple(map(writer.label, ("slave.timeouts", "slave.timeouts.one", "slave.timeouts.all")))]
    for deadline in timing.deadlines:
        name = ("* " if deadline.applies else "  ") + writer.text(deadline.name)
        rows.append((name, str(deadline.late), str(deadline.given_up)))
    yield from writer.table(rows, "<>>")
    sources = dict.fromkeys(deadline.source for deadline in timing.deadlines if deadline.applies)
    if sources:
        yield from writer.wrapped(Message("slave.timeouts.recommended", sources="; ".join(sources)))


def slice_lines(slave_session: SlaveSession, writer: CaptionWriter) -> Iterator[str]:
    """Yield a table with the figures of each time slice of the session; times are in ms."""
    header = tuple(writer.label(f"slave.column.{name}") for name in _SLICE_COLUMNS)
    rows = [header, *(_slice(each, slave_session.slices[0].begin) for each in slave_session.slices)]
    yield from writer.table(rows, ">" * len(header))
    if slave_session.slices_left_off:
        left_off = Count(slave_session.slices_left_off, "more-slice")
        yield f"  {writer.label('slave.slices.more', slices=left_off)}"


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
