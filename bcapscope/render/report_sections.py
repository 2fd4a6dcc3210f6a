"""Text and tables of a report, for the template `report.html`."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Sequence
from typing import NamedTuple

from bcapscope.analysis.finding import Finding, Severity
from bcapscope.analysis.report_data import DamagedFrame, ReportData
from bcapscope.analysis.slave.notable_set_points import SetPointFact
from bcapscope.analysis.slave.slave_session import ExitReason, SlaveSession
from bcapscope.analysis.statistics.call_statistics import OTHER_KINDS, CallFigures, StatisticsRow
from bcapscope.messages import ENGLISH_WORDS, MessageFormatter
from bcapscope.messages.places import Count, Duration, Times
from bcapscope.protocol.tables.hresult import describe_hresult, hresult_name
from bcapscope.render import report_slave_sessions
from bcapscope.render.diagnosis_summary import severity_counts_text
from bcapscope.render.finding_text import finding_depths, finding_sentence, words_for
from bcapscope.render.report_figure import Picture
from bcapscope.render.slave_session_text import slave_session_lines
from bcapscope.render.statistics_text import call_kind_text
from bcapscope.render.timestamp import utc_text
from bcapscope.traffic.observation import Conversation

MAX_DRAWN = 6
"""Maximum number of slave-mode sessions with pictures: those with the most problems, then the longest."""

MAX_ROWS = 40
"""Maximum number of rows of a table."""

MAX_SLOW = 10
"""Maximum number of rows in the table of set points with the slowest replies."""

_FIGURE_COLUMNS = (
    *("calls", "per-s", "line-time", "median", "p99", "longest"),
    *("retried", "refused", "unanswered"),
)
_SIGNS = {Severity.ERROR: "✖", Severity.WARNING: "▲", Severity.NOTE: "●"}
_EXIT_TEXTS = {
    ExitReason.LEFT: "left normally, by slvChangeMode 0",
    ExitReason.CHANGED: "by slvChangeMode, which entered slave mode again",
    ExitReason.ERROR: "by an error in the reply to a set point",
    ExitReason.OTHER_CALL: "by an error of another call",
    ExitReason.OTHER_CLIENT: "by slvChangeMode of another client",
    ExitReason.FOUND_OFF: "found off; the capture does not show the reason",
    ExitReason.DISCONNECTED: "by the client's release or disconnection",
    ExitReason.SILENT: "the client sent no more set points, and did not leave slave mode",
    ExitReason.CAPTURE_ENDED: "the capture ended first",
}
_GOOD_EXITS = (ExitReason.LEFT, ExitReason.CAPTURE_ENDED, ExitReason.CHANGED)


class ReportTable(NamedTuple):
    """A table with one letter of `kinds` per column.

    The letter ``t`` means text, ``n`` number, ``c`` code, and ``e`` endpoints of a conversation (None: all).
    """

    caption: str
    header: Sequence[str]
    kinds: str
    rows: Sequence[Sequence[object]]


class OverallVerdict(NamedTuple):
    """The overall verdict at the top of the page.

    `kind` is ``error``, ``warning`` or ``good``. `sentence` describes the first root cause.
    """

    kind: str
    counts: str
    sentence: str = ""


class FindingView(NamedTuple):
    """A finding with its texts for the page. `depth` is the number of causes above the finding, at most 4."""

    number: int
    depth: int
    sign: str
    finding: Finding
    sentence: str
    advice: str
    severity: str


class SlaveSessionView(NamedTuple):
    """A slave-mode session with its pictures. `lines` is the output of `bcapscope slave` for the session."""

    number: int
    facts: Sequence[tuple[str, str | Conversation]]
    pictures: Sequence[Picture]
    slowest: ReportTable | None
    lines: Sequence[str]


def summary_tiles(report_data: ReportData, words: MessageFormatter) -> list[tuple[str, str]]:
    """Return the names and values of the main figures in the summary."""
    seen, statistics = report_data.totals, report_data.statistics
    tiles = [("frames", f"{seen.frames:,}"), ("calls", f"{seen.calls:,}"), ("clients", f"{seen.clients:,}")]
    tiles.append(("lasting", Duration(report_data.end - report_data.start).text(words)))
    if statistics is not None:
        total = statistics.total.figures
        tiles += [
            ("retried", f"{total.retried_calls:,}"),
            ("refused", f"{total.refused:,}"),
            ("unanswered", f"{total.unanswered:,}"),
        ]
    tiles.append(("sessions", f"{len(report_data.slave_sessions) + report_data.slave_sessions_left_off:,}"))
    tiles.append(("damaged", f"{report_data.damaged_count:,}"))
    return [(words(f"report.tile.{name}"), value) for name, value in tiles]


def period_text(report_data: ReportData, words: MessageFormatter) -> str:
    """Return the sentence that gives the start and the end of the captured traffic."""
    return words("report.period", start=_moment(report_data.start), end=_moment(report_data.end))


def overall_verdict(report_data: ReportData, words: MessageFormatter) -> OverallVerdict:
    """Return the overall verdict: the number of findings of each severity, and the first finding."""
    counts = Counter(finding.severity for finding in report_data.findings)
    listed = severity_counts_text(counts, words)
    if counts[Severity.ERROR] or counts[Severity.WARNING]:
        kind = "error" if counts[Severity.ERROR] else "warning"
        sentence = finding_sentence(report_data.findings[0], words_for(words, report_data.totals))
        return OverallVerdict(kind, words("report.counts", counts=listed), sentence)
    if not listed:
        return OverallVerdict("good", words("report.no-problem"))
    return OverallVerdict("good", words("report.no-problem.notes", counts=listed))


def finding_views(report_data: ReportData, words: MessageFormatter) -> list[FindingView]:
    """Return all findings, each consequence after its cause."""
    depths = finding_depths(report_data.findings)
    words = words_for(words, report_data.totals)
    return [
        FindingView(
            number,
            depth,
            _SIGNS[finding.severity],
            finding,
            finding_sentence(finding, words),
            words.text(finding.advice),
            words(f"severity.{finding.severity}"),
        )
        for number, (finding, depth) in enumerate(zip(report_data.findings, depths, strict=True), 1)
    ]


def session_views(report_data: ReportData) -> list[SlaveSessionView]:
    """Return the slave-mode sessions that have pictures."""
    start = report_data.start
    return [
        SlaveSessionView(
            session.number,
            list(_slave_session_facts(session, start)),
            [
                picture
                for picture in (
                    report_slave_sessions.pace_picture(session, start),
                    report_slave_sessions.spread_picture(session),
                    report_slave_sessions.motion_picture(session, start),
                )
                if picture is not None
            ],
            _slowest_table(session, start) if session.timing.slowest else None,
            list(slave_session_lines(session)),
        )
        for session in drawn_slave_sessions(report_data.slave_sessions)
    ]


def call_tables(report_data: ReportData, words: MessageFormatter) -> Iterator[ReportTable]:
    """Yield three tables about calls: figures by client, figures by command, and refused calls."""
    statistics = report_data.statistics
    if statistics is None:
        return
    yield _figures_table(
        "client",
        "e",
        [(row.conversation, row.figures) for row in statistics.clients],
        words,
    )
    yield _figures_table(
        "command",
        "t",
        [(call_kind_text(row.call_kind or OTHER_KINDS, words), row.figures) for row in statistics.kinds],
        words,
    )
    yield from _refusals(statistics.kinds, words)


def verdict_table(report_data: ReportData, words: MessageFormatter) -> ReportTable:
    """Return the table with the number of calls for each verdict that reports a problem."""
    return ReportTable(
        words("report.verdicts"),
        _header(("what", "calls", "meaning"), words),
        "tnt",
        [
            (words(f"call.verdict.{name}"), f"{count:,}", words(f"report.verdict.{name}"))
            for verdict, count in report_data.verdicts.items()
            for name in [verdict.replace(" ", "-")]
        ],
    )


def damage_table(report_data: ReportData, words: MessageFormatter) -> ReportTable:
    """Return the table of the first damaged frames."""
    found = report_data.damaged_frames
    caption = words("report.damage")
    if report_data.damaged_count > len(found):
        caption = words("report.damage.first", shown=len(found), total=report_data.damaged_count)
    return ReportTable(
        caption,
        _header(("frame", "at", "from", "bytes", "begins-with", "problem"), words),
        "nntnct",
        [_damaged_row(each, report_data.start, words) for each in found],
    )


def _header(columns: Sequence[str], words: MessageFormatter) -> list[str]:
    return [words(f"report.column.{name}") for name in columns]


def drawn_slave_sessions(slave_sessions: Sequence[SlaveSession]) -> list[SlaveSession]:
    """Return the slave-mode sessions that get pictures, in the order in which they began."""
    worst = sorted(slave_sessions, key=lambda session: (-_trouble_rank(session), -session.counts.sent))
    return sorted(worst[:MAX_DRAWN], key=lambda session: session.number)


def _trouble_rank(slave_session: SlaveSession) -> int:
    if not slave_session.counts.sent:
        return -1
    bad = slave_session.exit.reason not in _GOOD_EXITS
    return 2 * bad + bool(
        slave_session.timing.gaps or slave_session.counts.refused or slave_session.counts.unanswered
    )


def slave_session_table(report_data: ReportData) -> ReportTable:
    """Return the table of the first slave-mode sessions."""
    rows = [
        (
            session.number,
            _seconds_since(session.entered_at, report_data.start),
            f"{session.duration_ms / 1e3:.3f}",
            _mode_number(session),
            session.conversation,
            f"{session.counts.sent:,}",
            f"{session.counts.retries:,}",
            _exit(session),
        )
        for session in report_data.slave_sessions[:MAX_ROWS]
    ]
    all_of_them = len(report_data.slave_sessions) + report_data.slave_sessions_left_off
    words = "Slave-mode sessions."
    if all_of_them > len(rows):
        words = f"The first {len(rows)} of {all_of_them} slave-mode sessions."
    if len(report_data.slave_sessions) > MAX_DRAWN:
        words += f" Pictures of the {MAX_DRAWN} with the most problems follow."
    header = ("session", "at, s", "lasted, s", "mode", "client", "set points", "retries", "ended")
    return ReportTable(words, header, "nnntennt", rows)


def _mode_number(slave_session: SlaveSession) -> str:
    mode = slave_session.mode
    return _mode(slave_session) if mode.value is None else f"0x{mode.value:03X}, {mode.pose_type} type"


def _mode(slave_session: SlaveSession) -> str:
    mode = slave_session.mode
    if mode.value is None:
        return f"not captured; values look like {mode.pose_type} type" if mode.pose_type else "not captured"
    text = "" if mode.meaning is None else f": {mode.meaning.text}"
    return f"0x{mode.value:03X}{text}" + (" (as on an RC8)" if mode.guessed else "")


def _exit(slave_session: SlaveSession) -> str:
    code = slave_session.exit.hresult
    meaning = "" if not code else f": {hresult_name(code)}, {describe_hresult(code).text}"
    return f"{_EXIT_TEXTS[slave_session.exit.reason]}{meaning}"


def _slave_session_facts(slave_session: SlaveSession, start: int) -> Iterator[tuple[str, str | Conversation]]:
    counts, timing, buffer = slave_session.counts, slave_session.timing, slave_session.buffer
    how = (
        "before the capture began"
        if slave_session.entry_call is None
        else f"by call {slave_session.entry_call.call}"
    )
    yield "Entered", (f"at {_seconds_since(slave_session.entered_at, start)} s, {how}")
    yield (
        "Ended",
        (f"at {_seconds_since(slave_session.exit.time, start)} s, {_exit(slave_session)}"),
    )
    yield "Client", slave_session.conversation
    yield "Mode", (_mode(slave_session))
    if slave_session.mode.generation_known_by:
        yield (
            "Controller",
            (f"{slave_session.mode.generation}: {slave_session.mode.generation_known_by}"),
        )
    refused = sum(counts.refused.values())
    yield (
        "Set points",
        (
            f"{counts.sent:,} sent, {counts.accepted:,} accepted, {refused:,} refused, "
            f"{counts.unanswered:,} never answered, {counts.open:,} open when the capture ended, "
            f"{counts.not_followed:,} not followed to the end, {counts.not_captured:,} with a reply that was "
            f"not captured, {counts.after_end:,} after the session ended"
        ),
    )
    yield "Sent again", (Times(counts.retries).text(ENGLISH_WORDS) if counts.retries else "never")
    yield "Cycle", (report_slave_sessions.percentiles_text(timing.cycle))
    yield (
        "On the grid",
        (f"{timing.on_grid:,} cycles of {timing.grid_ms:g} ms; {timing.grid_known_by}"),
    )
    yield "Reply after", (report_slave_sessions.percentiles_text(timing.latency))
    yield (
        "Gaps",
        (f"{timing.gaps or 'none'} longer than the {timing.slack_ms:g} ms that a full buffer lasts"),
    )
    often = Times(buffer.underflows).text(ENGLISH_WORDS)
    empty = f"{often} by the model, {buffer.underflows_in_motion:,} of them in motion"
    yield "Buffer ran empty", (empty if buffer.underflows else "never, by the model")
    if buffer.assumptions:
        yield "The model assumes", ("; ".join(map(str, buffer.assumptions)))


def _slowest_table(slave_session: SlaveSession, start: int) -> ReportTable:
    return ReportTable(
        f"Set points of session {slave_session.number} with the slowest replies.",
        ("call", "frame", "at, s", "cycle, ms", "reply after, ms", "result"),
        "nnnnnt",
        [_slow_row(fact, start) for fact in slave_session.timing.slowest[:MAX_SLOW]],
    )


def _slow_row(fact: SetPointFact, start: int) -> list[object]:
    return [
        fact.call,
        fact.request_frame,
        _seconds_since(fact.time, start),
        "" if fact.cycle_ms is None else f"{fact.cycle_ms:.3f}",
        "never" if fact.latency_ms is None else f"{fact.latency_ms:.3f}",
        "" if fact.hresult is None else hresult_name(fact.hresult),
    ]


def _figures_table(
    subject: str, kind: str, rows: Sequence[tuple[object, CallFigures]], words: MessageFormatter
) -> ReportTable:
    """Return a table of figures, one row per client or command. `kind` is the kind of the first column."""
    header = _header((subject, *_FIGURE_COLUMNS), words)
    caption = words(f"report.calls-by-{subject}")
    if len(rows) > MAX_ROWS:
        caption = words("report.first-rows", caption=caption, shown=MAX_ROWS, total=len(rows))
    cells = [(name, *_figures(figures)) for name, figures in rows[:MAX_ROWS]]
    return ReportTable(caption, header, kind + "n" * len(_FIGURE_COLUMNS), cells)


def _figures(figures: CallFigures) -> Iterator[str]:
    latency = figures.latency
    yield f"{figures.calls:,}"
    yield "" if figures.calls_per_second is None else f"{figures.calls_per_second:,.1f}"
    yield "" if figures.line_time_share is None else f"{figures.line_time_share:.1%}"
    yield from (
        ("", "", "")
        if latency is None
        else (f"{value:,.3f}" for value in (latency.p50, latency.p99, latency.most))
    )
    yield from (
        f"{count:,}" if count else ""
        for count in (figures.retried_calls, figures.refused, figures.unanswered)
    )


def _refusals(rows: Sequence[StatisticsRow], words: MessageFormatter) -> Iterator[ReportTable]:
    refused = [
        (
            f"{count:,}",
            hresult_name(code),
            call_kind_text(row.call_kind or OTHER_KINDS, words),
            words.text(found.meaning),
            "" if found.advice is None else words.text(found.advice),
        )
        for row in rows
        for code, count in row.figures.refusal_codes
        for found in [describe_hresult(code)]
    ]
    if refused:
        header = _header(("times", "result", "call", "meaning", "advice"), words)
        yield ReportTable(words("report.refusals"), header, "ncttt", refused[:MAX_ROWS])


def _damaged_row(each: DamagedFrame, start: int, words: MessageFormatter) -> list[object]:
    reasons = [words.text(problem.reason) for problem in each.problems]
    if each.missing_bytes:
        reasons.insert(0, words("report.missing", bytes=Count(each.missing_bytes, "byte")))
    return [
        each.frame,
        _seconds_since(each.time, start),
        each.flow.src_text,
        each.length,
        each.raw.hex(" "),
        words("list.semicolon").join(reasons),
    ]


def _moment(time: int) -> str:
    """Return a time as text with milliseconds; readers do not need the other digits."""
    return utc_text(time)[:-7].replace("T", " ") + " UTC" if utc_text(time).endswith("Z") else utc_text(time)


def _seconds_since(time: int, start: int) -> str:
    return f"{(time - start) / 1e9:.3f}"
