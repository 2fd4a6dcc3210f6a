"""Rules with scripts: what waits for them, what overtakes, and what becomes of it when they take too long."""

from __future__ import annotations

import pytest

from bcapscope.messages import Message
from bcapscope.protocol.codec.frame import Frame, encode_frame
from bcapscope.protocol.codec.variant import VT, Variant
from bcapscope.protocol.tables.function_table import ID
from bcapscope.protocol.tables.hresult import E_ACCESSDENIED, E_FAIL
from bcapscope.proxy.addons import PassingMessage
from bcapscope.proxy.policy import PolicyDecision, SendAction
from bcapscope.proxy.request_guard import RequestGuard, read_target
from bcapscope.proxy.rule_policy import RulePolicy
from bcapscope.proxy.script_protocol import FinishScripts, ScriptAnswer, pack
from bcapscope.proxy.script_queue import MAX_BYTES_IN_ALL, MAX_WAITING
from bcapscope.traffic.observation import SERVER_PORT, Conversation, Direction, Endpoint, Transport
from tests.english import collects, english
from tests.faults.traffic import CLIENT, MS, reply, request
from tests.proxy.scripting import Here, Listener, Meddler
from tests.proxy.test_rule_policy import DOWN, HALT, SLAVE_OFF, UP, holding, rules, sent


def late(made: RulePolicy, now: int = 0) -> PolicyDecision:
    """Give the one thing that has been decided since it came."""
    (action,) = made.pop_due_actions(now)
    assert isinstance(action, PolicyDecision)
    return action


def test_scripts_change_drop_and_answer() -> None:
    here = Here(Meddler())
    made = rules(scripts=here)

    def decided(direction: Direction, raw: bytes) -> PolicyDecision:
        decision = made.receive(1, direction, raw, 0)
        assert (decision.note, decision.actions) == (None, [])
        assert made.holds(1, direction)
        here.answer(made, 0)
        found = late(made)
        assert found is decision
        assert not made.holds(1, direction)
        return found

    dropped = decided(UP, request(1))
    assert (english(dropped.note), dropped.actions) == ("addon: dropped", [])
    answered = decided(UP, request(2))
    assert (english(answered.note), sent(answered.actions)) == ("addon: answered", b"")
    answer = Frame(sent(answered.actions, DOWN))
    assert (answer.serial, answer.code) == (2, E_FAIL)
    changed = decided(UP, request(3))
    assert (english(changed.note), changed.actions) == ("addon: changed", [SendAction(1, UP, request(33))])
    assert made.report() == []
    unchanged = decided(UP, request(4))
    assert (english(unchanged.note), unchanged.actions) == ("", [SendAction(1, UP, request(4))])
    decided(UP, request(5, "CurJnt"))
    assert english(decided(DOWN, reply(5)).note) == "addon: dropped"
    assert list(map(str, made.report())) == ["scripts: failed once"]


def test_the_guard_sees_what_a_script_has_made() -> None:
    here = Here(Meddler())
    made = rules(scripts=here, guard=RequestGuard(block=[read_target("slvMove")]))
    made.receive(1, UP, request(3, "CurJnt"), 0)
    here.answer(made, 0)
    assert Frame(sent(made.pop_due_actions(0), DOWN)).code == E_ACCESSDENIED


class Everything:
    """Has replies wait, too."""

    def request(self, message: PassingMessage) -> None:
        pass

    def reply(self, message: PassingMessage) -> None:
        pass


class Looker:
    """Notes what it is shown, and changes nothing."""

    def __init__(self) -> None:
        self.seen: list[bytes] = []

    def request(self, message: PassingMessage) -> None:
        self.seen.append(message.data)


def test_others_and_the_other_direction_go_on_while_a_request_waits() -> None:
    here = Here(Looker())
    made = rules(scripts=here, clients=2)
    made.receive(1, UP, request(1), 0)
    assert sent(made.receive(2, DOWN, reply(7), 0).actions, DOWN) == reply(7)
    assert sent(made.receive(1, DOWN, reply(1), 0).actions, DOWN) == reply(1)
    made.receive(2, UP, request(2), MS)
    here.answer(made, 2 * MS)
    assert sent(made.pop_due_actions(2 * MS)) == request(1) + request(2)


def test_what_waits_keeps_its_order_retries_too() -> None:
    here = Here(Looker())
    made = rules(scripts=here)
    sent_by_client = [request(5), request(6, reserved=5), request(7, "CurJnt"), request(8)]
    for raw in sent_by_client:
        assert made.receive(1, UP, raw, 0).actions == []
    passed = b""
    while here.waiting:
        here.answer(made, MS, count=1)
        passed += sent(made.pop_due_actions(MS))
    assert passed == b"".join(sent_by_client)


