"""What a report tells of captures."""

from __future__ import annotations

from bcapscope.analysis import report_data as module
from bcapscope.analysis.report_data import (
    MAX_DAMAGED,
    MAX_RETRY_CHAINS,
    MAX_TIMELINES,
    ReportData,
    ReportDataBuilder,
)
from bcapscope.analysis.timeline_events import TimelineEventKind
from bcapscope.protocol.codec.frame import Frame, Malformed
from bcapscope.protocol.tables.hresult import E_FAIL, E_NOT_IN_SLAVE_MODE
from bcapscope.traffic.call_verdict import CallVerdict
from bcapscope.traffic.observation import Direction
from tests.samples.problems import problem_of
from tests.traffic.playbook import MOVE, MS, START, START_SERVICE, Script, execute, run_pipeline, slv_move


def tell(script: Script) -> ReportData:
    builder = ReportDataBuilder()
    run_pipeline(script.seen, builder.diagnosis, builder)
    data = builder.report_data()
    assert data is not None
    return data


def test_nothing_seen_is_no_account() -> None:
    assert ReportDataBuilder().report_data() is None


def test_a_small_session() -> None:
    script = Script()
    client = script.client()
    client.ask(0, 1, 1, START_SERVICE)
    client.reply(1, 1)
    client.ask(10, 2, 2, MOVE)
    client.reply(11, 2)
    client.ask(18, 3, 3, slv_move(*[1.0] * 8))
    client.reply(19, 3, 0, E_NOT_IN_SLAVE_MODE)
    told = tell(script)
    assert (told.start, told.end) == (START, START + 19 * MS)
    assert (told.totals.frames, told.totals.calls, told.totals.clients) == (6, 3, 1)
    assert told.statistics is not None
    assert told.statistics.total.figures.refused == 1
    assert [stay.number for stay in told.slave_sessions] == [1]
    assert any(finding.rule == "slvmove-outside-slave-mode" for finding in told.findings)
    (lane,) = told.timelines
    assert lane.calls == 3
    (spell,) = lane.activity
    assert (spell.begin, spell.end, spell.occurrences) == (START, START + 19 * MS, 3)
    assert set(lane.events) == {TimelineEventKind.REFUSED}
    (mark,) = lane.events[TimelineEventKind.REFUSED]
    assert (mark.frame, mark.hresult) == (5, E_NOT_IN_SLAVE_MODE)
    assert (told.retry_chains, told.retried_calls, told.stray_replies, told.damaged_frames) == ((), 0, 0, ())


def test_what_happened_has_marks() -> None:
    script = Script()
    client = script.client()
    client.ask(0, 1, 1, execute("Motor"))
    client.ask(16, 2, 1, execute("Motor"))
    client.reply(17, 1)
    client.reply(18, 2)
    client.ask(20, 3, 3, execute("CurJnt"))
    client.ask(30, 4, 4, execute("Other"))
    client.reply(31, 4)
    outside = problem_of(0, "soh", "bytes outside of any frame")
    client.see(40, Direction.REQUEST, Malformed(b"\x02", (outside,)))
    client.see(50, Direction.RESPONSE, Malformed(b"", (), 99))
    client.reply(60, 77, 0, E_FAIL)
    told = tell(script)
    kinds = {kind: [mark.frame for mark in marks] for kind, marks in told.timelines[0].events.items()}
    assert kinds == {
        TimelineEventKind.LATE: [1],
        TimelineEventKind.UNANSWERED: [5],
        TimelineEventKind.DAMAGED: [8],
        TimelineEventKind.MISSING: [9],
    }
    assert told.verdicts == {CallVerdict.REPLY_LATE: 1, CallVerdict.UNANSWERED: 1}
    assert [call.number for call in told.retry_chains] == [1]
    assert told.stray_replies == 1
    assert [(each.frame, each.missing_bytes, each.raw) for each in told.damaged_frames] == [
        (8, 0, b"\x02"),
        (9, 99, b""),
    ]
    assert told.damaged_count == 2


def test_the_worst_chains_are_kept_in_order_of_time() -> None:
    script = Script()
    client = script.client()
    serial = 0
    tries = [1 + number % 5 for number in range(40)]
    for number, count in enumerate(tries):
        first = serial + 1
        for attempt in range(count):
            serial += 1
            client.ask(100 * number + 10 * attempt, serial, first, MOVE)
        client.reply(100 * number + 60, serial)
    told = tell(script)
    assert told.retried_calls == sum(count > 1 for count in tries)
    assert len(told.retry_chains) == MAX_RETRY_CHAINS
    worst = sorted(count - 1 for count in tries)[-MAX_RETRY_CHAINS:]
    assert sorted(call.retries for call in told.retry_chains) == worst
    assert [call.number for call in told.retry_chains] == sorted(call.number for call in told.retry_chains)


def test_frames_with_problems_are_damaged_whatever_they_are() -> None:
    script = Script()
    client = script.client()
    sound = client.ask(0, 1, 1, MOVE)
    assert isinstance(sound.item, Frame)
    for number in range(30):
        client.see(1 + number, Direction.REQUEST, Frame(sound.item.raw[:-1] + b"\x05"))
    told = tell(script)
    assert told.damaged_count == 30
    assert [each.frame for each in told.damaged_frames] == list(range(2, 2 + MAX_DAMAGED))
    assert told.damaged_frames[0].problems
    assert len(told.damaged_frames[0].raw) == module.MAX_DAMAGED_BYTES


def test_many_clients() -> None:
    script = Script()
    for port in range(MAX_TIMELINES + 9):
        client = script.client(1000 + port)
        client.ask(port, 1, 1, START_SERVICE)
        client.reply(port + 0.5, 1)
    told = tell(script)
    assert (len(told.timelines), told.timelines_left_off) == (MAX_TIMELINES, 9)
