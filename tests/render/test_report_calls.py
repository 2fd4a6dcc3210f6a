"""Pictures of calls."""

from __future__ import annotations

from dataclasses import replace

from bcapscope.analysis.timeline_events import TimelineEventKind
from bcapscope.messages import ENGLISH_WORDS
from bcapscope.render.report_calls import (
    MAX_TIMELINE_ROWS,
    latency_picture,
    retry_chain_picture,
    timeline_picture,
)
from tests.render.reports import CAPTURES, page_of, report_data_of


def test_the_timeline_has_bars_and_marks() -> None:
    data = page_of("slave-mode-lost.pcapng").data["timeline-data"]["data"]
    assert [trace["name"] for trace in data] == [
        "calls",
        "slave mode",
        str(TimelineEventKind.REFUSED.message),
    ]
    marks = data[2]
    assert len(marks["x"]) == 4
    assert marks["customdata"][0][0].startswith("Robot_Execute slvMove: refused<br>0x84201482, ")
    assert marks["customdata"][0][0].endswith("<br>frame 63, at 0.312 s")


def test_retry_chains_show_every_frame() -> None:
    data = page_of("retry-story.pcapng").data["chains-data"]["data"]
    seen = {trace["name"]: len(trace["x"]) for trace in data if trace.get("name")}
    assert seen == {"request": 1, "retry": 3, "late reply": 1, "reply": 1}
    (text,) = data[-1]["customdata"][0] if data[-1]["name"].startswith("late") else data[-2]["customdata"][0]
    assert "serial" in text


def test_two_clients_have_two_lanes() -> None:
    page = page_of("two-robots.pcapng")
    ticks = page.data["timeline-data"]["layout"]["yaxis"]["ticktext"]
    assert ticks[0] == "192.168.0.10:50001<br>→ 192.168.0.1:5007 UDP"
    assert ticks[1].startswith("[fd00:1::a]:50001")
    assert {"pace-1-data", "pace-2-data"} <= set(page.data)


def test_clients_without_a_lane_are_counted() -> None:
    report_data = report_data_of(CAPTURES / "retry-story.pcapng")
    many = replace(
        report_data, timelines=report_data.timelines * (MAX_TIMELINE_ROWS + 3), timelines_left_off=4
    )
    assert "7 more clients made fewer calls." in timeline_picture(many, ENGLISH_WORDS).caption


def test_chains_beyond_those_drawn_are_counted() -> None:
    report_data = report_data_of(CAPTURES / "retry-story.pcapng")
    drawn = retry_chain_picture(replace(report_data, retried_calls=5), ENGLISH_WORDS)
    assert drawn is not None
    assert drawn.caption.endswith("These are the 1 calls with the most retries; 4 more calls have retries.")
    assert retry_chain_picture(replace(report_data, retry_chains=(), retried_calls=0), ENGLISH_WORDS) is None


def test_latencies_by_command() -> None:
    page = page_of("slave-session.pcapng")
    picture = page.data["latencies-data"]
    assert picture["layout"]["xaxis"]["type"] == "log"
    assert picture["layout"]["yaxis"]["ticktext"][-1] == "Robot_Execute slvMove"
    texts = {trace["name"]: trace["customdata"] for trace in picture["data"] if "customdata" in trace}
    assert texts["median"][-1][0].startswith("Robot_Execute slvMove<br>240 of 240 answered<br>median 7.8")
    assert len(texts["99.9%"]) == 1
    assert latency_picture((), ENGLISH_WORDS) is None
