"""What is held, for how long, and what never is; retries are held with the call that they belong to."""

from __future__ import annotations

import pytest

from bcapscope.faults.quantities import FrameCondition
from bcapscope.faults.wire_message import WireMessage
from bcapscope.protocol.codec.frame import Frame, encode_frame
from bcapscope.protocol.codec.variant import VT, Variant
from bcapscope.protocol.retry.reserved_convention import ReservedConvention
from bcapscope.proxy.intercept import Intercept, InterceptResult
from bcapscope.traffic.call_kind import RecentRequests
from bcapscope.traffic.observation import Endpoint, Flow, Transport
from bcapscope.traffic.pairing_windows import RETRY_WITHIN_NS
from tests.english import english
from tests.faults.traffic import reply, request, talk

FLOWS = talk()
TRIES = {
    ReservedConvention.SEED: [(5, 0), (6, 5), (7, 5), (8, 5)],
    ReservedConvention.OWN: [(5, 5), (6, 5), (7, 5), (8, 5)],
    ReservedConvention.CHAIN: [(5, 0), (6, 5), (7, 6), (8, 7)],
}
"""Serial and reserved of the tries of one call."""


def message(flow: Flow, raw: bytes, now: int = 0) -> WireMessage:
    """Make a message on its way."""
    made = WireMessage(1, flow, raw, now, now)
    made.annotate(RecentRequests())
    return made


def consider(intercept: Intercept, raw: bytes, *, up: bool = True, now: int = 0) -> InterceptResult | None:
    """Show a message to an intercept."""
    return intercept.hold_or_pass(1, message(FLOWS.up if up else FLOWS.down, raw, now))


def with_english(result: InterceptResult | None) -> tuple[str, bytes | None]:
    """Return a result with its note as text."""
    assert result is not None
    return str(result[0]), result[1]


def test_nothing_is_held_without_a_filter() -> None:
    intercept = Intercept()
    assert consider(intercept, request(1)) is None
    intercept.set_condition(FrameCondition.read("serial == 1"))
    result = consider(intercept, request(1))
    assert with_english(result) == ("intercept: held as 1", None)
    result = consider(intercept, reply(1), up=False)
    assert with_english(result) == ("intercept: held as 2", None)
    assert consider(intercept, request(2)) is None
    intercept.set_condition(None)
    assert consider(intercept, request(3)) is None


@pytest.mark.parametrize(
    "raw",
    [
        encode_frame(1, 0, 70, (Variant(VT.I4, 1),)),
        encode_frame(1, 0, 2),
        encode_frame(1, 0, 64, (Variant(VT.I4, 1), Variant(VT.BSTR, "slvChangeMode"), Variant(VT.I4, 0))),
    ],
    ids=["Robot_Halt", "Service_Stop", "slvChangeMode 0"],
)
def test_what_stops_or_lets_go_is_never_held_but_its_answer_may_be(raw: bytes) -> None:
    intercept = Intercept(FrameCondition.read("true"))
    for whole in (raw, request(1) + raw, raw + b"garbage"):
        assert consider(intercept, whole) is None
    assert consider(intercept, reply(1), up=False)


def test_each_waits_as_long_as_was_said_when_it_came() -> None:
    intercept = Intercept(FrameCondition.read("true"), hold_time=10)
    consider(intercept, request(1), now=5)
    intercept.hold_time = 3
    consider(intercept, reply(1), up=False, now=6)
    first, second = intercept.held
    assert [(each.number, each.until) for each in intercept.held] == [(1, 15), (2, 9)]
    assert intercept.due() == 9
    assert (intercept.holds(FLOWS.up), intercept.holds(FLOWS.down)) == (True, True)
    assert intercept.pop_expired(8) == []
    assert intercept.pop_expired(9) == [second]
    assert intercept.release(1, 10) == first
    assert intercept.due() is None
    with pytest.raises(KeyError):
        intercept.release(1, 10)


