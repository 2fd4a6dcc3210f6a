"""The relay's policy: what becomes of datagrams and of streams cut anyhow, held messages, guard, scripts."""

from __future__ import annotations

from collections.abc import Sequence

import pytest
from hypothesis import given
from hypothesis import strategies as st

from bcapscope.faults.fault_injector import FaultInjector
from bcapscope.faults.fault_notation import read_fault
from bcapscope.faults.quantities import FrameCondition
from bcapscope.messages import Message
from bcapscope.protocol.codec.frame import Frame, encode_frame
from bcapscope.protocol.codec.variant import VT, Variant
from bcapscope.protocol.tables.hresult import E_ACCESSDENIED, E_FAIL
from bcapscope.proxy.intercept import MAX_HELD, Intercept
from bcapscope.proxy.policy import CloseAction, PolicyAction, PolicyDecision, SendAction
from bcapscope.proxy.request_guard import RequestGuard, read_target
from bcapscope.proxy.rule_policy import RulePolicy
from bcapscope.traffic.observation import Direction, Transport
from tests.english import collects, english, with_english
from tests.faults.traffic import MS, reply, request, talk
from tests.proxy.scripting import Here, Listener, Meddler
from tests.strategies import cut, mutated_frames

UP, DOWN = Direction.REQUEST, Direction.RESPONSE
HALT = encode_frame(9, 0, 70, (Variant(VT.I4, 1), Variant(VT.BSTR, "")))


def rules(
    *faults: str,
    transport: Transport = Transport.UDP,
    clients: int = 1,
    guard: RequestGuard | None = None,
    intercept: Intercept | None = None,
    scripts: Here | None = None,
    epoch: int = 0,
) -> RulePolicy:
    """Set up rules, and clients with the numbers 1, 2, …"""
    shaper = FaultInjector(map(read_fault, faults), seed=1, now=0)
    made = RulePolicy(shaper, guard, intercept, None if scripts is None else scripts.queue, epoch=epoch)
    for number in range(1, clients + 1):
        made.add_client(number, talk(transport).up.conversation, 0)
    if scripts is not None:
        scripts.answer(made, 0)
    return made


def holding(expression: str, patience: int = 60_000 * MS) -> Intercept:
    """Make an intercept."""
    return Intercept(FrameCondition.read(expression), patience)


def sent(actions: Sequence[PolicyAction], toward: Direction = UP) -> bytes:
    """Give all bytes that are sent in one direction."""
    flat = [
        one for each in actions for one in (each.actions if isinstance(each, PolicyDecision) else (each,))
    ]
    return b"".join(each.data for each in flat if isinstance(each, SendAction) and each.toward is toward)


def test_without_rules_all_passes_at_once() -> None:
    raw = request(1)
    decision = rules().receive(1, UP, raw, 0)
    assert (decision.note, decision.actions) == (None, [SendAction(1, UP, raw)])
    assert decision.actions[0].data is raw  # type: ignore[union-attr]  # it is a Send


def test_a_fault_is_told_and_what_it_delays_comes_later() -> None:
    made = rules("delay=3ms", "loss=0%")
    decision = made.receive(1, UP, request(1), 0)
    assert (english(decision.note), decision.actions) == ("delay: delayed by 3 ms", [])
    assert made.holds(1, UP)
    assert not made.holds(1, DOWN)
    assert made.due() == 3 * MS
    (action,) = made.pop_due_actions(3 * MS)
    assert with_english(action) == (SendAction, 1, UP, request(1), "delay: delayed by 3 ms")
    assert made.due() is None
    assert list(map(str, made.report())) == ["fault delay: injected once", "fault drop: injected never"]


def test_a_lost_datagram_leaves_no_action() -> None:
    decision = rules("drop").receive(1, UP, request(1), 0)
    assert (english(decision.note), decision.actions) == ("drop: dropped", [])


