"""Figures of calls, for people and for programs."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import orjson

from bcapscope.analysis.distribution import Distribution
from bcapscope.analysis.statistics import ELSEWHERE, OTHERS, Figures, Row, Statistics
from bcapscope.protocol.functions import function_name
from bcapscope.protocol.hresult import hresult_name
from bcapscope.protocol.wording import counted
from bcapscope.render.columns import columns
from bcapscope.render.escape import printable
from bcapscope.render.moment import epoch_text, utc_text
from bcapscope.render.palette import PLAIN, Palette
from bcapscope.render.record import json_text
from bcapscope.render.tongue import Tongue, english
from bcapscope.traffic.question import Question

MOST_ROWS = 40
"""Rows of a table for people, those that took most time; JSON has all."""

_LONGEST_NAME = 40
_HEADER = (
    *("calls", "per s", "line time", "p50 ms", "p90 ms", "p99 ms", "p99.9 ms", "max ms"),
    *("retries", "late", "refused", "unanswered"),
)


def question_text(question: Question) -> str:
    """Name what was asked: function, and command where there is one."""
    if question is OTHERS:
        return "(others)"
    name = function_name(question.function_id)
    if question.command is None:
        return name
    command = printable(question.command)
    return f"{name} {command if len(command) <= _LONGEST_NAME else command[: _LONGEST_NAME - 1] + '…'}"


def statistics_lines(
    statistics: Statistics, palette: Palette = PLAIN, tongue: Tongue = english
) -> Iterator[str]:
    """Write the figures of a time: in all, by client, by client and command."""
    seconds = (statistics.end - statistics.start) / 1e9
    yield f"{palette.name}{utc_text(statistics.start)}, {seconds:.3f} s{palette.reset}"
    yield ""
    rows = [(_client_text(row, tongue), row.figures) for row in statistics.clients]
    if len(rows) > 1:
        rows.insert(0, (_client_text(statistics.total, tongue), statistics.total.figures))
    yield from _table(tongue("client"), rows, palette, tongue)
    for client in statistics.clients[:MOST_ROWS]:
        own = [row for row in statistics.commands if row.conversation is client.conversation]
        yield ""
        caption = tongue(f"by {_client_text(client, english)}")
        questions = [(_question(row, tongue), row.figures) for row in own]
        yield from _table(caption, questions, palette, tongue)
    yield from _refusals(statistics, palette, tongue)
    let_go = statistics.total.figures.not_followed
    if let_go:
        yield ""
        text = f"not followed to the end, as too many were open: {counted(let_go, 'call')}"
        yield f"{palette.dim}{tongue(text)}{palette.reset}"


def _question(row: Row, tongue: Tongue) -> str:
    text = question_text(row.question or OTHERS)
    return tongue(text) if row.question in (None, OTHERS) else text


def _client_text(row: Row, tongue: Tongue) -> str:
    conversation = row.conversation
    if conversation is None:
        return tongue("all clients")
    if conversation is ELSEWHERE:
        return tongue("(other clients)")
    return printable(f"{conversation.client} > {conversation.server} {conversation.transport}")


def _table(
    caption: str, rows: Sequence[tuple[str, Figures]], palette: Palette, tongue: Tongue
) -> Iterator[str]:
    cells = [
        (caption, *map(tongue, _HEADER)),
        *((name, *_cells(figures)) for name, figures in rows[:MOST_ROWS]),
    ]
    first, *others = columns(cells, "<" + ">" * len(_HEADER))
    yield f"{palette.dim}{first}{palette.reset}"
    yield from others
    if len(rows) > MOST_ROWS:
        yield tongue(f"… and {len(rows) - MOST_ROWS} more")


def _cells(figures: Figures) -> tuple[str, ...]:
    latency = figures.latency
    times = ("", "", "", "", "") if latency is None else tuple(f"{value:.3f}" for value in _points(latency))
    return (
        str(figures.calls),
        "" if figures.rate is None else f"{figures.rate:.1f}",
        "" if figures.share is None else f"{figures.share:.1%}",
        *times,
        *(str(count or "") for count in (figures.retries, figures.late, figures.refused, figures.unanswered)),
    )


def _points(latency: Distribution) -> tuple[float, ...]:
    return latency.p50, latency.p90, latency.p99, latency.p999, latency.most


def _refusals(statistics: Statistics, palette: Palette, tongue: Tongue) -> Iterator[str]:
    rows = [(_question(row, tongue), row.figures.codes) for row in statistics.kinds]
    refused = [(str(count), hresult_name(code), name) for name, codes in rows for code, count in codes]
    if refused:
        yield ""
        yield f"{palette.dim}{tongue('refusals')}{palette.reset}"
        yield from columns(refused, "><<")


def statistics_record(statistics: Statistics) -> bytes:
    """Write the figures of a time as one JSON object, without a line end.

    Times are in milliseconds, `start` and `end` in seconds since 1970, `share` is of 1.
    """
    head = b'{"start":%b,"end":%b,"total":%b,"clients":[%b],"commands":[%b]}'
    return head % (
        epoch_text(statistics.start).encode("ascii"),
        epoch_text(statistics.end).encode("ascii"),
        _record(statistics.total),
        b",".join(map(_record, statistics.clients)),
        b",".join(map(_record, statistics.commands)),
    )


def _record(row: Row) -> bytes:
    parts = []
    if row.conversation is not None:
        ends = (row.conversation.client, row.conversation.server, row.conversation.transport)
        names = (b"client", b"server", b"transport")
        parts += [b'"%b":%b' % (name, json_text(str(end))) for name, end in zip(names, ends, strict=True)]
    if row.question is not None:
        others = row.question is OTHERS
        parts.append(
            b'"function":%b' % json_text("others" if others else function_name(row.question.function_id))
        )
        parts.append(b'"command":%b' % json_text(row.question.command))
    parts.append(orjson.dumps(figures_object(row.figures))[1:-1])
    return b"{" + b",".join(parts) + b"}"


def figures_object(figures: Figures) -> dict[str, object]:
    """Say figures as JSON has them."""
    latency = figures.latency
    return {
        "calls": figures.calls,
        "answered": figures.answered,
        "refused": figures.refused,
        "unanswered": figures.unanswered,
        "capture_ended": figures.open,
        "not_followed": figures.not_followed,
        "retries": figures.retries,
        "retried_calls": figures.retried,
        "late_replies": figures.late,
        "executing": figures.executing,
        "request_bytes": figures.request_bytes,
        "calls_per_s": figures.rate,
        "line_time_share": figures.share,
        "latency_ms": None if latency is None else latency_object(latency),
        "refusals": [{"hresult": code, "name": hresult_name(code), "calls": n} for code, n in figures.codes],
    }


def latency_object(latency: Distribution) -> dict[str, float]:
    """Say a distribution as JSON has it."""
    return {
        "mean": latency.mean,
        "min": latency.least,
        "p50": latency.p50,
        "p90": latency.p90,
        "p99": latency.p99,
        "p99.9": latency.p999,
        "max": latency.most,
    }
