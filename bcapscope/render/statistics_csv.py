"""Call statistics as comma-separated values (RFC 4180)."""

from __future__ import annotations

from collections.abc import Iterator

from bcapscope.analysis.statistics.call_statistics import OTHER_KINDS, Statistics, StatisticsRow
from bcapscope.protocol.tables.function_table import function_name
from bcapscope.render.csv_table import csv_cell, csv_row
from bcapscope.render.json_values import percentiles_object
from bcapscope.render.timestamp import epoch_text

_COUNTS = {
    "calls": "calls",
    "answered": "answered",
    "refused": "refused",
    "unanswered": "unanswered",
    "capture_ended": "open",
    "not_followed": "not_followed",
    "not_captured": "not_captured",
    "retries": "retries",
    "retried_calls": "retried_calls",
    "late_replies": "late_replies",
    "executing": "executing",
    "request_bytes": "request_bytes",
    "calls_per_s": "calls_per_second",
    "line_time_share": "line_time_share",
}
"""Attributes of `CallFigures` by column."""

_LATENCIES = ("mean", "min", "p50", "p90", "p99", "p99.9", "max")

STATISTICS_COLUMNS = (
    *("start", "end", "row", "client", "server", "transport", "function", "command"),
    *_COUNTS,
    *(f"latency_ms.{name}" for name in _LATENCIES),
)
"""Column names, the same as in JSON. The column `row` contains `total`, `client` or `command`."""


def statistics_header() -> str:
    return csv_row(STATISTICS_COLUMNS)


def statistics_rows(statistics: Statistics) -> Iterator[str]:
    """Yield the rows for a period. The first row has the total. The others are one row per client, and one
    row for each command of a client.
    """
    period = epoch_text(statistics.start), epoch_text(statistics.end)
    yield csv_row((*period, "total", *_cells(statistics.total)))
    for row in statistics.clients:
        yield csv_row((*period, "client", *_cells(row)))
    for row in statistics.commands:
        yield csv_row((*period, "command", *_cells(row)))


def _cells(row: StatisticsRow) -> Iterator[object]:
    conversation, kind, figures = row.conversation, row.call_kind, row.figures
    for name in ("client", "server", "transport"):
        yield "" if conversation is None else csv_cell(str(getattr(conversation, name)))
    yield "" if kind is None else "others" if kind is OTHER_KINDS else function_name(kind.function_id)
    yield "" if kind is None else csv_cell(kind.command or "")
    for attribute in _COUNTS.values():
        value = getattr(figures, attribute)
        yield "" if value is None else value
    latency = {} if figures.latency is None else percentiles_object(figures.latency)
    yield from (latency.get(name, "") for name in _LATENCIES)
