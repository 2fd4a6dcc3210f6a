"""A report as one HTML page that needs no other files and no network.

Text from the wire is escaped. In case an escape is missing, the page's content security policy allows only
its own two scripts, and no network access.
"""

from __future__ import annotations

import base64
import hashlib
from collections.abc import Sequence
from functools import cache
from importlib import resources

from jinja2 import Environment, PackageLoader, StrictUndefined
from markupsafe import Markup
from plotly.offline import get_plotlyjs

from bcapscope.analysis.report_data import ReportData
from bcapscope.messages import ENGLISH_WORDS, MessageFormatter
from bcapscope.messages.places import Count
from bcapscope.render import report_calls, report_sections
from bcapscope.render.escape import printable

_LABELS = (
    *("title", "skip", "theme", "auto", "light", "dark", "contents", "pictures", "findings", "follows-from"),
    *("advice", "frame", "frames", "source", "no-finding", "session", "no-script"),
)
"""Ids of the labels in the template, without the prefix ``report.label.``."""


def report_page(
    report_data: ReportData,
    captures: Sequence[str],
    version: str,
    remarks: Sequence[str] = (),
    words: MessageFormatter = ENGLISH_WORDS,
) -> str:
    """Return the HTML page. `remarks` are sentences about reading the captures."""
    statistics, strays = report_data.statistics, report_data.stray_replies
    timeline = report_calls.timeline_picture(report_data, words) if report_data.timelines else None
    sessions = report_sections.session_views(report_data, words)
    latencies = None if statistics is None else report_calls.latency_picture(statistics.kinds, words)
    retry_chains = report_calls.retry_chain_picture(report_data, words)
    of_sessions = [picture for session in sessions for picture in session.pictures]
    plotly = _script_text(get_plotlyjs())
    script = resources.files("bcapscope.render").joinpath("templates/report.js").read_text("utf-8")
    template = template_environment().get_template("report.html")
    return template.render(
        captures=", ".join(captures),
        footer=words("report.footer", version=version),
        remarks=remarks,
        language=words.language.value,
        label={name: words(f"report.label.{name}") for name in _LABELS},
        titles=_titles(report_data, words),
        verdict=report_sections.overall_verdict(report_data, words),
        period=report_sections.period_text(report_data, words),
        tiles=report_sections.summary_tiles(report_data, words),
        findings=report_sections.finding_views(report_data, words),
        slave_sessions=report_sections.slave_session_table(report_data, words),
        call_tables=list(report_sections.call_tables(report_data, words)),
        verdicts=report_sections.verdict_table(report_data, words),
        stray_replies=words("report.strays", replies=Count(strays, "reply")) if strays else "",
        damage=report_sections.damage_table(report_data, words),
        timeline=timeline,
        drawn_sessions=sessions,
        latencies=latencies,
        retry_chains=retry_chains,
        pictures=[picture for picture in (timeline, *of_sessions, latencies, retry_chains) if picture],
        plotly=Markup(plotly),
        script=Markup(script),
        policy=_policy(plotly, script),
    )


@cache
def template_environment() -> Environment:
    """Return the Jinja environment, which escapes HTML and control characters in all values."""
    return Environment(
        loader=PackageLoader("bcapscope.render"),
        autoescape=True,
        undefined=StrictUndefined,
        finalize=lambda value: value if isinstance(value, Markup) else printable(str(value)),
        keep_trailing_newline=True,
    )


def _titles(report_data: ReportData, words: MessageFormatter) -> dict[str, str]:
    """Return the titles of those sections that have content, by id."""
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


def _script_text(code: str) -> str:
    """Return JavaScript that cannot end its script element.

    The replacement is safe, because the replaced sequences occur only in JavaScript strings.
    """
    return code.replace("</script", "<\\/script").replace("<!--", "<\\!--")


def _policy(*scripts: str) -> str:
    hashes = " ".join(f"'sha256-{_digest(script)}'" for script in scripts)
    return (
        f"default-src 'none'; script-src {hashes}; style-src 'unsafe-inline'; img-src data: blob:; "
        "base-uri 'none'; form-action 'none'"
    )


def _digest(script: str) -> str:
    return base64.b64encode(hashlib.sha256(script.encode("utf-8")).digest()).decode("ascii")