def test_the_right_client_is_answered() -> None:
    made = rules("answer=E_FAIL", clients=2)
    (action,) = made.receive(2, UP, request(7), 0).actions
    assert isinstance(action, SendAction)
    assert (action.client, action.toward, english(action.note)) == (2, DOWN, "answer: answered with E_FAIL")
    assert (Frame(action.data).serial, Frame(action.data).code) == (7, E_FAIL)


def test_a_connection_is_closed() -> None:
    made = rules("close=fin", transport=Transport.TCP)
    (action,) = made.receive(1, UP, request(1), 0).actions
    assert with_english(action) == (CloseAction, 1, False, "close: connection closed")


def test_a_client_that_is_gone_is_forgotten() -> None:
    made = rules("delay=3ms", intercept=holding("kind == response"), clients=2)
    made.receive(1, UP, request(1), 0)
    made.receive(1, DOWN, reply(1), 0)
    made.remove_client(1, 0)
    assert made.pop_due_actions(10 * MS) == []
    assert made.intercept.held == []
    assert not made.holds(1, UP)


SLAVE_OFF = encode_frame(8, 0, 64, (Variant(VT.I4, 1), Variant(VT.BSTR, "slvChangeMode"), Variant(VT.I4, 0)))


def test_of_what_is_held_at_the_end_stops_and_answers_go_on_and_motions_do_not() -> None:
    notices: list[str] = []
    made = rules("delay=60s")
    made.notify = collects(notices)
    for serial, raw in enumerate((request(1), HALT, request(2), SLAVE_OFF)):
        made.receive(1, UP, raw, serial)
    made.receive(1, DOWN, reply(1), 9)
    actions = made.release_held(1, 10)
    assert [each.data for each in actions if isinstance(each, SendAction) and each.toward is UP] == [
        HALT,
        SLAVE_OFF,
    ]
    assert sent(actions, DOWN) == reply(1)
    assert notices == ["10.0.0.2:50001 ended; held messages that were not sent: 2 Robot_Execute slvMove"]
    assert "held requests dropped because their client no longer waited: 2" in map(str, made.report())
    assert made.due() is None
    made.remove_client(1, 10)


def test_a_stop_in_a_stream_that_is_held_goes_on_behind_the_rest_of_what_has_begun() -> None:
    made = rules(transport=Transport.TCP)
    play(made, [request(1)[:30]])
    made.shaper.add(read_fault("delay=60s"), 0)
    for piece in (request(1)[30:] + request(2)[:9], request(2)[9:] + HALT):
        made.receive(1, UP, piece, 0)
    assert sent(made.release_held(1, 1)) == request(1)[30:] + HALT
    assert made.dropped_held == 1


def test_nothing_goes_on_of_a_stream_without_a_stop() -> None:
    made = rules("delay=60s", transport=Transport.TCP)
    made.receive(1, UP, request(1)[:30], 0)
    assert made.release_held(1, 1) == []


def test_what_is_intercepted_ends_likewise() -> None:
    made = rules(intercept=holding("true"))
    made.receive(1, UP, request(1), 0)
    made.receive(1, DOWN, reply(1), 0)
    actions = made.release_held(1, 1)
    assert (sent(actions), sent(actions, DOWN)) == (b"", reply(1))
    assert made.intercept.held == []


def test_what_was_sent_on_just_before_the_end_goes_out() -> None:
    made = rules(intercept=holding("true"))
    made.receive(1, UP, request(1), 0)
    made.forward_held(1, 1)
    assert sent(made.release_held(1, 1)) == request(1)
    assert made.pop_due_actions(1) == []


def test_the_guard_sees_what_goes_on_at_the_end() -> None:
    made = rules("delay=60s", guard=RequestGuard(read_only=True))
    made.receive(1, UP, request(1), 0)
    made.receive(1, UP, HALT, 0)
    assert sent(made.release_held(1, 1)) == HALT


def test_nothing_goes_on_of_a_half_open_conversation() -> None:
    made = rules("delay=60s", "half-open if serial == 5")
    made.receive(1, UP, HALT, 0)
    assert not made.hides_end(1)
    made.receive(1, DOWN, reply(7), 0)
    made.receive(1, UP, request(5), 0)
    assert made.hides_end(1)
    assert made.release_held(1, 1) == []
    assert made.due() is None


