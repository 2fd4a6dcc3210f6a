"""The page of a report: complete, self-contained, and harmless whatever was on the wire."""

from __future__ import annotations

import base64
import hashlib
import json
import re
from collections.abc import Iterator
from dataclasses import replace
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from bcapscope.analysis.finding import Severity
from bcapscope.messages import ENGLISH_WORDS
from bcapscope.render.escape import printable
from bcapscope.render.report_page import report_page, template_environment
from bcapscope.traffic.observation import SERVER_PORT, Conversation, Endpoint, Transport
from tests.render.reports import CAPTURES, Page, page_of, report_data_of
from tests.samples.findings import make_finding

ALL = sorted(path.name for path in CAPTURES.iterdir() if path.suffix in (".pcap", ".pcapng"))
HOSTILE = "</script><script>alert(1)</script><img src=x onerror=alert(2)><!--\"'&lt;%{x}\x1b]0;\u202e"


def strings(value: Any) -> Iterator[str]:
    """Yield all strings in JSON."""
    if isinstance(value, str):
        yield value
    elif isinstance(value, dict):
        for item in value.values():
            yield from strings(item)
    elif isinstance(value, list):
        for item in value:
            yield from strings(item)


@pytest.mark.parametrize("name", ALL)
def test_every_sample_gives_a_whole_page(name: str) -> None:
    page = page_of(name)
    assert page.unclosed == []
    assert len(page.ids) == len(set(page.ids))
    for plot in (each for each in page.of("div") if each.get("class") == "plot"):
        assert page.data[str(plot["data-from"])]["data"]
    links = [str(each["href"]) for each in page.of("a")]
    assert all(link.startswith("#") and link[1:] in page.ids for link in links)
    for figure in page.of("figure"):
        assert figure["tabindex"] == "0"
        for role in ("aria-labelledby", "aria-describedby"):
            assert figure[role] in page.ids


@pytest.mark.parametrize("name", ALL)
def test_nothing_is_fetched(name: str) -> None:
    page = page_of(name)
    for tag, attributes in page.tags:
        assert tag not in ("link", "img", "iframe", "object", "embed", "base", "form", "svg")
        assert not {"src", "srcset", "action", "background"} & set(attributes)
        assert not [key for key in attributes if key.startswith("on")]
        assert "url(" not in str(attributes.get("style", ""))
    style = page.scripts[0]
    assert "url(" not in style
    assert "@import" not in style


def test_only_the_two_scripts_of_the_page_may_run() -> None:
    page = page_of("slave-session.pcapng")
    (policy,) = [str(each["content"]) for each in page.of("meta") if "http-equiv" in each]
    allowed = set(re.findall(r"'sha256-([^']+)'", policy))
    codes = page.scripts[1:]
    assert len(codes) == 2
    assert {base64.b64encode(hashlib.sha256(code.encode()).digest()).decode() for code in codes} == allowed
    assert policy.startswith("default-src 'none'; script-src 'sha256-")
    assert "unsafe-inline" not in policy.split("style-src")[0]
    assert "Plotly.newPlot" in codes[1]


def test_hostile_strings_of_a_capture_are_only_shown() -> None:
    page = page_of("malformed.pcapng")
    assert "<script>alert(1)" not in page.source
    assert "[/foo][red]<script>alert(1)</script>&am…" in page.text
    assert "\\x1b[2J\\x1b[31mred" in page.text
    body = page.source.partition("<body>")[2].partition("<script")[0]
    assert not re.search(r"[\x00-\x08\x0b-\x1f\x7f-\x9f\u202a-\u202e\u2066-\u2069]", body)
    for text in strings(list(page.data.values())):
        assert not re.search(r"[\x00-\x1f\x7f-\x9f\u202a-\u202e\u2066-\u2069\ud800-\udfff]", text)
        assert set(re.findall(r"<[^>]*>", text)) <= {"<br>", "<b>", "</b>", "<extra>", "</extra>"}


