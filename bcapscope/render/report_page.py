"""A report as one HTML page that needs no other files and no network.

Text from the wire is escaped. Even if the escaping failed, the page's content security policy would allow
only the page's own two scripts, and no network access.
"""

from __future__ import annotations

import base64
import hashlib
from collections import Counter
from collections.abc import Sequence
from functools import cache
from importlib import resources

from jinja2 import Environment, PackageLoader, StrictUndefined
from markupsafe import Markup
from plotly.offline import get_plotlyjs

from bcapscope.analysis.finding import Severity
from bcapscope.analysis.report_data import DamagedFrame, ReportData
from bcapscope.analysis.slave.slave_session import SlaveSession
from bcapscope.analysis.statistics.call_statistics import OTHER_KINDS
from bcapscope.messages import ENGLISH_WORDS, MessageFormatter
from bcapscope.messages.places import Count, Duration, frames_text
from bcapscope.protocol.tables.hresult import describe_hresult, hresult_name
from bcapscope.render.escape import printable
from bcapscope.render.findings import finding_depths, finding_sentence, severity_counts_text, words_for
from bcapscope.render.report_calls import latency_picture, retry_chain_picture, timeline_picture
from bcapscope.render.report_slave_sessions import session_pictures
from bcapscope.render.slave_session_text import (
    GOOD_EXITS,
    exit_message,
    exit_result_message,
    slave_session_lines,
)
from bcapscope.render.statistics_text import call_kind_text
from bcapscope.render.timestamp import utc_text

MAX_DRAWN = 6
"""Maximum number of slave-mode sessions with pictures: those with the worst problems, then the longest."""

MAX_ROWS = 40  # rows of a table

MAX_SLOW = 10  # rows in the table of set points with the slowest replies

_SIGNS = {Severity.ERROR: "✖", Severity.WARNING: "▲", Severity.NOTE: "●"}


def report_page(
    report_data: ReportData,
    captures: Sequence[str],
    version: str,
    remarks: Sequence[str] = (),
    words: MessageFormatter = ENGLISH_WORDS,
) -> str:
    """Return the HTML page. `remarks` are sentences about what happened when the captures were read."""
    statistics, strays, start = report_data.statistics, report_data.stray_replies, report_data.start
    kinds = () if statistics is None else statistics.kinds
    timeline = timeline_picture(report_data, words) if report_data.timelines else None
    latencies, retry_chains = latency_picture(kinds, words), retry_chain_picture(report_data, words)
    sessions = [
        (session, list(slave_session_lines(session, words=words)), session_pictures(session, start, words))
        for session in drawn_slave_sessions(report_data.slave_sessions)
    ]
    of_sessions = [picture for _, _, pictures in sessions for picture in pictures]
    plotly = _script_text(get_plotlyjs())
    script = resources.files("bcapscope.render").joinpath("templates/report.js").read_text("utf-8")
    return (
        template_environment()
        .get_template("report.html")
        .render(
            report=report_data,
            words=words,
            captures=", ".join(captures),
            footer=words("report.footer", version=version),
            remarks=remarks,
            titles=_titles(report_data, words),
            verdict=_overall_verdict(report_data, words),
            period=words("report.period", start=_moment(start), end=_moment(report_data.end)),
            tiles=_summary_tiles(report_data, words),
            findings=list(zip(report_data.findings, finding_depths(report_data.findings), strict=True)),
            finding_words=words_for(words, report_data.totals),
            finding_sentence=finding_sentence,
            signs=_SIGNS,
            timeline=timeline,
            drawn_sessions=sessions,
            latencies=latencies,
            refusals=[(row.call_kind, *pair) for row in kinds for pair in row.figures.refusal_codes],
            retry_chains=retry_chains,
            stray_replies=words("report.strays", replies=Count(strays, "reply")) if strays else "",
            pictures=[picture for picture in (timeline, *of_sessions, latencies, retry_chains) if picture],
            max_rows=MAX_ROWS,
            max_slow=MAX_SLOW,
            max_drawn=MAX_DRAWN,
            frames_text=lambda frames: frames_text(frames, words, " "),
            seconds=lambda time: f"{(time - start) / 1e9:.3f}",
            first_rows=lambda caption, total: _first_rows_text(caption, total, words),
            mode_text=lambda session: _mode_text(session, words),
            exit_text=lambda session: _exit_text(session, words),
            kind_text=lambda kind: call_kind_text(kind or OTHER_KINDS, words),
            damage_text=lambda damaged: _damage_text(damaged, words),
            hresult_name=hresult_name,
            describe_hresult=describe_hresult,
            plotly=Markup(plotly),
            script=Markup(script),
            policy=_policy(plotly, script),
        )
    )


@cache
def template_environment() -> Environment:
    """Return a Jinja environment that escapes HTML and control characters in all values."""
    return Environment(
        loader=PackageLoader("bcapscope.render"),
        autoescape=True,
        undefined=StrictUndefined,
        finalize=lambda value: value if isinstance(value, Markup) else printable(str(value)),
        keep_trailing_newline=True,
    )