def test_retries_of_an_edited_message_are_edited_likewise() -> None:
    made = rules(intercept=holding("command == slvMove"))
    made.receive(1, UP, request(5), 0)
    made.receive(1, UP, request(6, reserved=5), MS)
    assert made.receive(1, UP, request(7, reserved=5), 2 * MS).actions == []
    made.forward_held(1, 3 * MS, request(7, reserved=5, values=(9.0,)))
    assert sent(made.pop_due_actions(3 * MS)) == request(7, reserved=5, values=(9.0,))
    assert sent(made.receive(1, UP, request(8, reserved=5), 4 * MS).actions) == request(
        8, reserved=5, values=(9.0,)
    )


def test_an_empty_datagram_passes() -> None:
    for made in (rules(), rules(intercept=holding("serial == 1"))):
        assert len(made.receive(1, UP, b"", 0).actions) == 1


# streams


def play(made: RulePolicy, pieces: Sequence[bytes]) -> list[bytes]:
    """Give what each piece lets out."""
    return [sent(made.receive(1, UP, piece, 0).actions) for piece in pieces]


def test_no_frame_is_waited_for_where_nothing_must_see_it() -> None:
    raw = request(1)
    for faults in ((), ("delay=0ms",), ("partition after 1s",)):
        made = rules(*faults, transport=Transport.TCP)
        assert play(made, [raw[:20], raw[20:]]) == [raw[:20], raw[20:]]


def test_a_frame_is_waited_for_where_a_rule_must_see_it() -> None:
    raw = request(1)
    made = rules("drop if serial == 2", transport=Transport.TCP)
    assert play(made, [raw[:20], raw[20:] + raw[:20]]) == [b"", raw]
    assert made.holds(1, UP)
    assert sent(made.on_stream_end(1, UP, 0)) == raw[:20]
    assert not made.holds(1, UP)


@given(st.data(), st.lists(st.integers(1, 50), min_size=1, max_size=8))
def test_a_frame_is_taken_out_of_a_stream_however_it_is_cut(data: st.DataObject, serials: list[int]) -> None:
    made = rules("drop if serial > 25", transport=Transport.TCP)
    pieces = data.draw(cut(b"".join(map(request, serials))))
    assert b"".join(play(made, pieces)) == b"".join(request(serial) for serial in serials if serial <= 25)


@given(st.data(), st.binary(max_size=300), st.booleans())
def test_bytes_pass_unchanged_through_rules_that_strike_nothing(
    data: st.DataObject, raw: bytes, guarded: bool
) -> None:
    intercept = holding("serial == 70000") if guarded else None
    made = rules("drop if serial == 70000", "loss=0%", transport=Transport.TCP, intercept=intercept)
    passed = b"".join(play(made, data.draw(cut(raw))))
    assert passed + sent(made.on_stream_end(1, UP, 0)) == raw


def test_frames_of_one_segment_stay_together() -> None:
    made = rules("drop if serial == 9", transport=Transport.TCP)
    both = request(1) + request(2)
    decision = made.receive(1, UP, both, 0)
    assert (decision.note, decision.actions) == (None, [SendAction(1, UP, both)])


def test_many_frames_that_are_due_at_once_leave_in_pieces_that_the_ring_can_record() -> None:
    made = rules("delay=1s if serial == 1", transport=Transport.TCP)
    made.receive(1, UP, request(1), 0)
    block = b"".join(request(serial) for serial in range(2, 1002))
    for _ in range(3):
        made.receive(1, UP, block, 0)
    actions = made.pop_due_actions(1000 * MS)
    assert sent(actions) == request(1) + 3 * block
    sizes = [len(each.data) for each in actions if isinstance(each, SendAction)]
    assert max(sizes) <= 1 << 16
    assert len(sizes) <= 3 + 3 * len(block) // (1 << 16)