@pytest.mark.parametrize("transport", [Transport.UDP, Transport.TCP])
def test_a_stop_overtakes_all_that_waits_and_scripts_see_it_still(transport: Transport) -> None:
    looker = Looker()
    here = Here(looker)
    made = rules(scripts=here, transport=transport)
    waiting = request(1, "CurJnt")
    assert made.receive(1, UP, waiting, 0).actions == []
    for stop in (HALT, SLAVE_OFF):
        decision = made.receive(1, UP, stop, 0)
        assert (decision.note, decision.actions) == (None, [SendAction(1, UP, stop)])
    here.answer(made, 0)
    assert sent(made.pop_due_actions(0)) == waiting
    assert looker.seen == [waiting, HALT, SLAVE_OFF]


def robot_call(name: str) -> bytes:
    """Make a call of the robot, with its handle alone."""
    return encode_frame(30, 0, ID[name], (Variant(VT.I4, 1),))


@pytest.mark.parametrize("transport", [Transport.UDP, Transport.TCP])
@pytest.mark.parametrize("stop", [HALT, SLAVE_OFF, robot_call("Robot_Hold")])
def test_a_motion_that_a_stop_has_overtaken_does_not_start_after_it(
    stop: bytes, transport: Transport
) -> None:
    here = Here(Looker())
    made = rules(scripts=here, transport=transport)
    for raw in (request(1), request(2, "CurJnt")):
        made.receive(1, UP, raw, 0)
    assert made.receive(1, UP, stop, 0).actions == [SendAction(1, UP, stop)]
    made.receive(1, UP, request(3), 0)
    here.answer(made, 0)
    actions = made.pop_due_actions(0)
    assert sent(actions) == request(2, "CurJnt") + request(3)
    refused = Frame(sent(actions, DOWN))
    assert (refused.serial, refused.code) == (1, E_ACCESSDENIED)
    assert isinstance(actions[0], PolicyDecision)
    assert english(actions[0].note) == "overtaken by a stop: motion is refused"
    assert made.refused_requests == 1


def test_a_motion_that_a_script_makes_of_an_overtaken_request_is_refused_too() -> None:
    here = Here(Meddler())
    made = rules(scripts=here)
    made.receive(1, UP, request(3, "CurJnt"), 0)
    made.receive(1, UP, HALT, 0)
    here.answer(made, 0)
    assert sent(made.pop_due_actions(0)) == b""


@pytest.mark.parametrize(
    ("stop", "passes"),
    [
        (HALT, False),
        (robot_call("Robot_Hold"), False),
        (SLAVE_OFF, True),
        (robot_call("Robot_Release"), True),
        (robot_call("Task_Stop"), True),
    ],
)
def test_a_halt_ends_the_motions_of_all_clients_other_stops_those_of_their_own(
    stop: bytes, passes: bool
) -> None:
    here = Here(Looker())
    made = rules(scripts=here, clients=2)
    made.receive(1, UP, request(1), 0)
    made.receive(2, UP, stop, 0)
    here.answer(made, 0)
    assert sent(made.pop_due_actions(0)) == (request(1) if passes else b"")


def test_a_halt_of_one_controller_leaves_the_motions_of_another() -> None:
    here = Here(Looker())
    made = rules(scripts=here)
    other = Conversation(CLIENT, Endpoint("10.0.0.99", 5007), Transport.UDP, SERVER_PORT)
    made.add_client(2, other, 0)
    here.answer(made, 0)
    made.receive(1, UP, request(1), 0)
    made.receive(2, UP, HALT, 0)
    here.answer(made, 0)
    assert sent(made.pop_due_actions(0)) == request(1)


def test_a_release_ends_no_motion() -> None:
    here = Here(Looker())
    made = rules(scripts=here)
    made.receive(1, UP, request(1), 0)
    made.receive(1, UP, robot_call("Task_Release"), 0)
    here.answer(made, 0)
    assert sent(made.pop_due_actions(0)) == request(1)


def test_a_reply_is_no_stop_whatever_its_result() -> None:
    here = Here(Everything())
    made = rules(scripts=here)
    assert made.receive(1, DOWN, reply(1, ID["Robot_Halt"]), 0).waiting


