"""A report as one HTML page that needs nothing else, neither files nor network.

Nothing from the wire is more than text on it. Should that fail, the page's own policy still lets no script
run but the two that belong to it, and lets nothing be fetched or sent.
"""

from __future__ import annotations

import base64
import hashlib
from collections.abc import Callable, Iterable, Iterator, Sequence
from typing import NamedTuple

from plotly.offline import get_plotlyjs

from bcapscope.analysis.report_data import ReportData
from bcapscope.render import report_calls, report_sections
from bcapscope.render.report_figure import Picture
from bcapscope.render.report_html import Html, element, escape_html, join_html, paragraph
from bcapscope.render.report_script import SCRIPT
from bcapscope.render.report_style import STYLE

_THEMES = (("auto", "As the system"), ("light", "Light"), ("dark", "Dark"))
_HELP = (
    "Point at a picture for its values, drag to zoom, double-click to see all again. With the keyboard: Tab "
    "to a picture, then + and - to zoom, arrows to move, 0 to see all."
)


class _PageSection(NamedTuple):
    """A section of the page."""

    name: str
    title: str
    content: Callable[[], Iterable[Html | Picture]]


def report_page(
    report_data: ReportData, captures: Sequence[str], version: str, remarks: Sequence[str] = ()
) -> str:
    """Write the page.

    Args:
        report_data: what was found.
        captures: names of the files.
        version: of this program.
        remarks: what is to be said about reading the captures, such as that one is damaged.
    """
    plotly = _script_text(get_plotlyjs())
    title = f"b-CAP report: {', '.join(captures)}"
    pictures: list[Picture] = []
    sections = list(_sections(report_data, remarks))
    main = join_html(_section(section, pictures) for section in sections)
    parts = (
        '<!DOCTYPE html>\n<html lang="en" data-theme="auto">\n<head>\n<meta charset="utf-8">\n',
        f'<meta http-equiv="Content-Security-Policy" content="{_policy(plotly, SCRIPT)}">\n',
        '<meta name="viewport" content="width=device-width, initial-scale=1">\n',
        '<meta name="referrer" content="no-referrer">\n',
        f"<title>{escape_html(title)}</title>\n<style>\n{STYLE}</style>\n</head>\n<body>\n",
        _header(captures),
        _contents(sections),
        element("main", main, id="content"),
        _footer(version),
        *(_picture_data(each) for each in pictures),
        f"\n<script>{plotly}</script>\n<script>{SCRIPT}</script>\n</body>\n</html>\n",
    )
    return "".join(parts)


def _sections(report_data: ReportData, remarks: Sequence[str]) -> Iterator[_PageSection]:
    yield _PageSection(
        "summary",
        "Summary",
        lambda: (report_sections.summary_section(report_data), *(paragraph(remark) for remark in remarks)),
    )
    yield _PageSection("findings", "Findings", lambda: (report_sections.findings_section(report_data),))
    if report_data.timelines:
        yield _PageSection(
            "timeline-section", "Session timeline", lambda: (report_calls.timeline_picture(report_data),)
        )
    if report_data.slave_sessions:
        yield _PageSection("slave", "Slave mode", lambda: report_sections.slave_mode_section(report_data))
    if report_data.statistics is not None:
        yield _PageSection("calls", "Calls", lambda: report_sections.calls_section(report_data))
    if report_data.verdicts or report_data.retry_chains or report_data.stray_replies:
        yield _PageSection(
            "retries", "Retries and lost replies", lambda: report_sections.retries_section(report_data)
        )
    if report_data.damaged_frames:
        yield _PageSection("damage", "Damaged frames", lambda: report_sections.damage_section(report_data))


def _section(section: _PageSection, pictures: list[Picture]) -> Html:
    pieces = [element("h2", escape_html(section.title), id=f"{section.name}-title")]
    for item in section.content():
        if isinstance(item, Picture):
            pictures.append(item)
            pieces.append(_figure(item))
        else:
            pieces.append(item)
    return element("section", join_html(pieces), id=section.name, aria_labelledby=f"{section.name}-title")


def _figure(picture: Picture) -> Html:
    name = picture.name
    drawing = element(
        "div", Html(""), class_="plot", data_from=f"{name}-data", style=f"height:{picture.height}px"
    )
    content = join_html(
        (
            element("h3", escape_html(picture.title), id=f"{name}-title"),
            drawing,
            element("figcaption", escape_html(picture.caption), id=f"{name}-caption"),
        )
    )
    described = {"aria_labelledby": f"{name}-title", "aria_describedby": f"{name}-caption"}
    return element("figure", content, id=name, tabindex="0", **described)


def _picture_data(picture: Picture) -> str:
    return f'<script type="application/json" id="{picture.name}-data">{picture.json}</script>\n'


def _header(captures: Sequence[str]) -> Html:
    choices = join_html(
        Html(
            f'<label><input type="radio" name="theme" value="{value}"{" checked" * (value == "auto")}> '
            f"{escape_html(name)}</label>"
        )
        for value, name in _THEMES
    )
    switch = element("fieldset", Html(f"<legend>Theme</legend>{choices}"), class_="theme")
    names = element("p", escape_html(", ".join(captures)), class_="names soft")
    title = element("div", Html(f"<h1>b-CAP report</h1>{names}"))
    skip = element("a", escape_html("Skip to the content"), href="#content", class_="skip")
    return Html(f"{skip}<header>{title}{switch}</header>\n")


def _contents(sections: Sequence[_PageSection]) -> Html:
    links = join_html(element("a", escape_html(each.title), href=f"#{each.name}") for each in sections)
    return element("nav", Html(f"{links}{paragraph(_HELP, 'soft screen')}"), aria_label="Contents")


def _footer(version: str) -> Html:
    words = (
        f"Made by bcapscope {version}. Frames and calls can be looked up in the capture: bcapscope decode "
        "-f 'frame == 4711', bcapscope calls --tree -f 'call == 815'."
    )
    script = element("noscript", paragraph("The pictures need JavaScript; text and tables do not."))
    return element("footer", Html(f"{script}{paragraph(words, 'soft')}"))


def _script_text(code: str) -> str:
    """Return code that cannot end its element; the sequence only stands in strings of JavaScript."""
    return code.replace("</script", "<\\/script").replace("<!--", "<\\!--")


def _policy(*scripts: str) -> str:
    hashes = " ".join(f"'sha256-{_digest(script)}'" for script in scripts)
    return (
        f"default-src 'none'; script-src {hashes}; style-src 'unsafe-inline'; img-src data: blob:; "
        "base-uri 'none'; form-action 'none'"
    )


def _digest(script: str) -> str:
    return base64.b64encode(hashlib.sha256(script.encode("utf-8")).digest()).decode("ascii")