def test_a_fault_that_comes_in_the_middle_finds_the_next_frame() -> None:
    made = rules(transport=Transport.TCP)
    play(made, [request(1)[:30]])
    made.shaper.add(read_fault("drop if serial == 2"), 0)
    made.on_rules_changed(0)
    assert play(made, [request(1)[30:] + request(2) + request(3)]) == [request(1)[30:] + request(3)]


def test_what_was_kept_for_a_fault_goes_on_when_it_is_switched_off() -> None:
    made = rules("drop name x", transport=Transport.TCP)
    assert play(made, [request(1)[:30]]) == [b""]
    made.shaper.set_enabled("x", False)
    made.on_rules_changed(0)
    assert made.due() == 0
    assert made.pop_due_actions(0) == [SendAction(1, UP, request(1)[:30])]
    assert play(made, [request(1)[30:]]) == [request(1)[30:]]


@pytest.mark.parametrize("needed_by", ["guard", "fault", "intercept"])
def test_what_a_rule_must_still_see_whole_is_kept_when_others_change(needed_by: str) -> None:
    made = rules(
        *(["drop if serial == 9"] if needed_by == "fault" else []),
        transport=Transport.TCP,
        guard=RequestGuard(read_only=True) if needed_by == "guard" else None,
        intercept=holding("serial == 9") if needed_by == "intercept" else None,
    )
    assert play(made, [request(1)[:30]]) == [b""]
    made.on_rules_changed(0)
    assert made.due() is None


def test_a_stream_keeps_its_order_when_the_time_of_a_fault_is_over() -> None:
    made = rules("drop for 5ms if serial == 9", transport=Transport.TCP)
    assert play(made, [request(1)[:30]]) == [b""]
    assert sent(made.receive(1, UP, request(1)[30:], 10 * MS).actions) == request(1)


@pytest.mark.parametrize("faults", [(), ("partition after 3600s",)])
def test_a_stream_that_has_begun_is_found_again_behind_bytes_that_look_like_a_frame(
    faults: tuple[str, ...],
) -> None:
    begun = b"\x01" + (10_000).to_bytes(4, "little") + bytes(8) + b"\x01\0" + bytes(20)
    misleading = encode_frame(1, 0, 64, (Variant.array(VT.UI1, begun),))
    cut = misleading.index(begun)
    made = rules(*faults, transport=Transport.TCP)
    assert play(made, [misleading[:cut]]) == [misleading[:cut]]
    made.shaper.add(read_fault("drop if serial == 2"), 0)
    made.on_rules_changed(0)
    assert play(made, [misleading[cut:] + request(2) + request(3)]) == [misleading[cut:] + request(3)]


def test_a_client_that_comes_again_is_not_half_open() -> None:
    made = rules("half-open times 1", transport=Transport.TCP)
    conversation = next(made.clients())[0].flow.conversation
    assert play(made, [request(1), request(2)]) == [b"", b""]
    assert made.hides_end(1)
    made.remove_client(1, 0)
    made.add_client(1, conversation, 0)
    assert play(made, [request(3)]) == [request(3)]


def test_changing_rules_makes_up_no_datagrams() -> None:
    made = rules("loss=0%")
    made.receive(1, UP, request(1), 0)
    made.on_rules_changed(0)
    assert made.due() is None


# guard


def test_a_refused_request_is_answered_under_each_serial_of_its_tries() -> None:
    made = rules(guard=RequestGuard(read_only=True))
    for serial, reserved in ((5, 0), (6, 5), (7, 5)):
        decision = made.receive(1, UP, request(serial, reserved=reserved), 0)
        assert (
            english(decision.note)
            == "guard: read-only: Robot_Execute 'slvMove', answered with E_ACCESSDENIED"
        )
        assert sent(decision.actions) == b""
        answer = Frame(sent(decision.actions, DOWN))
        assert (answer.serial, answer.code, answer.argc, answer.problems) == (serial, E_ACCESSDENIED, 0, ())
    assert made.refused_requests == 3
    assert list(map(str, made.report())) == ["guard: refused 3 times"]


