"""The sections of a report, as HTML around pictures."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from bcapscope.analysis.finding import Finding, Severity
from bcapscope.analysis.report_data import DamagedFrame, ReportData
from bcapscope.analysis.slave.notable_set_points import SetPointFact
from bcapscope.analysis.slave.slave_session import ExitReason, SlaveSession
from bcapscope.analysis.speech import span, times
from bcapscope.analysis.statistics.call_statistics import OTHER_KINDS, CallFigures, StatisticsRow
from bcapscope.messages import ENGLISH_WORDS, MessageFormatter
from bcapscope.protocol.tables.hresult import describe_hresult, hresult_name
from bcapscope.protocol.text_format import counted
from bcapscope.render import report_calls, report_slave_sessions
from bcapscope.render.finding_text import finding_sentence, words_for
from bcapscope.render.report_figure import Picture
from bcapscope.render.report_html import (
    Html,
    definition_list,
    element,
    escape_html,
    html_table,
    join_html,
    paragraph,
)
from bcapscope.render.slave_session_text import slave_session_lines
from bcapscope.render.statistics_text import call_kind_text
from bcapscope.render.timestamp import utc_text
from bcapscope.traffic.call_verdict import CallVerdict
from bcapscope.traffic.observation import Conversation

MAX_DRAWN = 6
"""Stays in slave mode with pictures: those with most trouble, then the longest."""

MAX_ROWS = 40
"""Rows of a table."""

MAX_SLOW = 10
"""Set points in the table of the slowest."""

_DEEPEST = 4
_SIGNS = {Severity.ERROR: "✖", Severity.WARNING: "▲", Severity.NOTE: "●"}
_EXIT_TEXTS = {
    ExitReason.LEFT: "left by slvChangeMode 0, as it should be",
    ExitReason.CHANGED: "by slvChangeMode to a mode again",
    ExitReason.ERROR: "by an error in the reply to a set point",
    ExitReason.OTHER_CALL: "by an error of another call",
    ExitReason.OTHER_CLIENT: "by slvChangeMode of another client",
    ExitReason.FOUND_OFF: "found switched off, without a reason that was seen",
    ExitReason.DISCONNECTED: "by the client's release or disconnection",
    ExitReason.SILENT: "the client sent no more set points, and did not leave slave mode",
    ExitReason.CAPTURE_ENDED: "the capture ended first",
}
_VERDICT_TEXTS = {
    CallVerdict.UNANSWERED: "no reply to any try was seen, and the client went on",
    CallVerdict.CAPTURE_ENDED: "no reply was seen before the capture ended",
    CallVerdict.NOT_FOLLOWED: "more was open than is kept, so that nobody looked for its reply any more",
    CallVerdict.EXECUTED_TWICE: "the controller did it more than once: replies differ, or handles "
    "are missing",
    CallVerdict.REPLY_LATE: "a reply came after the client had asked again or gone on, and was discarded",
    CallVerdict.REPLY_LOST: "a reply was seen here, and the client asked again all the same",
    CallVerdict.REQUEST_LOST: "the controller was at work on a later try and on none before",
    CallVerdict.CANNOT_TELL: "asked again, and nothing seen here tells whether requests or replies were lost",
}
_GOOD_EXITS = (ExitReason.LEFT, ExitReason.CAPTURE_ENDED, ExitReason.CHANGED)


def summary_section(report_data: ReportData) -> Html:
    """Tell what, when, who and how much, and the first cause."""
    seen, statistics = report_data.totals, report_data.statistics
    tiles = [("frames", f"{seen.frames:,}"), ("calls", f"{seen.calls:,}"), ("clients", f"{seen.clients:,}")]
    tiles.append(("lasting", span(report_data.end - report_data.start)))
    if statistics is not None:
        total = statistics.total.figures
        tiles += [
            ("calls sent again", f"{total.retried_calls:,}"),
            ("refused", f"{total.refused:,}"),
            ("never answered", f"{total.unanswered:,}"),
        ]
    tiles.append(
        ("stays in slave mode", f"{len(report_data.slave_sessions) + report_data.slave_sessions_left_off:,}")
    )
    tiles.append(("damaged frames", f"{report_data.damaged_count:,}"))
    period = f"From {_moment(report_data.start)} to {_moment(report_data.end)}."
    shown = element(
        "div", definition_list((name, escape_html(value)) for name, value in tiles), class_="tiles"
    )
    return join_html((_verdict(report_data), paragraph(period, "soft"), shown))


def findings_section(report_data: ReportData) -> Html:
    """List all findings, each consequence under its cause."""
    if not report_data.findings:
        return paragraph("No rule found anything.")
    depths: list[int] = []
    items = []
    words = words_for(ENGLISH_WORDS, report_data.totals)
    for number, finding in enumerate(report_data.findings, 1):
        cause = finding.consequence_of
        depths.append(0 if cause is None else depths[cause - 1] + 1)
        items.append(_finding(number, finding, min(depths[-1], _DEEPEST), words))
    intro = paragraph(
        "The first cause stands first; what follows from it stands under it. Times count from the first "
        "frame, frames are numbered as bcapscope decode numbers them.",
        "soft",
    )
    return join_html((intro, element("ol", join_html(items), class_="findings")))


def slave_mode_section(report_data: ReportData) -> Iterator[Html | Picture]:
    """Tell and draw the stays in slave mode."""
    yield _slave_session_table(report_data)
    for stay in drawn_slave_sessions(report_data.slave_sessions):
        yield element("h3", escape_html(f"Stay {stay.number}"), id=f"stay-{stay.number}")
        yield element("div", definition_list(_slave_session_facts(stay, report_data.start)), class_="facts")
        pictures = (
            report_slave_sessions.pace_picture(stay, report_data.start),
            report_slave_sessions.spread_picture(stay),
            report_slave_sessions.motion_picture(stay, report_data.start),
        )
        yield from (each for each in pictures if each is not None)
        if stay.timing.slowest:
            yield _slowest_table(stay, report_data.start)
        yield _full_text(stay)


def calls_section(report_data: ReportData) -> Iterator[Html | Picture]:
    """Tell and draw how long calls took."""
    statistics = report_data.statistics
    if statistics is None:
        return
    drawn = report_calls.latency_picture(statistics.kinds)
    if drawn is not None:
        yield drawn
    yield _figures_table(
        "Calls by client.", "client", [(_client_cell(row), row.figures) for row in statistics.clients]
    )
    kinds = [
        (escape_html(call_kind_text(row.call_kind or OTHER_KINDS)), row.figures) for row in statistics.kinds
    ]
    yield _figures_table("Calls by command, all clients together.", "command", kinds)
    yield from _refusals(statistics.kinds)


def retries_section(report_data: ReportData) -> Iterator[Html | Picture]:
    """Tell and draw what was sent again."""
    if report_data.verdicts:
        rows = [
            [
                escape_html(verdict.value),
                escape_html(f"{count:,}"),
                escape_html(_VERDICT_TEXTS.get(verdict, "")),
            ]
            for verdict, count in report_data.verdicts.items()
        ]
        yield html_table(
            "Calls that were not just answered or refused, by what they suffered as far as this capture "
            "tells.",
            ("what", "calls", "meaning"),
            rows,
            "<><",
        )
    drawn = report_calls.retry_chain_picture(report_data)
    if drawn is not None:
        yield drawn
    if report_data.stray_replies:
        yield paragraph(f"{counted(report_data.stray_replies, 'reply', 'replies')} to no call that was open.")


def damage_section(report_data: ReportData) -> Iterator[Html]:
    """List the first damaged frames."""
    found = report_data.damaged_frames
    rest = report_data.damaged_count - len(found)
    rows = [_damaged_row(each, report_data.start) for each in found]
    yield html_table(
        "Frames that are not as b-CAP has them, and holes in the capture"
        + (f"; the first {len(found)} of {report_data.damaged_count}." if rest else "."),
        ("frame", "at, s", "from", "bytes", "begins with", "what is wrong"),
        rows,
        ">><><<",
    )


def drawn_slave_sessions(slave_sessions: Sequence[SlaveSession]) -> list[SlaveSession]:
    """Choose the stays that get pictures, in the order in which they began."""
    worst = sorted(slave_sessions, key=lambda stay: (-_trouble_rank(stay), -stay.counts.sent))
    return sorted(worst[:MAX_DRAWN], key=lambda stay: stay.number)


def _trouble_rank(slave_session: SlaveSession) -> int:
    if not slave_session.counts.sent:
        return -1
    bad = slave_session.exit.reason not in _GOOD_EXITS
    return 2 * bad + bool(
        slave_session.timing.gaps or slave_session.counts.refused or slave_session.counts.unanswered
    )


def _verdict(report_data: ReportData) -> Html:
    counts = {severity: 0 for severity in Severity}
    for finding in report_data.findings:
        counts[finding.severity] += 1
    told = ", ".join(counted(count, severity.value) for severity, count in counts.items() if count)
    if counts[Severity.ERROR] or counts[Severity.WARNING]:
        words = words_for(ENGLISH_WORDS, report_data.totals)
        sentence = escape_html(finding_sentence(report_data.findings[0], words))
        kind = "error" if counts[Severity.ERROR] else "warning"
        sentences = Html(f"{element('strong', escape_html(told + '.'))} {sentence}")
        return element("div", sentences, class_=f"verdict {kind}")
    healthy = "No problem found" + (f"; {told}." if told else ".")
    return element("div", element("strong", escape_html(healthy)), class_="verdict good")


def _finding(number: int, finding: Finding, depth: int, words: MessageFormatter) -> Html:
    severity = finding.severity
    badge = element(
        "span", escape_html(f"{_SIGNS[severity]} {severity.value}"), class_=f"badge {severity.value}"
    )
    head = Html(f"{number} {badge} {element('code', escape_html(finding.rule))}")
    if finding.consequence_of is not None:
        link = element("a", escape_html(finding.consequence_of), href=f"#finding-{finding.consequence_of}")
        head = Html(f"{head}, follows from {link}")
    frames = " ".join(map(str, finding.frames))
    parts = [element("p", head), paragraph(finding_sentence(finding, words), "sentence")]
    advice = escape_html(words.text(finding.advice))
    parts.append(element("p", Html(f"{element('b', Html('What to do:'))} {advice}")))
    if frames:
        parts.append(paragraph(f"{'Frame' if len(finding.frames) == 1 else 'Frames'} {frames}", "soft"))
    if finding.source:
        parts.append(paragraph(f"Source: {finding.source}", "source"))
    return element(
        "li", join_html(parts), class_=f"finding {severity.value} depth-{depth}", id=f"finding-{number}"
    )


def _slave_session_table(report_data: ReportData) -> Html:
    rows = [
        [
            escape_html(stay.number),
            escape_html(_seconds_since(stay.entered_at, report_data.start)),
            escape_html(f"{stay.duration_ms / 1e3:.3f}"),
            escape_html(_mode_number(stay)),
            _endpoints_cell(stay.conversation),
            escape_html(f"{stay.counts.sent:,}"),
            escape_html(f"{stay.counts.retries:,}"),
            escape_html(_exit(stay)),
        ]
        for stay in report_data.slave_sessions[:MAX_ROWS]
    ]
    all_of_them = len(report_data.slave_sessions) + report_data.slave_sessions_left_off
    words = "Stays in slave mode."
    if all_of_them > len(rows):
        words = f"The first {len(rows)} of {all_of_them} stays in slave mode."
    if len(report_data.slave_sessions) > MAX_DRAWN:
        words += f" Pictures follow of the {MAX_DRAWN} with most trouble."
    header = ("stay", "at, s", "lasted, s", "mode", "client", "set points", "retries", "ended")
    return html_table(words, header, rows, ">>><<>><")


def _mode_number(slave_session: SlaveSession) -> str:
    mode = slave_session.mode
    return _mode(slave_session) if mode.value is None else f"0x{mode.value:03X}, {mode.pose_type} type"


def _mode(slave_session: SlaveSession) -> str:
    mode = slave_session.mode
    if mode.value is None:
        return f"not seen; {mode.pose_type} type by its numbers" if mode.pose_type else "not seen"
    text = "" if mode.meaning is None else f": {mode.meaning.text}"
    return f"0x{mode.value:03X}{text}" + (" (as on an RC8)" if mode.guessed else "")


def _exit(slave_session: SlaveSession) -> str:
    code = slave_session.exit.hresult
    told = "" if not code else f": {hresult_name(code)}, {describe_hresult(code).text}"
    return f"{_EXIT_TEXTS[slave_session.exit.reason]}{told}"


def _slave_session_facts(slave_session: SlaveSession, start: int) -> Iterator[tuple[str, Html]]:
    counts, timing, buffer = slave_session.counts, slave_session.timing, slave_session.buffer
    how = (
        "before the capture began"
        if slave_session.entry_call is None
        else f"by call {slave_session.entry_call.call}"
    )
    yield "Entered", escape_html(f"at {_seconds_since(slave_session.entered_at, start)} s, {how}")
    yield (
        "Ended",
        escape_html(f"at {_seconds_since(slave_session.exit.time, start)} s, {_exit(slave_session)}"),
    )
    yield "Client", _endpoints_cell(slave_session.conversation)
    yield "Mode", escape_html(_mode(slave_session))
    if slave_session.mode.generation_known_by:
        yield (
            "Controller",
            escape_html(f"{slave_session.mode.generation}: {slave_session.mode.generation_known_by}"),
        )
    refused = sum(counts.refused.values())
    yield (
        "Set points",
        escape_html(
            f"{counts.sent:,} sent, {counts.accepted:,} accepted, {refused:,} refused, "
            f"{counts.unanswered:,} never answered, {counts.open:,} open when the capture ended, "
            f"{counts.not_followed:,} not followed to the end, {counts.after_end:,} more after the end"
        ),
    )
    yield "Sent again", escape_html(times(counts.retries) if counts.retries else "never")
    yield "Cycle", escape_html(report_slave_sessions.percentiles_text(timing.cycle))
    yield (
        "On the grid",
        escape_html(f"{timing.on_grid:,} cycles of {timing.grid_ms:g} ms; {timing.grid_known_by}"),
    )
    yield "Reply after", escape_html(report_slave_sessions.percentiles_text(timing.latency))
    yield (
        "Gaps",
        escape_html(
            f"{timing.gaps or 'none'} longer than the {timing.slack_ms:g} ms that a full buffer lasts"
        ),
    )
    empty = f"{times(buffer.underflows)} by the model, {buffer.underflows_in_motion:,} of them in motion"
    yield "Buffer ran empty", escape_html(empty if buffer.underflows else "never, by the model")
    if buffer.assumptions:
        yield "The model assumes", escape_html("; ".join(map(str, buffer.assumptions)))


def _slowest_table(slave_session: SlaveSession, start: int) -> Html:
    rows = [_slow_row(fact, start) for fact in slave_session.timing.slowest[:MAX_SLOW]]
    header = ("call", "frame", "at, s", "cycle, ms", "reply after, ms", "result")
    return html_table(
        f"Set points of stay {slave_session.number} with the slowest replies.", header, rows, ">>>>><"
    )


def _full_text(slave_session: SlaveSession) -> Html:
    """Say all that `slave` says of a stay, for those who want it."""
    title = element("summary", escape_html(f"Stay {slave_session.number} as bcapscope slave tells it"))
    lines = join_html(Html(f"{escape_html(line)}\n") for line in slave_session_lines(slave_session))
    return element("details", join_html((title, element("pre", lines, tabindex="0"))))


def _slow_row(fact: SetPointFact, start: int) -> list[Html]:
    return [
        escape_html(fact.call),
        escape_html(fact.request_frame),
        escape_html(_seconds_since(fact.time, start)),
        escape_html("" if fact.cycle_ms is None else f"{fact.cycle_ms:.3f}"),
        escape_html("never" if fact.latency_ms is None else f"{fact.latency_ms:.3f}"),
        escape_html("" if fact.hresult is None else hresult_name(fact.hresult)),
    ]


def _figures_table(caption: str, first: str, rows: Sequence[tuple[Html, CallFigures]]) -> Html:
    header = (
        *(first, "calls", "per s", "line time", "median ms", "99% ms", "longest ms"),
        *("sent again", "refused", "never answered"),
    )
    if len(rows) > MAX_ROWS:
        caption += f" The first {MAX_ROWS} of {len(rows)}."
    cells = [[name, *map(escape_html, _figures(figures))] for name, figures in rows[:MAX_ROWS]]
    return html_table(caption, header, cells, "<" + ">" * (len(header) - 1))


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


def _refusals(rows: Sequence[StatisticsRow]) -> Iterator[Html]:
    refused = [
        [
            escape_html(f"{count:,}"),
            element("code", escape_html(hresult_name(code))),
            escape_html(call_kind_text(row.call_kind or OTHER_KINDS)),
            escape_html(describe_hresult(code).text),
            escape_html(describe_hresult(code).advice or ""),
        ]
        for row in rows
        for code, count in row.figures.refusal_codes
    ]
    if refused:
        header = ("times", "result", "of", "meaning", "what to do")
        yield html_table("What the controller refused, and why.", header, refused[:MAX_ROWS], "><<<<")


def _damaged_row(each: DamagedFrame, start: int) -> list[Html]:
    reasons = "; ".join(problem.reason for problem in each.problems)
    missing = f"{counted(each.missing_bytes, 'byte')} missing in the capture" if each.missing_bytes else ""
    return [
        escape_html(each.frame),
        escape_html(_seconds_since(each.time, start)),
        escape_html(each.flow.src_text),
        escape_html(each.length),
        element("code", escape_html(each.raw.hex(" "))),
        escape_html("; ".join(filter(None, (missing, reasons)))),
    ]


def _client_cell(row: StatisticsRow) -> Html:
    return escape_html("all") if row.conversation is None else _endpoints_cell(row.conversation)


def _endpoints_cell(conversation: Conversation) -> Html:
    return join_html(
        (
            element("span", escape_html(conversation.client), class_="ends"),
            escape_html(" → "),
            element(
                "span", escape_html(f"{conversation.server} {conversation.transport.upper()}"), class_="ends"
            ),
        )
    )


def _moment(time: int) -> str:
    """Write a moment to the millisecond; captures have more digits than a reader needs."""
    return utc_text(time)[:-7].replace("T", " ") + " UTC" if utc_text(time).endswith("Z") else utc_text(time)


def _seconds_since(time: int, start: int) -> str:
    return f"{(time - start) / 1e9:.3f}"