def test_what_is_held_of_one_direction_can_be_taken_back() -> None:
    intercept = Intercept(FrameCondition.read("true"))
    consider(intercept, request(1))
    consider(intercept, reply(1), up=False)
    first, second = intercept.held
    assert intercept.remove_held(FLOWS.up) == [first]
    assert intercept.held == [second]
    assert intercept.held_so_far == 2


@pytest.mark.parametrize("tries", TRIES.values(), ids=list(TRIES))
def test_retries_are_held_with_their_call(tries: list[tuple[int, int]]) -> None:
    intercept = Intercept(FrameCondition.read("serial == 5"))
    for place, (serial, reserved) in enumerate(tries):
        consider(intercept, request(serial, reserved=reserved), now=place)
    (held,) = intercept.held
    assert (held.number, held.repeats, held.since) == (1, 3, 0)
    assert held.data == request(8, reserved=tries[-1][1])  # the one whose answer the client takes


def test_a_copy_of_what_is_held_is_held_with_it() -> None:
    intercept = Intercept(FrameCondition.read("serial == 5"))
    consider(intercept, request(5))
    note = "intercept: held with 1, because it is a retry of it"
    assert with_english(consider(intercept, request(5))) == (note, None)


@pytest.mark.parametrize("tries", TRIES.values(), ids=list(TRIES))
@pytest.mark.parametrize("decision", ["forward", "edit", "drop"])
def test_what_is_decided_holds_for_later_retries(decision: str, tries: list[tuple[int, int]]) -> None:
    intercept = Intercept(FrameCondition.read("command == slvMove"))
    (first, named), (second, reserved), *_ = tries
    consider(intercept, request(first, reserved=named))
    edited = request(first, reserved=named, values=(9.0,))
    intercept.release(1, 10, {"forward": None, "edit": edited, "drop": b""}[decision])
    found = consider(intercept, request(second, reserved=reserved), now=20)
    assert found is not None
    assert intercept.held == []
    if decision == "drop":
        assert found[1] is None
    else:
        values = (9.0,) if decision == "edit" else ()
        assert found[1] == request(second, reserved=reserved, values=values)
    other = consider(intercept, request(100, values=(7.0,)), now=30)
    assert with_english(other) == ("intercept: held as 2", None)


def test_a_decision_is_forgotten_when_no_retry_can_come() -> None:
    intercept = Intercept(FrameCondition.read("serial == 5"))
    consider(intercept, request(5))
    intercept.set_condition(None)
    intercept.release(1, 0, b"")
    assert consider(intercept, request(6, reserved=5), now=RETRY_WITHIN_NS) is not None
    assert consider(intercept, request(7, reserved=5), now=3 * RETRY_WITHIN_NS) is None
    assert intercept.is_idle


def test_a_decision_lasts_while_retries_come() -> None:
    intercept = Intercept(FrameCondition.read("serial == 5"))
    consider(intercept, request(5))
    intercept.release(1, 0, b"")
    for serial in (6, 7, 8):
        result = consider(intercept, request(serial, reserved=5), now=(serial - 5) * RETRY_WITHIN_NS)
        assert result is not None
        assert result[1] is None


def test_the_same_request_after_a_decision_is_a_new_call() -> None:
    intercept = Intercept(FrameCondition.read("serial == 5"))
    consider(intercept, request(5))
    intercept.release(1, 0, b"")
    assert with_english(consider(intercept, request(5))) == ("intercept: held as 2", None)


@pytest.mark.parametrize("is_closed", [False, True])
def test_a_client_that_comes_again_makes_new_calls(is_closed: bool) -> None:
    intercept = Intercept(FrameCondition.read("command == slvMove"))
    consider(intercept, request(5))
    intercept.release(1, 0, b"")
    if is_closed:
        intercept.close_conversation(FLOWS.up.conversation)
    consider(intercept, request(6, reserved=5))
    assert len(intercept.held) == is_closed