@pytest.mark.parametrize("reserved", [0, 4])
def test_a_refusal_has_the_reserved_field_that_the_controller_would_send(reserved: int) -> None:
    made = rules(guard=RequestGuard(read_only=True))
    made.receive(1, UP, request(5, "CurJnt", reserved=4), 0)
    made.receive(1, DOWN, reply(5, reserved=reserved), 0)
    decision = made.receive(1, UP, request(6, reserved=4), 0)
    assert Frame(sent(decision.actions, DOWN)).reserved == reserved


def test_what_is_allowed_passes_beside_what_is_refused() -> None:
    made = rules(guard=RequestGuard(read_only=True))
    decision = made.receive(1, UP, request(5) + HALT, 0)
    assert sent(decision.actions) == HALT
    assert Frame(sent(decision.actions, DOWN)).serial == 5


@pytest.mark.parametrize(
    "guard", [RequestGuard(read_only=True), RequestGuard(block=[read_target("slvMove")])]
)
@pytest.mark.parametrize("transport", [Transport.UDP, Transport.TCP])
def test_bytes_that_are_no_frame_do_not_pass_a_guard(guard: RequestGuard, transport: Transport) -> None:
    made = rules(guard=guard, transport=transport)
    assert sent(made.receive(1, UP, b"garbage" + HALT[:20], 0).actions) == b""
    if transport is Transport.TCP:
        assert sent(made.on_stream_end(1, UP, 0)) == b""
    back = [*made.receive(1, DOWN, b"garbage", 0).actions, *made.on_stream_end(1, DOWN, 0)]
    assert sent(back, DOWN) == b"garbage"


def test_it_is_said_that_a_guard_dropped_bytes() -> None:
    made = rules(guard=RequestGuard(read_only=True))
    assert english(made.receive(1, UP, b"garbage", 0).note) == "guard: dropped bytes that are not a frame"


def test_the_guard_sees_frames_in_a_stream_and_leaves_replies_alone() -> None:
    made = rules(guard=RequestGuard(read_only=True), transport=Transport.TCP)
    assert play(made, [request(1)[:20], request(1)[20:] + HALT]) == [b"", HALT]
    assert sent(made.receive(1, DOWN, reply(1), 0).actions, DOWN) == reply(1)


@pytest.mark.parametrize(
    "fault", ["rewrite code 102", "corrupt offset 9 bits 3", "truncate=40", "garbage request"]
)
@pytest.mark.parametrize("transport", [Transport.UDP, Transport.TCP])
def test_faults_make_nothing_of_a_request_that_the_guard_would_refuse(
    fault: str, transport: Transport
) -> None:
    made = rules(fault, "delay=1ms", guard=RequestGuard(read_only=True), transport=transport)
    made.receive(1, UP, encode_frame(5, 0, 100, (Variant(VT.I4, 1),)), 0)
    passed = sent(made.pop_due_actions(MS))
    assert (
        passed == b""
        or Frame(passed).code == 100
        or not RequestGuard(read_only=True).refusal_reason(Frame(passed))
    )


# intercept


def test_a_message_is_held_and_sent_on() -> None:
    made = rules(intercept=holding("command == slvMove"))
    decision = made.receive(1, UP, request(1), 0)
    assert (english(decision.note), decision.actions) == ("intercept: held as 1", [])
    assert sent(made.receive(1, UP, request(2, "CurJnt"), 0).actions) == request(2, "CurJnt")
    (held,) = made.intercept.held
    assert (held.number, held.client, held.data, held.since) == (1, 1, request(1), 0)
    assert held.call_kind is not None
    assert held.call_kind.command == "slvMove"
    assert made.holds(1, UP)
    made.forward_held(1, 2000 * MS)
    assert made.due() == 0
    (action,) = made.pop_due_actions(2000 * MS)
    assert with_english(action) == (SendAction, 1, UP, request(1), "intercept: sent after 2.0 s")
    assert not made.holds(1, UP)
    with pytest.raises(KeyError):
        made.forward_held(1, 0)


