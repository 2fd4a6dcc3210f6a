"""Serials stand for the call that had them last."""

from __future__ import annotations

from bcapscope.traffic.call import Call
from bcapscope.traffic.observation import Transport
from bcapscope.traffic.recent_serials import MAX_SERIALS
from bcapscope.traffic.serial_table import MAX_REUSED, SerialTable
from tests.traffic.playbook import MOVE, Script, calls_of


def made(*serials: int) -> Call:
    """Return a call whose first attempt and retries have these serials."""
    script = Script()
    client = script.client()
    for place, serial in enumerate(serials):
        client.ask(2 * place, serial, serials[0] if place else 0, MOVE)
    (call,) = calls_of(script.track())
    return call


def test_a_released_serial_names_its_settled_call() -> None:
    table, call = SerialTable(), made(5, 6)
    table.open_calls.update({5: call, 6: call})
    assert table.settled_call(5) is None
    table.release_all(call)
    assert table.open_calls == {}
    assert (table.settled_call(5), table.settled_call(6), table.settled_call(7)) == (1, 1, None)


def test_a_serial_that_a_later_call_has_is_not_taken_from_it() -> None:
    table, earlier, later = SerialTable(), made(5), made(5)
    table.open_calls[5] = later
    table.release(5, earlier)
    assert table.open_calls == {5: later}


def test_settled_serials_are_bounded_and_the_latest_are_kept() -> None:
    table, call = SerialTable(), made(1)
    for serial in range(3 * MAX_SERIALS):
        table.release(serial, call)
    known = [serial for serial in range(3 * MAX_SERIALS) if table.settled_call(serial)]
    assert known[-1] == 3 * MAX_SERIALS - 1
    assert MAX_SERIALS <= len(known) <= 2 * MAX_SERIALS


def test_requests_that_reuse_a_serial_are_answered_in_order() -> None:
    script = Script()
    client = script.client(transport=Transport.TCP)
    client.ask(0, 5, 0, MOVE)
    client.ask(9, 5, 0, MOVE)
    first, second = calls_of(script.track())
    table = SerialTable()
    for call in (first, second):
        table.queue_reused(5)
        table.open_calls[5] = call
    assert table.reused == {5: [first]}
    assert table.oldest_reused(5, is_answered=False) is first
    table.release(5, first)
    assert table.open_calls == {5: second}
    assert table.oldest_reused(5, is_answered=True) == first.number
    assert table.reused == {}


def test_reused_serials_are_bounded_and_the_oldest_is_dropped_first() -> None:
    table, call = SerialTable(), made(1)
    for serial in range(MAX_REUSED + 1):
        assert list(table.reused) == list(range(serial))
        table.open_calls[serial] = call
        table.queue_reused(serial)
    assert list(table.reused) == list(range(1, MAX_REUSED + 1))


def test_the_earliest_of_several_waiting_calls_is_answered_first() -> None:
    table, calls = SerialTable(), [made(5) for _ in range(3)]
    for call in calls:
        table.open_calls[5] = call
        table.queue_reused(5)
    assert [table.oldest_reused(5, is_answered=True) for _ in calls] == calls
