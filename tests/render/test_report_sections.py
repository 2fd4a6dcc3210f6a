"""The sections of a report."""

from __future__ import annotations

from dataclasses import replace

from bcapscope.analysis.timeline_events import TimelineEventKind
from bcapscope.render.report_page import MAX_DRAWN, MAX_ROWS, drawn_slave_sessions, report_page
from tests.render.reports import CAPTURES, Page, page_of, report_data_of


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
    assert "never, as estimated" in page.text


def test_holes_in_a_capture_are_told() -> None:
    page = page_of("tcp-gap.pcap")
    assert "198 bytes missing in the capture" in page.text
    assert str(TimelineEventKind.MISSING.message) in [
        trace.get("name") for trace in page.data["timeline-data"]["data"]
    ]


def test_of_many_stays_the_ones_with_trouble_are_drawn() -> None:
    (bad,) = report_data_of(CAPTURES / "slave-mode-lost.pcapng").slave_sessions
    report_data = report_data_of(CAPTURES / "slave-session.pcapng")
    (good,) = report_data.slave_sessions
    sessions = tuple(replace(bad if number == 50 else good, number=number) for number in range(1, 61))
    drawn = drawn_slave_sessions(sessions)
    assert len(drawn) == MAX_DRAWN
    assert 50 in [session.number for session in drawn]
    page = Page(report_page(replace(report_data, slave_sessions=sessions), ["x"], "1"))
    assert f"Slave-mode sessions. The first {MAX_ROWS} of 60." in page.text
    assert f"Pictures of the {MAX_DRAWN} with the most problems follow." in page.text
    assert len([name for name in page.data if name.startswith("pace-")]) == MAX_DRAWN


def test_refusals_have_their_meaning_and_what_to_do() -> None:
    text = page_of("slave-mode-lost.pcapng").text
    assert "What the controller refused, and why." in text
    assert "slvMove while slave mode is off" in text


def test_what_slave_says_is_there_in_full() -> None:
    page = page_of("slave-session.pcapng")
    assert len(page.of("pre")) == 1
    assert "Slave-mode session 1  192.168.0.10:50001 > 192.168.0.1:5007 udp" in page.text