def test_what_came_in_one_piece_is_decided_when_all_of_it_is() -> None:
    here = Here(Looker())
    made = rules(scripts=here, transport=Transport.TCP)
    first = made.receive(1, UP, request(1, "CurJnt") + HALT + request(2) + request(3)[:20], 0)
    assert sent(first.actions) == HALT
    here.answer(made, 0, count=1)
    assert made.pop_due_actions(0) == [SendAction(1, UP, request(1, "CurJnt"))]
    here.answer(made, 0)
    assert late(made) is first
    assert (first.client, first.note, first.actions) == (1, None, [SendAction(1, UP, request(2))])
    made.on_stream_end(1, UP, 0)
    assert made.holds(1, UP)
    here.answer(made, 0)
    assert sent(made.pop_due_actions(0)) == request(3)[:20]
    assert not made.holds(1, UP)


def switched_off(*waiting: bytes, transport: Transport = Transport.UDP) -> tuple[RulePolicy, Here, list[str]]:
    """Give rules whose script loops while requests wait, and what they tell, right before it is too long."""
    here = Here(Looker())
    here.place = (Message("script.place", file="mine.py", line=7, function="request"),)
    notices: list[str] = []
    made = rules(scripts=here, transport=transport)
    here.obeys = False
    here.queue.notify = collects(notices)
    for raw in waiting:
        assert made.receive(1, UP, raw, 0).waiting
    return made, here, notices


def test_a_script_that_takes_too_long_is_switched_off() -> None:
    made, here, notices = switched_off(request(1), request(2, "CurJnt"), request(3))
    assert made.due() == 100 * MS
    assert made.pop_due_actions(100 * MS - 1) == []
    actions = made.pop_due_actions(100 * MS)
    assert sent(actions) == request(2, "CurJnt")
    answers = [each for each in actions if isinstance(each, PolicyDecision) and each.note]
    assert [english(each.note) for each in answers] == ["the script is switched off: motion is refused"] * 2
    assert [Frame(sent(each.actions, DOWN)).code for each in answers] == [E_ACCESSDENIED] * 2
    assert (here.located, here.ended, notices) == (1, 0, [])
    assert made.due() == 150 * MS
    made.pop_due_actions(150 * MS)
    assert (here.ended, made.due()) == (1, None)
    assert notices == [
        "script mine.py is switched off: it took longer than 100 ms for request (Robot_Execute slvMove); "
        "mine.py line 7 in request. Stops pass, motion is refused, everything else passes unchanged. Restart "
        "the proxy to let motion pass"
    ]


def test_a_script_that_is_switched_off_lets_streams_be_read_on() -> None:
    made, _, _ = switched_off(request(1), transport=Transport.TCP)
    while not made.is_full(1):
        made.receive(1, UP, request(1, "CurJnt") * 100, 0)
    made.pop_due_actions(100 * MS)
    assert not made.is_full(1)


def test_an_empty_datagram_passes_without_its_script() -> None:
    made, _, _ = switched_off(request(1))
    made.pop_due_actions(100 * MS)
    assert made.receive(1, UP, b"", 200 * MS).actions == [SendAction(1, UP, b"")]


@pytest.mark.parametrize("transport", [Transport.UDP, Transport.TCP])
def test_without_its_script_all_but_motion_passes(transport: Transport) -> None:
    made, _, _ = switched_off(request(1), transport=transport)
    made.pop_due_actions(100 * MS)
    now = 200 * MS
    for raw in (HALT, SLAVE_OFF, request(2, "CurJnt")):
        decision = made.receive(1, UP, raw, now)
        assert (decision.note, decision.actions) == (None, [SendAction(1, UP, raw)])
    assert sent(made.receive(1, DOWN, reply(2), now).actions, DOWN) == reply(2)
    moving = made.receive(1, UP, request(3) + request(4, "CurJnt"), now)
    assert sent(moving.actions) == request(4, "CurJnt")
    assert Frame(sent(moving.actions, DOWN)).code == E_ACCESSDENIED
    assert english(moving.note) == "the script is switched off: motion is refused"


def test_each_message_has_the_whole_time() -> None:
    here = Here(Looker())
    made = rules(scripts=here)
    for serial in range(1, 6):
        made.receive(1, UP, request(serial), 0)
    for count in range(1, 6):
        assert made.due() == (100 + 90 * (count - 1)) * MS
        here.answer(made, 90 * count * MS, count=1)
        assert sent(made.pop_due_actions(90 * count * MS)) == request(count)
    assert here.queue.is_on


def test_a_message_does_not_wait_behind_others_for_ever() -> None:
    here = Here(Looker(), limit=90 * MS)
    made = rules(scripts=here)
    now = 0
    for serial in range(1, 60):
        now += 45 * MS
        made.receive(1, UP, request(2 * serial), now)
        made.receive(1, UP, request(2 * serial + 1), now)
        here.answer(made, now, count=1)
        made.pop_due_actions(now)
        if not here.queue.is_on:
            break
    assert english(here.queue.off_because) == "it cannot keep up: messages have waited for 1 s"
    assert not made.holds(1, UP)


