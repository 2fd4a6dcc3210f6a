"""The queue of messages for the scripts: its limits, its time limits, and how it ends."""

from __future__ import annotations

import pytest

from bcapscope.faults.wire_message import WireMessage
from bcapscope.protocol.codec.byte_budget import ByteBudget
from bcapscope.proxy.direction_state import DirectionState, UndecidedMessage
from bcapscope.proxy.policy import PolicyDecision
from bcapscope.proxy.script_protocol import ScriptAnswer, WireSentence, pack
from bcapscope.proxy.script_queue import ScriptQueue
from tests.english import collects, english
from tests.faults.traffic import MS, request, talk
from tests.proxy.scripting import Here, Listener, Meddler

TALK = talk()
KB_64 = bytes(64 << 10)
NOTICE = WireSentence("addon.error", {"hook": "Mine.request", "error": "oh"})


class Gate:
    """Has only a hook that needs no frames."""

    def connected(self, client: object) -> None:
        pass


def silent(limit: int = 100 * MS) -> ScriptQueue:
    """Create a queue whose scripts send no answers."""
    here = Here(Meddler(), limit=limit)
    here.obeys = False
    return here.queue


def show(queue: ScriptQueue, client: int = 1, data: bytes = b"x", waits: bool = True) -> None:
    """Pass a request to the scripts at time 0. With `waits`, the request waits for their decision."""
    message = WireMessage(1, TALK.up, data, 0, 0)
    state = DirectionState(client, TALK.up, 0, ByteBudget())
    undecided = UndecidedMessage(message, state, PolicyDecision(client))
    queue.show_message(client, message, undecided if waits else None)


def answer(queue: ScriptQueue, now: int, sent: ScriptAnswer | None = None) -> None:
    list(queue.on_data(pack(sent or ScriptAnswer()), now))


def advance(queue: ScriptQueue, now: int) -> None:
    list(queue.advance(now, now))


def test_64_datagrams_of_each_client_may_wait() -> None:
    queue = silent()
    room = []
    for _ in range(64):
        room.append(queue.has_room(1))
        show(queue)
    assert (all(room), queue.has_room(1), queue.has_room(2)) == (True, False, True)
    answer(queue, 0)
    assert queue.has_room(1)


def test_64_kb_of_each_client_may_wait() -> None:
    queue = silent()
    show(queue, data=KB_64)
    assert not queue.is_full(1)
    show(queue)
    assert (queue.is_full(1), queue.has_room(1), queue.is_full(2)) == (True, False, False)
    answer(queue, 0)
    assert not queue.is_full(1)


def test_4_mb_of_all_clients_may_wait() -> None:
    queue = silent()
    for client in range(64):
        show(queue, client, KB_64)
    assert not queue.is_full(99)
    show(queue)
    assert queue.is_full(99)
    for _ in range(65):
        answer(queue, 0)
    assert not queue.is_full(99)


def test_above_4_mb_scripts_get_no_message_that_needs_no_decision() -> None:
    here = Here(Listener())
    here.queue.send_connected(1, TALK.up.conversation, 0)
    for _ in range(64):
        show(here.queue, data=KB_64, waits=False)
    show(here.queue, waits=False)
    assert here.waiting == 1 + 65
    show(here.queue, waits=False)
    assert here.waiting == 1 + 65


@pytest.mark.parametrize(
    ("limit", "answered_at", "due", "waited"),
    [(400 * MS, [300 * MS, 650 * MS], 1000 * MS, "1 s"), (3000 * MS, [2900 * MS], 3000 * MS, "3 s")],
)
def test_a_message_waits_one_second_or_the_time_limit_if_this_is_longer(
    limit: int, answered_at: list[int], due: int, waited: str
) -> None:
    queue = silent(limit)
    for _ in range(len(answered_at) + 1):
        show(queue)
    for now in answered_at:
        answer(queue, now)
    assert queue.due() == due
    advance(queue, due)
    assert english(queue.off_because) == f"it cannot keep up: messages have waited for {waited}"


@pytest.mark.parametrize(("late", "is_on"), [(20 * MS, False), (20 * MS + 1, True)])
def test_scripts_get_more_time_if_the_relay_is_late_by_more_than_20_ms(late: int, is_on: bool) -> None:
    queue = silent()
    show(queue)
    advance(queue, 100 * MS + late)
    assert queue.is_on is is_on


def test_the_first_of_the_waiting_messages_is_blamed() -> None:
    queue = silent()
    show(queue, data=request(1))
    show(queue, data=request(2, "CurJnt"))
    advance(queue, 100 * MS)
    assert english(queue.off_because) == "it took longer than 100 ms for request (Robot_Execute slvMove)"


def test_all_waiting_messages_get_more_time_if_the_relay_is_late() -> None:
    queue = silent(400 * MS)
    show(queue)
    show(queue)
    advance(queue, 5000 * MS)
    assert queue.due() == 5400 * MS
    answer(queue, 5300 * MS)
    assert queue.due() == 5700 * MS


def test_open_calls_expire_at_once_and_then_every_50_ms() -> None:
    queue = silent()
    assert queue.due() is None
    show(queue)
    answer(queue, 0, ScriptAnswer(has_open_calls=True))
    assert queue.due() == 0
    advance(queue, 0)
    assert queue.due() == 100 * MS  # the order to expire calls has the same time limit as a message
    answer(queue, MS, ScriptAnswer(has_open_calls=True))
    assert queue.due() == 50 * MS


def test_the_user_sees_at_most_200_messages_of_the_scripts() -> None:
    queue = silent()
    notices: list[str] = []
    queue.notify = collects(notices)
    for _ in range(7):
        show(queue)
        answer(queue, 0, ScriptAnswer(notices=(NOTICE,) * 30))
    assert notices == ["Mine.request: oh (reported once)"] * 200


def test_streams_are_split_if_hooks_need_frames_or_the_scripts_are_off() -> None:
    assert Here(Meddler()).queue.inspects_frames
    queue = Here(Gate()).queue
    assert (queue.inspects_frames, queue.status) == (False, "on")
    list(queue.on_process_ended(0))
    assert (queue.inspects_frames, queue.status) == (True, "off: its process ended between two messages")


def test_only_the_direction_of_a_waiting_message_is_held() -> None:
    queue = silent()
    queue.send_connected(1, TALK.up.conversation, 0)
    show(queue)
    assert (queue.holds(TALK.up), queue.holds(TALK.down)) == (True, False)


def test_scripts_that_handle_all_orders_at_the_end_stay_on() -> None:
    here = Here(Listener())
    notices: list[str] = []
    here.queue.notify = collects(notices)
    here.queue.finish(0)
    assert (here.queue.is_on, here.ended, notices) == (True, 1, [])


def test_the_end_names_the_order_that_takes_too_long_and_no_consequence() -> None:
    queue = silent()
    notices: list[str] = []
    queue.notify = collects(notices)
    show(queue, data=request(1))
    queue.finish(0)
    reason = "its process took too long at the end for request (Robot_Execute slvMove)"
    assert notices == [f"script mine.py is switched off: {reason}"]


def test_scripts_that_were_switched_off_are_reported_once() -> None:
    queue = silent()
    notices: list[str] = []
    queue.notify = collects(notices)
    list(queue.on_process_ended(0))
    due = queue.due()
    assert due == 50 * MS
    advance(queue, due)
    queue.finish(due)
    assert len(notices) == 1