def test_a_client_waits_for_its_own_held_messages_only() -> None:
    made = rules(intercept=holding("command == slvMove"), clients=2)
    made.receive(1, UP, request(1), 0)
    made.forward_held(1, MS)
    assert (made.holds(1, UP), made.holds(2, UP)) == (True, False)
    made.pop_due_actions(MS)
    assert not made.holds(1, UP)


@pytest.mark.parametrize(
    ("fault", "note"),
    [
        ("close", "close: connection reset"),
        ("rewrite serial 7", "rewrite: rewritten"),
        ("loss=0%", "intercept: sent after 0.0 s"),
    ],
)
def test_what_a_fault_does_to_a_held_message_is_said(fault: str, note: str) -> None:
    made = rules(fault, transport=Transport.TCP, intercept=holding("command == slvMove"))
    made.receive(1, UP, request(1), 0)
    made.forward_held(1, MS)
    assert not (made.holds(1, UP) and fault == "close")
    (action,) = made.pop_due_actions(MS)
    assert english(action.note) == note


def test_conditions_see_the_time_of_day() -> None:
    shaper = FaultInjector(now=0)
    made = RulePolicy(shaper, intercept=holding('time >= "1970-01-01 00:00:13"'), epoch=10_000 * MS)
    made.add_client(1, talk().up.conversation, 0)
    for second in range(5):
        made.receive(1, UP, request(second), second * 1000 * MS)
    assert [Frame(held.data).serial for held in made.intercept.held] == [3, 4]


def test_a_held_message_is_edited_or_dropped() -> None:
    made = rules(intercept=holding("kind == response"))
    made.receive(1, UP, request(1), 0)
    made.receive(1, DOWN, reply(1), 0)
    made.receive(1, DOWN, reply(2), 0)
    made.forward_held(1, MS, b"other")
    made.drop_held(2, MS)
    (action,) = made.pop_due_actions(MS)
    assert with_english(action) == (SendAction, 1, DOWN, b"other", "intercept: edited after 0.0 s")
    assert made.intercept.held == []


def test_what_waits_too_long_goes_on_unchanged_and_says_so() -> None:
    notices: list[str] = []
    made = rules(intercept=holding("true", patience=5000 * MS))
    made.notify = collects(notices)
    made.receive(1, UP, request(1), 0)
    assert made.due() == 5000 * MS
    assert made.pop_due_actions(4999 * MS) == []
    (action,) = made.pop_due_actions(5000 * MS)
    note = "intercept: no decision within 5 s: sent unchanged"
    assert with_english(action) == (SendAction, 1, UP, request(1), note)
    assert notices == [f"message 1: {note}"]


@pytest.mark.parametrize("transport", [Transport.UDP, Transport.TCP])
@pytest.mark.parametrize("later", [HALT, request(2, "CurJnt"), request(2)], ids=["stop", "other", "the same"])
def test_what_waits_too_long_is_dropped_when_its_client_has_gone_on(
    later: bytes, transport: Transport
) -> None:
    notices: list[str] = []
    made = rules(intercept=holding("serial == 1", patience=2000 * MS), transport=transport)
    made.notify = collects(notices)
    made.receive(1, UP, request(1), 0)
    assert sent(made.receive(1, UP, later, 1000 * MS).actions) == later
    assert made.pop_due_actions(2000 * MS) == []
    why = "its client has sent another request since"
    assert notices == [f"message 1: intercept: no decision within 2 s, and {why}: dropped"]
    assert "held requests dropped because their client no longer waited: 1" in map(str, made.report())
    if transport is Transport.UDP:
        assert made.receive(1, UP, request(3, reserved=1), 3000 * MS).actions == []


def test_what_waits_too_long_is_dropped_when_its_clients_stream_has_ended() -> None:
    made = rules(intercept=holding("true", patience=2000 * MS), transport=Transport.TCP)
    made.receive(1, UP, request(1), 0)
    made.receive(1, DOWN, reply(1), 0)
    made.on_stream_end(1, UP, MS)
    assert made.holds(1, UP)
    (action,) = made.pop_due_actions(2000 * MS)
    note = "intercept: no decision within 2 s: sent unchanged"
    assert with_english(action) == (SendAction, 1, DOWN, reply(1), note)
    assert not made.holds(1, UP)