def test_a_script_is_not_blamed_for_answers_that_nobody_has_read() -> None:
    here = Here(Looker())
    made = rules(scripts=here)
    made.receive(1, UP, request(1), 0)
    here.arrived = here.take()
    assert sent(made.pop_due_actions(105 * MS)) == request(1)
    assert here.queue.is_on


def test_a_script_is_blamed_for_the_message_that_it_has_not_answered() -> None:
    here = Here(Looker())
    made = rules(scripts=here)
    for serial in (1, 2):
        made.receive(1, UP, request(serial, "CurJnt"), 0)
    here.arrived = here.take(1)
    made.pop_due_actions(105 * MS)
    assert here.queue.is_on
    here.arrived = b"\x20"  # the beginning of an answer is none
    made.pop_due_actions(205 * MS)
    assert not here.queue.is_on


def test_streams_are_read_on_where_scripts_are_only_shown_what_passes() -> None:
    here = Here(Listener())
    made = rules(scripts=here, transport=Transport.TCP)
    raw = request(1, "CurJnt") * 1000  # more than a client may have waiting
    for _ in range(5):
        assert sent(made.receive(1, UP, raw, 0).actions) == raw
        assert not made.is_full(1)
    assert made.receive(1, UP, HALT, 0).actions == [SendAction(1, UP, HALT)]


def test_what_scripts_are_only_shown_is_bounded() -> None:
    here = Here(Listener())
    made = rules(scripts=here)
    raw = encode_frame(1, 0, ID["Robot_Execute"], (Variant.array(VT.UI1, bytes(60_000)),))
    most = MAX_BYTES_IN_ALL // len(raw) + 1
    for _ in range(most + 5):
        assert sent(made.receive(1, UP, raw, 0).actions) == raw
    assert here.waiting == most
    here.answer(made, 0)
    made.receive(1, UP, raw, 0)
    assert here.waiting == 1


def test_what_a_client_that_has_gone_left_takes_no_room() -> None:
    here = Here(Looker())
    made = rules(scripts=here, clients=2)
    for serial in range(1, MAX_WAITING + 1):
        made.receive(1, UP, request(serial), 0)
    made.release_held(1, 0)
    made.remove_client(1, 0)
    assert made.receive(2, UP, request(1), 0).waiting
    here.answer(made, 0)
    assert sent(made.pop_due_actions(0)) == request(1)


def test_the_room_of_a_client_that_has_gone_is_not_given_twice() -> None:
    raw = encode_frame(1, 0, ID["Robot_Execute"], (Variant.array(VT.UI1, bytes(60_000)),))
    most = MAX_BYTES_IN_ALL // len(raw) + 1
    made = rules(scripts=Here(Looker()), clients=most + 2)
    made.receive(1, UP, raw, 0)
    made.remove_client(1, 0)
    fullness = []
    for client in range(2, most + 2):
        made.receive(client, UP, raw, 0)
        fullness.append(made.is_full(most + 2))
    assert fullness == [False] * (most - 1) + [True]


def test_a_relay_that_stood_still_does_not_blame_the_script() -> None:
    here = Here(Looker())
    made = rules(scripts=here)
    made.receive(1, UP, request(1), 0)
    assert made.pop_due_actions(5000 * MS) == []
    assert made.due() == 5100 * MS
    here.answer(made, 5050 * MS)
    assert sent(made.pop_due_actions(5050 * MS)) == request(1)
    made.receive(1, UP, request(2), 6000 * MS)
    assert made.due() == 6100 * MS
    made.pop_due_actions(6100 * MS)
    assert not here.queue.is_on


def test_a_relay_that_always_stands_still_does_not_let_messages_wait_for_ever() -> None:
    made, here, _ = switched_off(request(1))
    made.pop_due_actions(500 * MS)
    assert here.queue.is_on
    made.pop_due_actions(1000 * MS)
    assert not here.queue.is_on


def test_the_end_of_its_process_switches_a_script_off() -> None:
    made, here, notices = switched_off(request(1), request(2, "CurJnt"))
    here.place = (Message("script.exit-code", code=3),)
    made.on_script_data(b"", MS)
    assert sent(made.pop_due_actions(MS)) == request(2, "CurJnt")
    made.pop_due_actions(51 * MS)
    why = "its process ended during request (Robot_Execute slvMove); exit code 3"
    assert notices[0].startswith(f"script mine.py is switched off: {why}. Stops pass")
    assert "scripts: switched off, its process ended during request" in str(made.report()[-1])


