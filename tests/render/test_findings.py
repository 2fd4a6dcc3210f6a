"""Findings as text and as JSON, and the list of rules in the documentation."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from bcapscope.analysis.finding import Finding, Severity, TrafficTotals
from bcapscope.analysis.rules.rule_table import RULES as DIAGNOSIS_RULES
from bcapscope.protocol.text_format import display_width
from bcapscope.render.color_palette import ANSI
from bcapscope.render.findings import NARROWEST, FindingsRenderer, finding_record
from tests.samples.findings import make_finding

RULES = Path(__file__).parents[2] / "docs" / "rules.md"
SEEN = TrafficTotals(512, 256, 1, 2_100_000_000)
CAUSE = make_finding(
    "late-reply",
    Severity.WARNING,
    "The reply came late; all is lost.",
    (4, 5),
    None,
    "Look for it.",
    "a paper",
)
EFFECT = make_finding(
    "underflow", Severity.ERROR, "The controller stopped.", (7,), 1, "Be faster.", "another"
)
NOTE = make_finding("polling", Severity.NOTE, "Much is read.", (1, 9), None, "Read less.", "a third")


def lines(*findings: Finding, width: int = 100) -> list[str]:
    return list(FindingsRenderer(width=width).lines(findings, SEEN))


def test_consequences_stand_under_their_cause() -> None:
    assert lines(CAUSE, EFFECT) == [
        "1 warning late-reply",
        "  The reply came late; all is lost.",
        "  Frames: 4 5",
        "  What to do: Look for it.",
        "  Source: a paper",
        "",
        "    2 error underflow, follows from 1",
        "      The controller stopped.",
        "      Frame: 7",
        "      What to do: Be faster.",
        "      Source: another",
        "",
        "1 error, 1 warning in 512 frames, 256 calls, 1 client, 2.1 s",
    ]


def test_a_clean_capture_says_so_and_how_much_it_was() -> None:
    assert lines() == ["No problem found in 512 frames, 256 calls, 1 client, 2.1 s"]
    assert lines(NOTE)[-1] == "No problem found in 512 frames, 256 calls, 1 client, 2.1 s; 1 note"
    (line,) = FindingsRenderer().lines((), SEEN._replace(not_followed=3))
    assert line.endswith(" 256 calls, 1 client, 2.1 s, 3 calls not followed to the end")
    assert list(FindingsRenderer().lines((), TrafficTotals(0, 0, 0, 0))) == ["The traffic contains no b-CAP."]


@pytest.mark.parametrize("width", [1, NARROWEST, 60, 100, 500])
def test_text_is_wrapped(width: int) -> None:
    long = make_finding(
        "polling", Severity.NOTE, "ロボット was read " * 30, tuple(range(40)), None, "Do. " * 40, "s " * 90
    )
    written = lines(long, width=width)
    assert max(map(display_width, written[:-1])) <= min(max(width, NARROWEST), 120)
    assert " ".join(line.strip() for line in written).count("was read") == 30


def test_deep_chains_stay_on_the_screen() -> None:
    chain = [EFFECT] * 30
    findings = [
        make_finding("a", Severity.ERROR, "A thing.", (1,), number or None, "Do.", "s")
        for number in range(len(chain))
    ]
    assert max(len(line) - len(line.lstrip()) for line in lines(*findings)) <= 18


@pytest.mark.parametrize("hostile", ["\x1b[2J", "one\ntwo", "\u202egpj", "\x9b31m", "\ud800", "a\x00b"])
def test_wire_strings_reach_no_terminal(hostile: str) -> None:
    finding = make_finding(
        "polling", Severity.NOTE, f"The call {hostile} failed.", (1,), None, f"Do {hostile}.", "s"
    )
    written = "\n".join(FindingsRenderer(ANSI).lines([finding], SEEN))
    assert hostile not in written
    assert hostile not in finding_record(1, finding, SEEN).decode()
    bare = written
    for shade in (ANSI.number, ANSI.name, ANSI.dim, ANSI.good, ANSI.problem, ANSI.reset):
        bare = bare.replace(shade, "")
    assert all(char.isprintable() or char == "\n" for char in bare)


def test_json_has_exactly_these_keys() -> None:
    record = json.loads(finding_record(2, EFFECT, SEEN))
    assert record == {
        "finding": 2,
        "rule": "underflow",
        "severity": "error",
        "sentence": "The controller stopped.",
        "frames": [7],
        "consequence_of": 1,
        "advice": "Be faster.",
        "source": "another",
        "params": {},
        "began": 5,
        "calls": [3],
        "client": "10.0.0.2:50001",
        "count": 1,
        "packets": [],
        "time": 5e-09,
        "t": pytest.approx((5 - SEEN.began) / 1e9),
        "first": None,
        "last": None,
        "server": "10.0.0.1:5007",
        "transport": "udp",
        "final": True,
    }
    assert list(record) == [
        "finding",
        "rule",
        "severity",
        "sentence",
        "frames",
        "consequence_of",
        "advice",
        "source",
        "params",
        "began",
        "calls",
        "client",
        "count",
        "packets",
        "time",
        "t",
        "first",
        "last",
        "server",
        "transport",
        "final",
    ]
    assert json.loads(finding_record(1, CAUSE, SEEN))["consequence_of"] is None


def rule_table() -> str:
    """Write the list of rules as a Markdown table, the gravest first."""
    rank = list(Severity)
    ordered = sorted(DIAGNOSIS_RULES.values(), key=lambda rule: rank.index(rule.severity))
    rows = [f"| `{rule.id}` | {rule.severity} | {rule.title} | {rule.source} |" for rule in ordered]
    return "\n".join(("| Rule | Severity | Finds | Source |", "|---|---|---|---|", *rows)) + "\n"


def test_the_documentation_lists_the_rules() -> None:
    assert rule_table() in RULES.read_text(encoding="utf-8")