def test_no_more_than_1000_messages_are_held() -> None:
    intercept = Intercept(FrameCondition.read("true"))
    flow = talk(Transport.TCP).up
    for _ in range(1000):
        assert not intercept.is_full
        intercept.hold_or_pass(1, message(flow, request(1)))
    assert intercept.is_full


def test_no_more_than_16_mib_are_held() -> None:
    intercept = Intercept(FrameCondition.read("true"))
    flow = talk(Transport.TCP).up
    for serial in range(4):
        assert not intercept.is_full
        raw = encode_frame(serial, 0, 200, (Variant.array(VT.UI1, bytes((4 << 20) - 26)),))
        assert len(raw) == 4 << 20
        intercept.hold_or_pass(1, message(flow, raw))
    assert intercept.is_full
    note = "intercept: not held, because 4 messages are held already"
    assert with_english(intercept.hold_or_pass(1, message(flow, request(9)))) == (note, request(9))


def test_a_message_is_held_for_a_minute_unless_told_otherwise() -> None:
    intercept = Intercept(FrameCondition.read("true"))
    consider(intercept, request(1), now=7)
    assert intercept.due() == 60_000_000_007


@pytest.mark.parametrize("tries", TRIES.values(), ids=list(TRIES))
def test_a_datagram_is_given_up_when_its_client_asks_no_more(tries: list[tuple[int, int]]) -> None:
    intercept = Intercept(FrameCondition.read("serial == 5"))
    for place, (serial, reserved) in enumerate(tries):
        consider(intercept, request(serial, reserved=reserved), now=place * RETRY_WITHIN_NS)
    consider(intercept, request(tries[-1][0], reserved=tries[-1][1]), now=4 * RETRY_WITHIN_NS)  # a copy
    (held,) = intercept.held
    assert english(held.abandonment_reason(5 * RETRY_WITHIN_NS)) == ""
    assert (
        english(held.abandonment_reason(5 * RETRY_WITHIN_NS + 1)) == "its client has sent no retry for 5.0 s"
    )


def test_packets_of_earlier_calls_and_of_other_clients_give_nothing_up() -> None:
    intercept = Intercept(FrameCondition.read("serial == 5"))
    for raw in (request(3), request(4, reserved=3), request(5)):
        consider(intercept, raw)
    for raw in (request(3), request(4, reserved=3), b"garbage"):  # they were on the way for long
        consider(intercept, raw)
    consider(intercept, reply(4), up=False)
    other = talk(client=Endpoint("10.0.0.3", 50001)).up
    intercept.hold_or_pass(2, message(other, request(9)))
    (held,) = intercept.held
    assert english(held.abandonment_reason(0)) == ""
    consider(intercept, request(6))
    (held,) = intercept.held
    assert english(held.abandonment_reason(0)) == "its client has sent another request since"


def test_on_tcp_who_is_silent_may_wait() -> None:
    intercept = Intercept(FrameCondition.read("serial == 5"))
    flow = talk(Transport.TCP).up
    intercept.hold_or_pass(1, message(flow, request(5)))
    intercept.set_condition(None)
    (held,) = intercept.held
    assert english(held.abandonment_reason(100 * RETRY_WITHIN_NS)) == ""
    assert not intercept.is_idle
    intercept.hold_or_pass(1, message(flow, request(6)))
    (held,) = intercept.held
    assert held.abandonment_reason(0)


def test_answers_to_the_tries_of_a_call_are_one() -> None:
    intercept = Intercept(FrameCondition.read("kind == response"))
    for serial, reserved in TRIES[ReservedConvention.SEED][:2]:
        assert consider(intercept, request(serial, reserved=reserved)) is None
        consider(intercept, reply(serial), up=False)
    (held,) = intercept.held
    assert (Frame(held.data).serial, held.repeats) == (6, 1)


def test_on_tcp_nothing_is_a_retry() -> None:
    intercept = Intercept(FrameCondition.read("true"))
    flow = talk(Transport.TCP).up
    for _ in range(2):
        intercept.hold_or_pass(1, message(flow, request(5)))
    assert len(intercept.held) == 2