def test_the_hook_in_which_a_process_ended_is_named() -> None:
    here = Here(Meddler())
    made = rules(scripts=here)
    made.receive(1, DOWN, reply(8), 0)
    made.on_script_data(b"", MS)
    assert english(here.queue.off_because) == "its process ended during reply"


@pytest.mark.parametrize(
    "data", [b"\xff" * 8, b"\x01\0\0\0\xc1", pack(FinishScripts()), pack(ScriptAnswer()) * 2]
)
def test_what_makes_no_sense_switches_a_script_off(data: bytes) -> None:
    made, here, _ = switched_off(request(2, "CurJnt"))
    here.take()
    made.on_script_data(data, 0)
    assert sent(made.pop_due_actions(0)) == request(2, "CurJnt")
    assert english(here.queue.off_because).startswith("its process sent the proxy an invalid message")


def test_a_client_that_goes_leaves_nothing_that_waits() -> None:
    notices: list[str] = []
    here = Here(Meddler())
    made = rules(scripts=here, clients=2)
    made.notify = collects(notices)
    made.receive(1, UP, request(9), 0)
    made.receive(1, DOWN, reply(8), 0)
    made.receive(2, UP, request(7), 0)
    assert sent(made.release_held(1, MS), DOWN) == reply(8)
    assert notices[0].endswith("held messages that were not sent: 1 Robot_Execute slvMove")
    made.remove_client(1, MS)
    here.answer(made, MS)
    assert sent(made.pop_due_actions(MS)) == request(7)


def test_datagrams_that_find_no_room_are_dropped_and_streams_are_not_read() -> None:
    here = Here(Looker())
    made = rules(scripts=here, clients=2)
    for serial in range(1, MAX_WAITING + 1):
        made.receive(1, UP, request(serial, "CurJnt"), 0)
    note = made.receive(1, UP, request(99), 0).note
    assert english(note) == "addon: dropped, too many messages wait"
    assert made.receive(1, UP, HALT, 0).actions == [SendAction(1, UP, HALT)]
    assert made.receive(2, UP, request(1, "CurJnt"), 0).waiting
    here.answer(made, 0)
    assert len(sent(made.pop_due_actions(0))) == len(request(1, "CurJnt")) * (MAX_WAITING + 1)
    assert made.receive(1, UP, request(99), 0).waiting
    stream = rules(scripts=Here(Looker()), transport=Transport.TCP)
    while not stream.is_full(1):
        assert stream.receive(1, UP, request(1) * 100, 0).waiting


def test_nothing_waits_for_a_script_that_decides_nothing() -> None:
    here = Here(Listener())
    made = rules(scripts=here)
    decision = made.receive(1, UP, request(1), 0)
    assert (decision.note, decision.actions) == (None, [SendAction(1, UP, request(1))])
    assert sent(made.receive(1, DOWN, reply(1), 0).actions, DOWN) == reply(1)
    here.obeys = False
    made.receive(1, UP, request(2), 0)
    made.pop_due_actions(100 * MS)
    assert not here.queue.is_on


@pytest.mark.parametrize("epoch", [0, 1_700_000_000_000_000_000])
def test_calls_settle_though_nothing_more_comes(epoch: int) -> None:
    listener = Listener()
    here = Here(listener)
    made = rules(scripts=here, epoch=epoch)
    made.receive(1, UP, request(1), 0)
    made.receive(1, DOWN, reply(1), MS)
    now = MS
    while not listener.heard:
        here.answer(made, now)
        due = made.due()
        assert due is not None
        now = max(now + MS, due)
        made.pop_due_actions(now)
    assert now < 10_000 * MS
    made.receive(1, UP, request(2), now)
    made.remove_client(1, now)
    made.close(now)
    assert len(listener.heard) == 2
    assert listener.others == ["1 10.0.0.2:50001", "gone", "done"]
    assert here.ended == 1


def test_a_held_message_of_a_stream_that_has_ended_is_given_up_though_it_waited_for_a_script() -> None:
    here = Here(Looker())
    made = rules(scripts=here, transport=Transport.TCP, intercept=holding("true", patience=2000 * MS))
    made.receive(1, UP, request(1), 0)
    made.on_stream_end(1, UP, 0)
    here.answer(made, MS)
    made.pop_due_actions(MS)
    assert len(made.intercept.held) == 1
    assert made.pop_due_actions(3000 * MS) == []
    assert made.dropped_held == 1