def test_hostile_strings_from_anywhere_are_only_shown() -> None:
    report_data = report_data_of(CAPTURES / "slave-mode-lost.pcapng")
    finding = make_finding("rule", Severity.ERROR, HOSTILE, (1,), None, HOSTILE, HOSTILE)
    hostile = Conversation(Endpoint(HOSTILE, 1), Endpoint(HOSTILE, 2), Transport.UDP, SERVER_PORT)
    lanes = tuple(replace(timeline, conversation=hostile) for timeline in report_data.timelines)
    sessions = tuple(replace(session, conversation=hostile) for session in report_data.slave_sessions)
    hostile_data = replace(report_data, findings=(finding,), timelines=lanes, slave_sessions=sessions)
    page = Page(report_page(hostile_data, [HOSTILE], HOSTILE, [HOSTILE]))
    clean = page_of("slave-mode-lost.pcapng")
    assert "alert(1)" not in page.source.replace("&lt;script&gt;alert(1)", "").replace(
        "\\u0026lt;script\\u0026gt;alert(1)", ""
    )
    assert len(page.of("script")) == len(clean.of("script"))
    assert page.of("img") == []
    assert page.unclosed == []
    assert page.text.count("<img src=x onerror=alert(2)>") >= 6
    ticks = page.data["timeline-data"]["layout"]["yaxis"]["ticktext"]
    assert "&lt;script&gt;alert(1)" in ticks[0]


def test_a_page_without_trouble_or_slave_mode_has_no_empty_sections() -> None:
    page = page_of("vlan-ipv6.pcap")
    assert not {"slave", "damage", "retries"} & set(page.ids)
    assert {"summary", "findings", "timeline", "calls"} <= set(page.ids)


def test_remarks_and_names_are_on_the_page() -> None:
    report_data = report_data_of(CAPTURES / "retry-story.pcapng")
    page = Page(report_page(report_data, ["a.pcap", "b.pcap"], "9.8", ["One is damaged."]))
    assert "One is damaged." in page.text
    assert "b-CAP report: a.pcap, b.pcap" in page.text
    assert "Made by bcapscope 9.8." in page.text


def test_json_has_no_numbers_that_are_none() -> None:
    for name in ALL:
        text = json.dumps(page_of(name).data)
        assert "NaN" not in text
        assert "Infinity" not in text


@given(st.text())
def test_any_text_is_text(text: str) -> None:
    page = Page(template_environment().from_string("<p>{{ text }}</p>").render(text=text))
    assert page.tags == [("p", {})]
    assert page.text == printable(text)


@given(st.text())
def test_any_attribute_is_one(text: str) -> None:
    source = template_environment().from_string('<a href="{{ text }}" class="x"></a>').render(text=text)
    page = Page(source)
    assert page.tags == [("a", {"href": printable(text), "class": "x"})]
    assert page.text == ""


def test_control_characters_become_visible() -> None:
    source = template_environment().from_string("<p>{{ text }}</p>").render(text="\x1b[2J\u202e\n")
    assert Page(source).text == "\\x1b[2J\\u202e\\n"


def elements() -> Any:
    return template_environment().get_template("elements.html").module


def test_a_table_has_its_caption_and_sides() -> None:
    source = (
        "{% from 'elements.html' import number, table, text %}"
        "{% call table(words, 'All <of> it.', 'client calls>') %}"
        "{{ text('a&b') }}{{ number(3) }}{% endcall %}"
    )
    made = template_environment().from_string(source).render(words=ENGLISH_WORDS)
    assert "<caption>All &lt;of&gt; it.</caption>" in made
    assert '<th scope="col" class="t">client</th><th scope="col" class="n">calls</th>' in made
    assert '<td class="t">a&amp;b</td><td class="n">3</td>' in made


def test_the_ends_of_a_conversation_are_escaped() -> None:
    ends = Conversation(Endpoint("<a>", 1), Endpoint("b", 2), Transport.UDP, SERVER_PORT)
    made = elements().ends(ends)
    assert made == '<span class="ends">&lt;a&gt;:1</span> → <span class="ends">b:2 UDP</span>'


def test_facts_are_a_list_of_definitions() -> None:
    made = elements().facts([("a", "1"), ("b", "<")], "tiles")
    text = "".join(made.split("\n"))
    expected = "<dl><div><dt>a</dt><dd>1</dd></div><div><dt>b</dt><dd>&lt;</dd></div></dl>"
    assert text == f'<div class="tiles">{expected}</div>'
