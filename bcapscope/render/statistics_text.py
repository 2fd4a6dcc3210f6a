"""Call statistics as text, as JSON and as CSV (RFC 4180)."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import orjson

from bcapscope.analysis.statistics.call_statistics import (
    OTHER_CLIENTS,
    OTHER_KINDS,
    CallFigures,
    Statistics,
    StatisticsRow,
)
from bcapscope.analysis.statistics.place_delays import OneWayFigures, PlaceFigures
from bcapscope.messages import ENGLISH_WORDS, MessageFormatter
from bcapscope.messages.places import Count
from bcapscope.protocol.tables.function_table import function_name
from bcapscope.protocol.tables.hresult import hresult_name
from bcapscope.render.color_palette import PLAIN, Palette
from bcapscope.render.columns import align_columns
from bcapscope.render.csv_table import csv_cell, csv_row
from bcapscope.render.escape import printable
from bcapscope.render.json_values import (
    PERCENTILES,
    conversation_object,
    percentiles_object,
    text_fragment,
    time_fragment,
)
from bcapscope.render.timestamp import epoch_text, utc_text
from bcapscope.traffic.call_kind import CallKind
from bcapscope.traffic.observation import Conversation

_PLACE_COLUMNS = ("frames", "lost", "p50", "p90", "p99", "max", "error")

MAX_ROWS = 40
"""Maximum number of rows of a text table; JSON contains all rows. The table of all clients shows the clients
with the most calls. The table of one client shows the kinds of call with the largest `line_time_share`.
"""

_LONGEST_NAME = 40
_COLUMNS = (
    *("calls", "per-s", "line-time", "p50", "p90", "p99", "p99-9", "max"),
    *("retries", "late", "refused", "unanswered"),
)
_FIGURES = {
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


def call_kind_text(call_kind: CallKind, words: MessageFormatter = ENGLISH_WORDS) -> str:
    if call_kind is OTHER_KINDS:
        return words("stats.others")
    name = function_name(call_kind.function_id)
    if call_kind.command is None:
        return name
    command = printable(call_kind.command)
    return f"{name} {command if len(command) <= _LONGEST_NAME else command[: _LONGEST_NAME - 1] + '…'}"


def statistics_lines(
    statistics: Statistics, palette: Palette = PLAIN, words: MessageFormatter = ENGLISH_WORDS
) -> Iterator[str]:
    seconds = (statistics.end - statistics.start) / 1e9
    yield f"{palette.name}{utc_text(statistics.start)}, {seconds:.3f} s{palette.reset}"
    yield ""
    rows = [(_client_text(row, words), row.figures) for row in statistics.clients]
    if len(rows) > 1:
        rows.insert(0, (_client_text(statistics.total, words), statistics.total.figures))
    yield from _table(words("stats.client"), rows, palette, words)
    for client in statistics.clients[:MAX_ROWS]:
        own = [row for row in statistics.commands if row.conversation is client.conversation]
        yield ""
        caption = words("stats.by-client", client=_client_text(client, words))
        kinds = [(call_kind_text(row.call_kind or OTHER_KINDS, words), row.figures) for row in own]
        yield from _table(caption, kinds, palette, words)
    yield from _refusals(statistics, palette, words)
    yield from _place_lines(statistics.places, palette, words)
    total = statistics.total.figures
    for name, count in (("not-followed", total.not_followed), ("not-captured", total.not_captured)):
        if count:
            yield ""
            yield f"{palette.dim}{words(f'stats.{name}', calls=Count(count, 'call'))}{palette.reset}"


def _client_text(row: StatisticsRow, words: MessageFormatter) -> str:
    conversation = row.conversation
    if conversation is None:
        return words("stats.all-clients")
    if conversation is OTHER_CLIENTS:
        return words("stats.other-clients")
    return conversation_text(conversation)


def conversation_text(conversation: Conversation) -> str:
    return printable(f"{conversation.client} > {conversation.server} {conversation.transport}")


def _table(
    caption: str, rows: Sequence[tuple[str, CallFigures]], palette: Palette, words: MessageFormatter
) -> Iterator[str]:
    cells = [(name, *_cells(figures)) for name, figures in rows[:MAX_ROWS]]
    yield from _with_header(caption, _COLUMNS, cells, palette, words)
    if len(rows) > MAX_ROWS:
        yield words("stats.more", n=len(rows) - MAX_ROWS)


def _with_header(
    caption: str,
    columns: Sequence[str],
    rows: Sequence[tuple[str, ...]],
    palette: Palette,
    words: MessageFormatter,
) -> Iterator[str]:
    head = (caption, *(words(f"stats.column.{name}") for name in columns))
    first, *others = align_columns([head, *rows], "<" + ">" * len(columns))
    yield f"{palette.dim}{first}{palette.reset}"
    yield from others


def _cells(figures: CallFigures) -> tuple[str, ...]:
    latency = figures.latency
    times: tuple[str, ...] = ("",) * 5
    if latency is not None:
        percentiles = (latency.p50, latency.p90, latency.p99, latency.p999, latency.most)
        times = tuple(f"{value:.3f}" for value in percentiles)
    counts = (figures.retries, figures.late_replies, figures.refused, figures.unanswered)
    return (
        str(figures.calls),
        "" if figures.calls_per_second is None else f"{figures.calls_per_second:.1f}",
        "" if figures.line_time_share is None else f"{figures.line_time_share:.1%}",
        *times,
        *(str(count or "") for count in counts),
    )


def _refusals(statistics: Statistics, palette: Palette, words: MessageFormatter) -> Iterator[str]:
    rows = [
        (call_kind_text(row.call_kind or OTHER_KINDS, words), row.figures.refusal_codes)
        for row in statistics.kinds
    ]
    refused = [(str(count), hresult_name(code), name) for name, codes in rows for code, count in codes]
    if refused:
        yield ""
        yield f"{palette.dim}{words('stats.refusals')}{palette.reset}"
        yield from align_columns(refused, "><<")


def _place_lines(places: Sequence[PlaceFigures], palette: Palette, words: MessageFormatter) -> Iterator[str]:
    if not places:
        return
    rows = [
        (
            f"{conversation_text(each.conversation)} {words(f'frame.role.{role}')}",
            *_one_way_cells(figures, each.delay_error),
        )
        for each in places[:MAX_ROWS]
        for role, figures in (("request", each.requests), ("reply", each.replies))
    ]
    yield ""
    yield from _with_header(words("stats.places"), _PLACE_COLUMNS, rows, palette, words)


def _one_way_cells(figures: OneWayFigures, error: float) -> tuple[str, ...]:
    delay = figures.delay
    times: tuple[str, ...] = ("",) * 5
    if delay is not None:
        percentiles = (delay.p50, delay.p90, delay.p99, delay.most)
        times = (*(f"{value:.3f}" for value in percentiles), f"{error:.3f}" if error else "")
    return str(figures.frames), str(figures.lost or ""), *times


def statistics_record(statistics: Statistics) -> bytes:
    """Return the figures of a period as one JSON object, without a line end.

    Latencies and delays are in milliseconds, `start` and `end` in seconds since 1970. `line_time_share` is
    from 0 to 1. `places` has one object per conversation that was captured at two places.
    """
    return orjson.dumps(
        {
            "start": time_fragment(statistics.start),
            "end": time_fragment(statistics.end),
            "total": _row_object(statistics.total),
            "clients": list(map(_row_object, statistics.clients)),
            "commands": list(map(_row_object, statistics.commands)),
            "places": list(map(_place_object, statistics.places)),
        }
    )


def _place_object(places: PlaceFigures) -> dict[str, object]:
    return {
        **conversation_object(places.conversation),
        "proxy": places.is_relayed,
        "delay_error_ms": places.delay_error,
        "requests": _one_way_object(places.requests),
        "replies": _one_way_object(places.replies),
    }


def _one_way_object(figures: OneWayFigures) -> dict[str, object]:
    delay = None if figures.delay is None else percentiles_object(figures.delay)
    return {"frames": figures.frames, "lost": figures.lost, "delay_ms": delay}


def _row_object(row: StatisticsRow) -> dict[str, object]:
    figures = row.figures
    return {
        **({} if row.conversation is None else conversation_object(row.conversation)),
        **({} if row.call_kind is None else call_kind_object(row.call_kind)),
        **{name: getattr(figures, attribute) for name, attribute in _FIGURES.items()},
        "latency_ms": None if figures.latency is None else percentiles_object(figures.latency),
        "refusals": [
            {"hresult": code, "name": hresult_name(code), "calls": n} for code, n in figures.refusal_codes
        ],
    }


def call_kind_object(call_kind: CallKind | None) -> dict[str, object]:
    if call_kind is None:
        return {"function": None, "command": None}
    return {"function": _function(call_kind), "command": text_fragment(call_kind.command)}


def _function(call_kind: CallKind) -> str:
    return "others" if call_kind is OTHER_KINDS else function_name(call_kind.function_id)


def statistics_header() -> str:
    """Return the CSV header. The column `row` contains `total`, `client` or `command`."""
    columns = ("start", "end", "row", "client", "server", "transport", "function", "command")
    return csv_row((*columns, *_FIGURES, *(f"latency_ms.{name}" for name in PERCENTILES)))


def statistics_rows(statistics: Statistics) -> Iterator[str]:
    """Yield the CSV rows of a period: the total, then each client, then each command of each client."""
    period = epoch_text(statistics.start), epoch_text(statistics.end)
    yield csv_row((*period, "total", *_csv_cells(statistics.total)))
    for row in statistics.clients:
        yield csv_row((*period, "client", *_csv_cells(row)))
    for row in statistics.commands:
        yield csv_row((*period, "command", *_csv_cells(row)))


def _csv_cells(row: StatisticsRow) -> Iterator[object]:
    conversation, kind, figures = row.conversation, row.call_kind, row.figures
    for name in ("client", "server", "transport"):
        yield "" if conversation is None else csv_cell(str(getattr(conversation, name)))
    yield from ("", "") if kind is None else (_function(kind), csv_cell(kind.command or ""))
    for attribute in _FIGURES.values():
        value = getattr(figures, attribute)
        yield "" if value is None else value
    latency = {} if figures.latency is None else percentiles_object(figures.latency)
    yield from (latency.get(name, "") for name in PERCENTILES)