def _titles(report_data: ReportData, words: MessageFormatter) -> dict[str, str]:
    titles = {
        "summary": True,
        "findings": True,
        "timeline-section": report_data.timelines,
        "slave": report_data.slave_sessions,
        "calls": report_data.statistics is not None,
        "retries": report_data.verdicts or report_data.retry_chains or report_data.stray_replies,
        "damage": report_data.damaged_frames,
    }
    return {name: words(f"report.title.{name}") for name, present in titles.items() if present}


def _summary_tiles(report_data: ReportData, words: MessageFormatter) -> list[tuple[str, str]]:
    seen, statistics = report_data.totals, report_data.statistics
    tiles = {"frames": seen.frames, "calls": seen.calls, "clients": seen.clients}
    shown = [(name, f"{value:,}") for name, value in tiles.items()]
    shown.append(("lasting", Duration(report_data.end - report_data.start).text(words)))
    tiles = {}
    if statistics is not None:
        total = statistics.total.figures
        tiles = {"retried": total.retried_calls, "refused": total.refused, "unanswered": total.unanswered}
    tiles["sessions"] = len(report_data.slave_sessions) + report_data.slave_sessions_left_off
    tiles["damaged"] = report_data.damaged_count
    shown += [(name, f"{value:,}") for name, value in tiles.items()]
    return [(words(f"report.tile.{name}"), value) for name, value in shown]


def _overall_verdict(report_data: ReportData, words: MessageFormatter) -> tuple[str, str, str]:
    """Return ``error``, ``warning`` or ``good``, the counts as text, and the first finding's sentence."""
    counts = Counter(finding.severity for finding in report_data.findings)
    listed = severity_counts_text(counts, words)
    if counts[Severity.ERROR] or counts[Severity.WARNING]:
        kind = "error" if counts[Severity.ERROR] else "warning"
        sentence = finding_sentence(report_data.findings[0], words_for(words, report_data.totals))
        return kind, words("report.counts", counts=listed), sentence
    if not listed:
        return "good", words("report.no-problem"), ""
    return "good", words("report.no-problem.notes", counts=listed), ""


def drawn_slave_sessions(slave_sessions: Sequence[SlaveSession]) -> list[SlaveSession]:
    worst = sorted(slave_sessions, key=lambda session: (-_trouble_rank(session), -session.counts.sent))
    return sorted(worst[:MAX_DRAWN], key=lambda session: session.number)


def _trouble_rank(slave_session: SlaveSession) -> int:
    if not slave_session.counts.sent:
        return -1
    bad = slave_session.exit.reason not in GOOD_EXITS
    return 2 * bad + bool(
        slave_session.timing.gaps or slave_session.counts.refused or slave_session.counts.unanswered
    )


def _first_rows_text(caption: str, total: int, words: MessageFormatter) -> str:
    if total <= MAX_ROWS:
        return caption
    return words("report.first-rows", caption=caption, shown=MAX_ROWS, total=total)


def _mode_text(slave_session: SlaveSession, words: MessageFormatter) -> str:
    mode = slave_session.mode
    if mode.value is None:
        return words("slave.mode.unknown")
    return f"0x{mode.value:03X}" if mode.pose_type is None else f"0x{mode.value:03X}, {mode.pose_type}"


def _exit_text(slave_session: SlaveSession, words: MessageFormatter) -> str:
    code = slave_session.exit.hresult
    reason = words.text(exit_message(slave_session.exit.reason))
    return f"{reason}: {words.text(exit_result_message(code, slave_session))}" if code else reason


def _damage_text(damaged: DamagedFrame, words: MessageFormatter) -> str:
    reasons = [words.text(problem.reason) for problem in damaged.problems]
    if damaged.missing_bytes:
        reasons.insert(0, words("report.missing", bytes=Count(damaged.missing_bytes, "byte")))
    return words("list.semicolon").join(reasons)


def _moment(time: int) -> str:
    """Return a time (ns since 1970) as text in UTC, cut to milliseconds."""
    text = utc_text(time)
    return text[:-7].replace("T", " ") + " UTC" if text.endswith("Z") else text


def _script_text(code: str) -> str:
    """Escape ``</script`` and ``<!--`` in JavaScript, so that the browser does not end the script element
    early. Outside strings, the code must not contain ``</script`` or ``<!--``. In a JavaScript string, an
    escape with a backslash does not change the value.
    """
    return code.replace("</script", "<\\/script").replace("<!--", "<\\!--")


def _policy(*scripts: str) -> str:
    digests = [base64.b64encode(hashlib.sha256(script.encode()).digest()).decode() for script in scripts]
    hashes = " ".join(f"'sha256-{digest}'" for digest in digests)
    return (
        f"default-src 'none'; script-src {hashes}; style-src 'unsafe-inline'; img-src data: blob:; "
        "base-uri 'none'; form-action 'none'"
    )
