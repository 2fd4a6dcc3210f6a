"""What a report tells of captures."""

from __future__ import annotations

from bcapscope.analysis import account as module
from bcapscope.analysis.account import MOST_CHAINS, MOST_DAMAGED, MOST_LANES, Account, Accountant
from bcapscope.analysis.marks import MarkKind
from bcapscope.protocol.frame import Frame, Malformed
from bcapscope.protocol.hresult import E_FAIL, E_NOT_IN_SLAVE_MODE
from bcapscope.traffic.observation import Direction
from bcapscope.traffic.tracker import Tracker
from bcapscope.traffic.verdict import Verdict
from tests.traffic.playbook import MOVE, MS, START, START_SERVICE, Script, execute, slv_move


def tell(script: Script) -> Account:
    accountant, tracker = Accountant(), Tracker()
    for seen in script.seen:
        accountant.take_observation(seen)
        for settled in tracker.observe(seen):
            accountant.take(settled)
    for settled in tracker.close():
        accountant.take(settled)
    account = accountant.finish()
    assert account is not None
    return account


def test_nothing_seen_is_no_account() -> None:
    assert Accountant().finish() is None


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
    assert (told.seen.frames, told.seen.calls, told.seen.clients) == (6, 3, 1)
    assert told.statistics is not None
    assert told.statistics.total.figures.refused == 1
    assert [stay.number for stay in told.stays] == [1]
    assert any(finding.rule == "slvmove-outside-slave-mode" for finding in told.findings)
    (lane,) = told.lanes
    assert lane.calls == 3
    (spell,) = lane.spells
    assert (spell.begin, spell.end, spell.times) == (START, START + 19 * MS, 3)
    assert set(lane.marks) == {MarkKind.REFUSED}
    (mark,) = lane.marks[MarkKind.REFUSED]
    assert (mark.frame, mark.hresult) == (5, E_NOT_IN_SLAVE_MODE)
    assert (told.chains, told.retried, told.strays, told.damaged) == ((), 0, 0, ())


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
    client.see(40, Direction.REQUEST, Malformed(b"\x02", ()))
    client.see(50, Direction.RESPONSE, Malformed(b"", (), 99))
    client.reply(60, 77, 0, E_FAIL)
    told = tell(script)
    kinds = {kind: [mark.frame for mark in marks] for kind, marks in told.lanes[0].marks.items()}
    assert kinds == {
        MarkKind.LATE: [1],
        MarkKind.UNANSWERED: [5],
        MarkKind.DAMAGED: [8],
        MarkKind.MISSING: [9],
    }
    assert told.verdicts == {Verdict.REPLY_LATE: 1, Verdict.UNANSWERED: 1}
    assert [call.call for call in told.chains] == [1]
    assert told.strays == 1
    assert [(each.frame, each.missing, each.raw) for each in told.damaged] == [(8, 0, b"\x02"), (9, 99, b"")]
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
    assert told.retried == sum(count > 1 for count in tries)
    assert len(told.chains) == MOST_CHAINS
    worst = sorted(count - 1 for count in tries)[-MOST_CHAINS:]
    assert sorted(call.retries for call in told.chains) == worst
    assert [call.call for call in told.chains] == sorted(call.call for call in told.chains)


def test_frames_with_problems_are_damaged_whatever_they_are() -> None:
    script = Script()
    client = script.client()
    sound = client.ask(0, 1, 1, MOVE)
    assert isinstance(sound.item, Frame)
    for number in range(30):
        client.see(1 + number, Direction.REQUEST, Frame(sound.item.raw[:-1] + b"\x05"))
    told = tell(script)
    assert told.damaged_count == 30
    assert [each.frame for each in told.damaged] == list(range(2, 2 + MOST_DAMAGED))
    assert told.damaged[0].problems
    assert len(told.damaged[0].raw) == module.MOST_BYTES


def test_many_clients() -> None:
    script = Script()
    for port in range(MOST_LANES + 9):
        client = script.client(1000 + port)
        client.ask(port, 1, 1, START_SERVICE)
        client.reply(port + 0.5, 1)
    told = tell(script)
    assert (len(told.lanes), told.lanes_left_off) == (MOST_LANES, 9)
