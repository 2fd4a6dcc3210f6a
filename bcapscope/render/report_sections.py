"""The sections of a report, as HTML around pictures."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from bcapscope.analysis.account import Account, Damaged
from bcapscope.analysis.finding import Finding, Severity
from bcapscope.analysis.moments import SetPointFact
from bcapscope.analysis.speech import span, times
from bcapscope.analysis.statistics import OTHERS, Figures, Row
from bcapscope.analysis.stay import ExitReason, Stay
from bcapscope.protocol.hresult import describe, hresult_name
from bcapscope.protocol.wording import counted
from bcapscope.render import report_calls, report_stays
from bcapscope.render.moment import utc_text
from bcapscope.render.report_figure import Picture
from bcapscope.render.report_html import Html, element, escaped, facts, joined, paragraph, table
from bcapscope.render.slave import stay_lines
from bcapscope.render.statistics import question_text
from bcapscope.traffic.observation import Conversation
from bcapscope.traffic.verdict import Verdict

MOST_DRAWN = 6
"""Stays in slave mode with pictures: those with most trouble, then the longest."""

MOST_ROWS = 40
"""Rows of a table."""

MOST_SLOW = 10
"""Set points in the table of the slowest."""

_DEEPEST = 4
_SIGNS = {Severity.ERROR: "✖", Severity.WARNING: "▲", Severity.NOTE: "●"}
_EXITS = {
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
_SUFFERED = {
    Verdict.UNANSWERED: "no reply to any try was seen, and the client went on",
    Verdict.CAPTURE_ENDED: "no reply was seen before the capture ended",
    Verdict.NOT_FOLLOWED: "more was open than is kept, so that nobody looked for its reply any more",
    Verdict.EXECUTED_TWICE: "the controller did it more than once: replies differ, or handles are missing",
    Verdict.REPLY_LATE: "a reply came after the client had asked again or gone on, and was discarded",
    Verdict.REPLY_LOST: "a reply was seen here, and the client asked again all the same",
    Verdict.REQUEST_LOST: "the controller was at work on a later try and on none before",
    Verdict.CANNOT_TELL: "asked again, and nothing seen here tells whether requests or replies were lost",
}
_GOOD_EXITS = (ExitReason.LEFT, ExitReason.CAPTURE_ENDED, ExitReason.CHANGED)


def summary(account: Account) -> Html:
    """Tell what, when, who and how much, and the first cause."""
    seen, statistics = account.seen, account.statistics
    tiles = [("frames", f"{seen.frames:,}"), ("calls", f"{seen.calls:,}"), ("clients", f"{seen.clients:,}")]
    tiles.append(("lasting", span(account.end - account.start)))
    if statistics is not None:
        total = statistics.total.figures
        tiles += [
            ("calls sent again", f"{total.retried:,}"),
            ("refused", f"{total.refused:,}"),
            ("never answered", f"{total.unanswered:,}"),
        ]
    tiles.append(("stays in slave mode", f"{len(account.stays) + account.stays_left_off:,}"))
    tiles.append(("damaged frames", f"{account.damaged_count:,}"))
    period = f"From {_moment(account.start)} to {_moment(account.end)}."
    shown = element("div", facts((name, escaped(value)) for name, value in tiles), class_="tiles")
    return joined((_verdict(account), paragraph(period, "soft"), shown))


def findings(account: Account) -> Html:
    """List all findings, each consequence under its cause."""
    if not account.findings:
        return paragraph("No rule found anything.")
    depths: list[int] = []
    items = []
    for number, finding in enumerate(account.findings, 1):
        cause = finding.consequence_of
        depths.append(0 if cause is None else depths[cause - 1] + 1)
        items.append(_finding(number, finding, min(depths[-1], _DEEPEST)))
    intro = paragraph(
        "The first cause stands first; what follows from it stands under it. Times count from the first "
        "frame, frames are numbered as bcapscope decode numbers them.",
        "soft",
    )
    return joined((intro, element("ol", joined(items), class_="findings")))


def slave_mode(account: Account) -> Iterator[Html | Picture]:
    """Tell and draw the stays in slave mode."""
    yield _stay_table(account)
    for stay in drawn_stays(account.stays):
        yield element("h3", escaped(f"Stay {stay.number}"), id=f"stay-{stay.number}")
        yield element("div", facts(_stay_facts(stay, account.start)), class_="facts")
        pictures = (
            report_stays.pace(stay, account.start),
            report_stays.spread(stay),
            report_stays.motion(stay, account.start),
        )
        yield from (each for each in pictures if each is not None)
        if stay.timing.slowest:
            yield _slowest(stay, account.start)
        yield _in_full(stay)


def calls(account: Account) -> Iterator[Html | Picture]:
    """Tell and draw how long calls took."""
    statistics = account.statistics
    if statistics is None:
        return
    drawn = report_calls.latencies(statistics.kinds)
    if drawn is not None:
        yield drawn
    yield _figures_table(
        "Calls by client.", "client", [(_who(row), row.figures) for row in statistics.clients]
    )
    kinds = [(escaped(question_text(row.question or OTHERS)), row.figures) for row in statistics.kinds]
    yield _figures_table("Calls by command, all clients together.", "command", kinds)
    yield from _refusals(statistics.kinds)


def retries(account: Account) -> Iterator[Html | Picture]:
    """Tell and draw what was sent again."""
    if account.verdicts:
        rows = [
            [escaped(verdict.value), escaped(f"{count:,}"), escaped(_SUFFERED.get(verdict, ""))]
            for verdict, count in account.verdicts.items()
        ]
        yield table(
            "Calls that were not just answered or refused, by what they suffered as far as this capture "
            "tells.",
            ("what", "calls", "meaning"),
            rows,
            "<><",
        )
    drawn = report_calls.chains(account)
    if drawn is not None:
        yield drawn
    if account.strays:
        yield paragraph(f"{counted(account.strays, 'reply', 'replies')} to no call that was open.")


def damage(account: Account) -> Iterator[Html]:
    """List the first damaged frames."""
    found = account.damaged
    rest = account.damaged_count - len(found)
    rows = [_damaged_row(each, account.start) for each in found]
    yield table(
        "Frames that are not as b-CAP has them, and holes in the capture"
        + (f"; the first {len(found)} of {account.damaged_count}." if rest else "."),
        ("frame", "at, s", "from", "bytes", "begins with", "what is wrong"),
        rows,
        ">><><<",
    )


def drawn_stays(stays: Sequence[Stay]) -> list[Stay]:
    """Choose the stays that get pictures, in the order in which they began."""
    worst = sorted(stays, key=lambda stay: (-_trouble(stay), -stay.counts.sent))
    return sorted(worst[:MOST_DRAWN], key=lambda stay: stay.number)


def _trouble(stay: Stay) -> int:
    if not stay.counts.sent:
        return -1
    bad = stay.exit.reason not in _GOOD_EXITS
    return 2 * bad + bool(stay.timing.gaps or stay.counts.refused or stay.counts.unanswered)


def _verdict(account: Account) -> Html:
    counts = {severity: 0 for severity in Severity}
    for finding in account.findings:
        counts[finding.severity] += 1
    told = ", ".join(counted(count, severity.value) for severity, count in counts.items() if count)
    if counts[Severity.ERROR] or counts[Severity.WARNING]:
        first = account.findings[0]
        kind = "error" if counts[Severity.ERROR] else "warning"
        return element("div", Html(f"{element('strong', escaped(told + '.'))} {escaped(first.sentence)}"),
                       class_=f"verdict {kind}")  # fmt: skip
    words = "No problem found" + (f"; {told}." if told else ".")
    return element("div", element("strong", escaped(words)), class_="verdict good")


def _finding(number: int, finding: Finding, depth: int) -> Html:
    severity = finding.severity
    badge = element("span", escaped(f"{_SIGNS[severity]} {severity.value}"), class_=f"badge {severity.value}")
    head = Html(f"{number} {badge} {element('code', escaped(finding.rule))}")
    if finding.consequence_of is not None:
        link = element("a", escaped(finding.consequence_of), href=f"#finding-{finding.consequence_of}")
        head = Html(f"{head}, follows from {link}")
    frames = " ".join(map(str, finding.frames))
    parts = [element("p", head), paragraph(finding.sentence, "sentence")]
    if finding.advice:
        parts.append(element("p", Html(f"{element('b', Html('What to do:'))} {escaped(finding.advice)}")))
    if frames:
        parts.append(paragraph(f"{'Frame' if len(finding.frames) == 1 else 'Frames'} {frames}", "soft"))
    if finding.source:
        parts.append(paragraph(f"Source: {finding.source}", "source"))
    return element(
        "li", joined(parts), class_=f"finding {severity.value} depth-{depth}", id=f"finding-{number}"
    )


def _stay_table(account: Account) -> Html:
    rows = [
        [
            escaped(stay.number),
            escaped(_at(stay.entered, account.start)),
            escaped(f"{stay.duration_ms / 1e3:.3f}"),
            escaped(_mode_number(stay)),
            _ends(stay.conversation),
            escaped(f"{stay.counts.sent:,}"),
            escaped(f"{stay.counts.retries:,}"),
            escaped(_exit(stay)),
        ]
        for stay in account.stays[:MOST_ROWS]
    ]
    all_of_them = len(account.stays) + account.stays_left_off
    words = "Stays in slave mode."
    if all_of_them > len(rows):
        words = f"The first {len(rows)} of {all_of_them} stays in slave mode."
    if len(account.stays) > MOST_DRAWN:
        words += f" Pictures follow of the {MOST_DRAWN} with most trouble."
    header = ("stay", "at, s", "lasted, s", "mode", "client", "set points", "retries", "ended")
    return table(words, header, rows, ">>><<>><")


def _mode_number(stay: Stay) -> str:
    mode = stay.mode
    return _mode(stay) if mode.value is None else f"0x{mode.value:03X}, {mode.pose_type} type"


def _mode(stay: Stay) -> str:
    mode = stay.mode
    if mode.value is None:
        return f"not seen; {mode.pose_type} type by its numbers" if mode.pose_type else "not seen"
    text = "" if mode.meaning is None else f": {mode.meaning.text}"
    return f"0x{mode.value:03X}{text}" + (" (as on an RC8)" if mode.guessed else "")


def _exit(stay: Stay) -> str:
    code = stay.exit.hresult
    told = "" if not code else f": {hresult_name(code)}, {describe(code).text}"
    return f"{_EXITS[stay.exit.reason]}{told}"


def _stay_facts(stay: Stay, start: int) -> Iterator[tuple[str, Html]]:
    counts, timing, buffer = stay.counts, stay.timing, stay.buffer
    how = "before the capture began" if stay.entry is None else f"by call {stay.entry.call}"
    yield "Entered", escaped(f"at {_at(stay.entered, start)} s, {how}")
    yield "Ended", escaped(f"at {_at(stay.exit.time, start)} s, {_exit(stay)}")
    yield "Client", _ends(stay.conversation)
    yield "Mode", escaped(_mode(stay))
    if stay.mode.generation_known_by:
        yield "Controller", escaped(f"{stay.mode.generation}: {stay.mode.generation_known_by}")
    refused = sum(counts.refused.values())
    yield (
        "Set points",
        escaped(
            f"{counts.sent:,} sent, {counts.accepted:,} accepted, {refused:,} refused, "
            f"{counts.unanswered:,} never answered, {counts.open:,} open when the capture ended, "
            f"{counts.not_followed:,} not followed to the end, {counts.after_end:,} more after the end"
        ),
    )
    yield "Sent again", escaped(times(counts.retries) if counts.retries else "never")
    yield "Cycle", escaped(report_stays.percentiles(timing.cycle))
    yield (
        "On the grid",
        escaped(f"{timing.on_grid:,} cycles of {timing.grid_ms:g} ms; {timing.grid_known_by}"),
    )
    yield "Reply after", escaped(report_stays.percentiles(timing.latency))
    yield (
        "Gaps",
        escaped(f"{timing.gaps or 'none'} longer than the {timing.slack_ms:g} ms that a full buffer lasts"),
    )
    empty = f"{times(buffer.starved)} by the model, {buffer.starved_moving:,} of them in motion"
    yield "Buffer ran empty", escaped(empty if buffer.starved else "never, by the model")
    if buffer.assumptions:
        yield "The model assumes", escaped("; ".join(buffer.assumptions))


def _slowest(stay: Stay, start: int) -> Html:
    rows = [_slow_row(fact, start) for fact in stay.timing.slowest[:MOST_SLOW]]
    header = ("call", "frame", "at, s", "cycle, ms", "reply after, ms", "result")
    return table(f"Set points of stay {stay.number} with the slowest replies.", header, rows, ">>>>><")


def _in_full(stay: Stay) -> Html:
    """Say all that `slave` says of a stay, for those who want it."""
    title = element("summary", escaped(f"Stay {stay.number} as bcapscope slave tells it"))
    lines = joined(Html(f"{escaped(line)}\n") for line in stay_lines(stay))
    return element("details", joined((title, element("pre", lines, tabindex="0"))))


def _slow_row(fact: SetPointFact, start: int) -> list[Html]:
    return [
        escaped(fact.call),
        escaped(fact.request),
        escaped(_at(fact.time, start)),
        escaped("" if fact.cycle_ms is None else f"{fact.cycle_ms:.3f}"),
        escaped("never" if fact.latency_ms is None else f"{fact.latency_ms:.3f}"),
        escaped("" if fact.hresult is None else hresult_name(fact.hresult)),
    ]


def _figures_table(caption: str, first: str, rows: Sequence[tuple[Html, Figures]]) -> Html:
    header = (
        *(first, "calls", "per s", "line time", "median ms", "99% ms", "longest ms"),
        *("sent again", "refused", "never answered"),
    )
    if len(rows) > MOST_ROWS:
        caption += f" The first {MOST_ROWS} of {len(rows)}."
    cells = [[name, *map(escaped, _figures(figures))] for name, figures in rows[:MOST_ROWS]]
    return table(caption, header, cells, "<" + ">" * (len(header) - 1))


def _figures(figures: Figures) -> Iterator[str]:
    latency = figures.latency
    yield f"{figures.calls:,}"
    yield "" if figures.rate is None else f"{figures.rate:,.1f}"
    yield "" if figures.share is None else f"{figures.share:.1%}"
    yield from (
        ("", "", "")
        if latency is None
        else (f"{value:,.3f}" for value in (latency.p50, latency.p99, latency.most))
    )
    yield from (
        f"{count:,}" if count else "" for count in (figures.retried, figures.refused, figures.unanswered)
    )


def _refusals(rows: Sequence[Row]) -> Iterator[Html]:
    refused = [
        [
            escaped(f"{count:,}"),
            element("code", escaped(hresult_name(code))),
            escaped(question_text(row.question or OTHERS)),
            escaped(describe(code).text),
            escaped(describe(code).advice or ""),
        ]
        for row in rows
        for code, count in row.figures.codes
    ]
    if refused:
        header = ("times", "result", "of", "meaning", "what to do")
        yield table("What the controller refused, and why.", header, refused[:MOST_ROWS], "><<<<")


def _damaged_row(each: Damaged, start: int) -> list[Html]:
    reasons = "; ".join(problem.reason for problem in each.problems)
    missing = f"{counted(each.missing, 'byte')} missing in the capture" if each.missing else ""
    return [
        escaped(each.frame),
        escaped(_at(each.time, start)),
        escaped(each.flow.src_text),
        escaped(each.length),
        element("code", escaped(each.raw.hex(" "))),
        escaped("; ".join(filter(None, (missing, reasons)))),
    ]


def _who(row: Row) -> Html:
    return escaped("all") if row.conversation is None else _ends(row.conversation)


def _ends(conversation: Conversation) -> Html:
    return joined(
        (
            element("span", escaped(conversation.client), class_="ends"),
            escaped(" → "),
            element(
                "span", escaped(f"{conversation.server} {conversation.transport.upper()}"), class_="ends"
            ),
        )
    )


def _moment(time: int) -> str:
    """Write a moment to the millisecond; captures have more digits than a reader needs."""
    return utc_text(time)[:-7].replace("T", " ") + " UTC" if utc_text(time).endswith("Z") else utc_text(time)


def _at(time: int, start: int) -> str:
    return f"{(time - start) / 1e9:.3f}"
