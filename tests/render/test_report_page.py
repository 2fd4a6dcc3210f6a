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

from bcapscope.analysis.finding import Finding, Severity
from bcapscope.analysis.marks import MarkKind
from bcapscope.render.report_page import report_page
from bcapscope.render.report_sections import MOST_DRAWN, MOST_ROWS, drawn_stays
from bcapscope.traffic.observation import Conversation, Endpoint, Transport
from tests.render.reports import CAPTURES, Page, account_of, page_of

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
    account = account_of(CAPTURES / "slave-mode-lost.pcapng")
    finding = Finding("rule", Severity.ERROR, HOSTILE, (1,), None, HOSTILE, HOSTILE)
    hostile = Conversation(Endpoint(HOSTILE, 1), Endpoint(HOSTILE, 2), Transport.UDP, HOSTILE)
    lanes = tuple(replace(lane, conversation=hostile) for lane in account.lanes)
    stays = tuple(replace(stay, conversation=hostile) for stay in account.stays)
    poisoned = replace(account, findings=(finding,), lanes=lanes, stays=stays)
    page = Page(report_page(poisoned, [HOSTILE], HOSTILE, [HOSTILE]))
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


def test_findings_stand_under_their_cause() -> None:
    page = page_of("slave-mode-lost.pcapng")
    items = {str(each["id"]): str(each["class"]) for each in page.of("li")}
    assert items["finding-1"] == "finding warning depth-0"
    assert items["finding-2"] == "finding error depth-1"
    assert items["finding-3"] == "finding error depth-2"
    verdict = next(each for each in page.of("div") if "verdict" in str(each.get("class")))
    assert verdict["class"] == "verdict error"


def test_a_clean_capture_says_so() -> None:
    page = page_of("slave-session.pcapng")
    assert "No problem found; 1 note." in page.text
    assert "From 2023-11-14 22:13:20.000 UTC" in page.text
    assert "never, by the model" in page.text


def test_pictures_of_a_stay() -> None:
    page = page_of("slave-session.pcapng")
    assert {"timeline-data", "pace-1-data", "spread-1-data", "motion-1-data", "latencies-data"} == set(
        page.data
    )
    pace = page.data["pace-1-data"]
    assert [trace["name"] for trace in pace["data"]] == ["cycle", "reply", "reserve"]
    assert len(pace["data"][0]["x"]) == 240
    assert pace["layout"]["yaxis"]["title"]["text"] == "cycle, ms"
    assert pace["layout"]["xaxis"]["title"]["text"] == "time since the first frame, s"
    moving = page.data["motion-1-data"]
    assert [trace["name"] for trace in moving["data"]] == ["commanded", "returned"] * 6
    titles = [note["text"].split(" ")[0] for note in moving["layout"]["annotations"]]
    assert titles == [f"<b>J{number}</b>" for number in range(1, 7)]
    assert "J7, J8 did not move" in page.text
    spread = page.data["spread-1-data"]
    assert [sum(trace["y"]) for trace in spread["data"]] == [239, 240]


def test_where_slave_mode_ended_is_drawn() -> None:
    pace = page_of("slave-mode-lost.pcapng").data["pace-1-data"]
    (words,) = pace["layout"]["annotations"]
    assert words["text"] == "error, 0x84201482"
    names = [trace["name"] for trace in pace["data"]]
    assert {"buffer ran empty", "longer than a full buffer lasts"} <= set(names)


def test_the_timeline_has_bars_and_marks() -> None:
    data = page_of("slave-mode-lost.pcapng").data["timeline-data"]["data"]
    assert [trace["name"] for trace in data] == ["calls", "slave mode", MarkKind.REFUSED]
    marks = data[2]
    assert len(marks["x"]) == 4
    assert marks["customdata"][0][0].startswith("Robot_Execute slvMove: refused<br>0x84201482, ")
    assert marks["customdata"][0][0].endswith("<br>frame 63")


def test_retry_chains_show_every_frame() -> None:
    data = page_of("retry-story.pcapng").data["chains-data"]["data"]
    seen = {trace["name"]: len(trace["x"]) for trace in data if trace.get("name")}
    assert seen == {"request": 1, "retry": 3, "late reply, discarded": 1, "reply": 1}
    (text,) = data[-1]["customdata"][0] if data[-1]["name"].startswith("late") else data[-2]["customdata"][0]
    assert "serial" in text


def test_two_clients_have_two_lanes() -> None:
    page = page_of("two-robots.pcapng")
    ticks = page.data["timeline-data"]["layout"]["yaxis"]["ticktext"]
    assert ticks[0] == "192.168.0.10:50001<br>→ 192.168.0.1:5007 UDP"
    assert ticks[1].startswith("[fd00:1::a]:50001")
    assert {"pace-1-data", "pace-2-data"} <= set(page.data)


def test_holes_in_a_capture_are_told() -> None:
    page = page_of("tcp-gap.pcap")
    assert "198 bytes missing in the capture" in page.text
    assert MarkKind.MISSING in [trace.get("name") for trace in page.data["timeline-data"]["data"]]


def test_a_page_without_trouble_or_slave_mode_has_no_empty_sections() -> None:
    page = page_of("vlan-ipv6.pcap")
    assert not {"slave", "damage", "retries"} & set(page.ids)
    assert {"summary", "findings", "timeline", "calls"} <= set(page.ids)


def test_remarks_and_names_are_on_the_page() -> None:
    account = account_of(CAPTURES / "retry-story.pcapng")
    page = Page(report_page(account, ["a.pcap", "b.pcap"], "9.8", ["One is damaged."]))
    assert "One is damaged." in page.text
    assert "b-CAP report: a.pcap, b.pcap" in page.text
    assert "Made by bcapscope 9.8." in page.text


def test_of_many_stays_the_ones_with_trouble_are_drawn() -> None:
    (bad,) = account_of(CAPTURES / "slave-mode-lost.pcapng").stays
    account = account_of(CAPTURES / "slave-session.pcapng")
    (good,) = account.stays
    stays = tuple(replace(bad if number == 50 else good, number=number) for number in range(1, 61))
    drawn = drawn_stays(stays)
    assert len(drawn) == MOST_DRAWN
    assert 50 in [stay.number for stay in drawn]
    page = Page(report_page(replace(account, stays=stays), ["x"], "1"))
    assert f"The first {MOST_ROWS} of 60 stays in slave mode." in page.text
    assert f"Pictures follow of the {MOST_DRAWN} with most trouble." in page.text
    assert len([name for name in page.data if name.startswith("pace-")]) == MOST_DRAWN


def test_json_has_no_numbers_that_are_none() -> None:
    for name in ALL:
        text = json.dumps(page_of(name).data)
        assert "NaN" not in text
        assert "Infinity" not in text
