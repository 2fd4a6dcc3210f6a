"""Pictures of stays in slave mode."""

from __future__ import annotations

from dataclasses import replace

from bcapscope.messages import ENGLISH_WORDS, Language, MessageFormatter
from bcapscope.render.report_slave_sessions import session_pictures
from tests.render.reports import CAPTURES, page_of, report_data_of


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


def test_a_long_stay_says_what_a_point_stands_for() -> None:
    report_data = report_data_of(CAPTURES / "slave-session.pcapng")
    (stay,) = report_data.slave_sessions
    runs = tuple(sample._replace(points=32, cycle_least=1.0) for sample in stay.samples)
    long = replace(stay, samples=runs)
    drawn = session_pictures(long, report_data.start, ENGLISH_WORDS)[0]
    assert "Each point stands for up to 32 set points" in drawn.caption
    assert '"name":"shortest cycle"' in drawn.json
    assert '"name":"longest cycle"' in drawn.json


def test_marks_that_are_not_all_say_so() -> None:
    report_data = report_data_of(CAPTURES / "slave-mode-lost.pcapng")
    (stay,) = report_data.slave_sessions
    more = replace(stay, timing=replace(stay.timing, gaps=99), buffer=replace(stay.buffer, underflows=98))
    drawn = session_pictures(more, report_data.start, ENGLISH_WORDS)[0]
    assert drawn.caption.endswith(
        "The first 1 of 99 gaps are marked. The first 1 of 98 times that the buffer ran empty are marked."
    )


def test_a_stay_without_set_points_has_no_pictures() -> None:
    (stay,) = report_data_of(CAPTURES / "slave-session.pcapng").slave_sessions
    timing = replace(stay.timing, cycle=None, latency=None)
    empty = replace(stay, samples=(), motion=None, timing=timing)
    assert session_pictures(empty, 0, ENGLISH_WORDS) == []


def test_pictures_are_in_the_readers_language() -> None:
    report_data = report_data_of(CAPTURES / "slave-mode-lost.pcapng")
    (session,) = report_data.slave_sessions
    japanese = MessageFormatter(Language.JAPANESE)
    pace, spread, motion = session_pictures(session, report_data.start, japanese)
    assert (pace.title, spread.title) == ("区間 1: 指令値のタイミング", "区間 1: サイクルと応答時間の分布")
    assert "公称サイクル 8 ms" in pace.caption
    assert "バッファが空" in pace.json
    assert "遅れます" in motion.caption