def test_who_decides_may_send_on_what_has_been_given_up() -> None:
    made = rules(intercept=holding("serial == 1"))
    made.receive(1, UP, request(1), 0)
    made.receive(1, UP, request(2), MS)
    made.forward_held(1, 2 * MS)
    assert sent(made.pop_due_actions(2 * MS)) == request(1)


def test_what_stops_the_robot_is_never_held() -> None:
    assert sent(rules(intercept=holding("true")).receive(1, UP, HALT, 0).actions) == HALT


def test_an_edited_message_meets_the_guard_and_the_faults() -> None:
    made = rules("delay=3ms", intercept=holding("command == CurJnt"), guard=RequestGuard(read_only=True))
    made.receive(1, UP, request(1, "CurJnt"), 0)
    made.forward_held(1, 0, request(1, "slvMove"))
    assert made.pop_due_actions(0) == []
    assert Frame(sent(made.pop_due_actions(3 * MS), DOWN)).code == E_ACCESSDENIED
    made.receive(1, UP, request(2, "CurJnt"), 0)
    made.forward_held(2, 0)
    assert made.pop_due_actions(0) == []
    assert sent(made.pop_due_actions(3 * MS)) == request(2, "CurJnt")


def test_no_more_is_held_than_fits() -> None:
    made = rules(intercept=holding("true"))
    for serial in range(1, MAX_HELD + 1):
        made.receive(1, UP, request(serial), 0)
    decision = made.receive(1, UP, request(5000), 0)
    assert sent(decision.actions) == request(5000)
    assert english(decision.note) == f"intercept: not held, because {MAX_HELD} messages are held already"


EVENTS = st.lists(
    st.tuples(
        st.sampled_from(["up", "down", "take", "end", "changed", "send on", "drop", "add", "remove"])
        | st.sampled_from(["answer", "answer", "answer", "lose"]),
        st.integers(0, 50 * MS),
        st.binary(max_size=80) | mutated_frames() | st.builds(request, st.integers(0, 9)),
    ),
    max_size=25,
)


@given(
    EVENTS,
    st.lists(
        st.sampled_from(["loss=30%", "delay=3ms±2ms", "reorder", "close 10%", "half-open 5%", "serial 50%"])
    ),
    st.sampled_from([Transport.UDP, Transport.TCP]),
)
def test_nothing_that_comes_does_harm(
    events: list[tuple[str, int, bytes]], faults: list[str], transport: Transport
) -> None:
    here = Here(Meddler(), Listener())
    made = rules(
        *faults,
        transport=transport,
        guard=RequestGuard(read_only=True),
        intercept=holding("serial < 5 or kind == malformed", patience=20 * MS),
        scripts=here,
    )
    now = 0
    for what, later, data in events:
        now += later
        match what:
            case "up" | "down":
                decision = made.receive(1, UP if what == "up" else DOWN, data, now)
                assert isinstance(decision.note, Message | None)
            case "take":
                made.pop_due_actions(now)
            case "answer":
                here.answer(made, now, count=1)
            case "lose":
                made.on_script_data(b"", now)
            case "end":
                made.on_stream_end(1, UP, now)
            case "changed":
                made.on_rules_changed(now)
            case "add":
                made.shaper.add(read_fault("delay=1ms"), now)
            case "remove" if made.shaper.hit_counts:
                made.shaper.remove(next(iter(made.shaper.hit_counts)))
            case "send on" | "drop" if made.intercept.held:
                number = made.intercept.held[0].number
                made.forward_held(number, now, data) if what == "send on" else made.drop_held(number, now)
        due = made.due()
        assert due is None or due >= 0
    here.answer(made, now)
    made.pop_due_actions(now + 1000 * MS)
    made.remove_client(1, now)
    made.close(now)
    assert made.pop_due_actions(now + 2000 * MS) == []
    assert made.due() is None
