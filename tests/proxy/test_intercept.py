"""What is held, for how long, and what never is."""

from __future__ import annotations

import pytest

from bcapscope.faults.message import Message
from bcapscope.faults.quantities import Condition
from bcapscope.protocol.frame import encode
from bcapscope.protocol.variant import VT, Variant
from bcapscope.proxy.intercept import Intercept
from bcapscope.traffic.observation import Flow
from bcapscope.traffic.question import Questions
from tests.faults.traffic import reply, request, talk

FLOWS = talk()


def message(flow: Flow, raw: bytes, now: int = 0) -> Message:
    """Make a message on its way."""
    made = Message(1, flow, raw, now, now)
    made.ask(Questions())
    return made


def test_nothing_is_held_without_a_filter() -> None:
    intercept = Intercept()
    assert not intercept.wants(message(FLOWS.up, request(1)))
    intercept.set(Condition.read("serial == 1"))
    assert intercept.wants(message(FLOWS.up, request(1)))
    assert intercept.wants(message(FLOWS.down, reply(1)))
    assert not intercept.wants(message(FLOWS.up, request(2)))
    intercept.set(None)
    assert not intercept.wants(message(FLOWS.up, request(1)))


@pytest.mark.parametrize(
    "raw",
    [
        encode(1, 0, 70, (Variant(VT.I4, 1),)),
        encode(1, 0, 2),
        encode(1, 0, 64, (Variant(VT.I4, 1), Variant(VT.BSTR, "slvChangeMode"), Variant(VT.I4, 0))),
    ],
    ids=["Robot_Halt", "Service_Stop", "slvChangeMode 0"],
)
def test_what_stops_or_lets_go_is_never_held_but_its_answer_may_be(raw: bytes) -> None:
    intercept = Intercept(Condition.read("true"))
    assert not intercept.wants(message(FLOWS.up, raw))
    assert not intercept.wants(message(FLOWS.up, request(1) + raw))
    assert intercept.wants(message(FLOWS.down, reply(1)))


def test_each_waits_as_long_as_was_said_when_it_came() -> None:
    intercept = Intercept(Condition.read("true"), patience=10)
    first = intercept.hold(1, message(FLOWS.up, request(1), now=5))
    intercept.patience = 3
    second = intercept.hold(2, message(FLOWS.down, reply(1), now=6))
    assert [(each.number, each.until) for each in intercept.held] == [(1, 15), (2, 9)]
    assert intercept.due() == 9
    assert (intercept.holds(FLOWS.up), intercept.holds(FLOWS.down)) == (True, True)
    assert intercept.expired(8) == []
    assert intercept.expired(9) == [second]
    assert intercept.release(1) == first
    assert intercept.due() is None
    with pytest.raises(KeyError):
        intercept.release(1)


def test_what_a_client_has_left_behind_is_dropped() -> None:
    intercept = Intercept(Condition.read("true"))
    intercept.hold(1, message(FLOWS.up, request(1)))
    kept = intercept.hold(2, message(FLOWS.up, request(2)))
    intercept.forget(1)
    assert intercept.held == [kept]
    assert intercept.count == 2
