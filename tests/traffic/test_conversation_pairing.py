"""Which call a frame belongs to, by playbooks: this was seen, so these calls come out."""

from __future__ import annotations

import pytest

from bcapscope.protocol.codec.byte_budget import ByteBudget
from bcapscope.traffic import conversation_pairing
from bcapscope.traffic.call import Call
from bcapscope.traffic.conversation_pairing import ConversationPairing
from bcapscope.traffic.observation import Transport
from bcapscope.traffic.pairing_windows import LARGE_CALL
from bcapscope.traffic.serial_table import MAX_REUSED
from tests.traffic.playbook import (
    BUSY,
    MOVE,
    OTHER,
    POSE,
    S_EXECUTING,
    START_SERVICE,
    Script,
    calls_of,
    play,
    r8s,
    slv_move,
    strays_of,
    summaries,
)

PLAYBOOKS: dict[str, tuple[list[str], list[tuple[object, ...]]]] = {
    "a reply seen in time, and yet a retry: lost behind the place of capture": (
        ["1: >1 lost<2 >>3 <4 answered, reply lost"],
        [(0, 1, 0, MOVE), (1, -1, 0, POSE), (120, 2, 1, MOVE), (121, -2, 0, POSE)],
    ),
    "a reply and a retry so close that they may have met, for all that is known": (
        ["1: >1 lost<2 >>3 <4 answered, cannot tell"],
        [(0, 1, 0, MOVE), (1, -1, 0, POSE), (20, 2, 1, MOVE), (21, -2, 0, POSE)],
    ),
    "a reply that met the retry on its way": (
        ["1: >1 lost<2 >>3 <4 answered, cannot tell"],
        [(0, 1, 0, MOVE), (1.9, -1, 0, POSE), (2, 2, 1, MOVE), (3, -2, 0, POSE)],
    ),
    "only the retry was answered": (
        ["1: >1 >>2 <3 answered, cannot tell"],
        [(0, 1, 0, MOVE), (2, 2, 1, MOVE), (3, -2, 0, POSE)],
    ),
    "the retry was refused": (
        ["1: >1 >>2 <3 refused, cannot tell"],
        [(0, 1, 0, MOVE), (2, 2, 1, MOVE), (3, -2, 0x83500121)],
    ),
    "no try was answered and the client went on": (
        ["1: >1 >>2 unanswered, unanswered", "2: >3 <4 answered, answered"],
        [(0, 1, 0, MOVE), (2, 2, 1, MOVE), (4, 3, 0, OTHER), (5, -3, 0, POSE)],
    ),
    "the reply came after the client had gone on": (
        ["1: >1 late<3 unanswered, reply late", "2: >2 <4 answered, answered"],
        [(0, 1, 0, MOVE), (16, 2, 0, OTHER), (19, -1, 0, POSE), (20, -2, 0, POSE)],
    ),
    "the first reply overtakes nothing: both replies after the retry": (
        ["1: >1 >>2 late<3 <4 answered, reply late"],
        [(0, 1, 0, MOVE), (2, 2, 1, MOVE), (2.5, -1, 0, POSE), (3, -2, 0, POSE)],
    ),
    "replies out of order": (
        ["1: >1 >>2 <3 late<4 answered, reply late"],
        [(0, 1, 0, MOVE), (2, 2, 1, MOVE), (2.5, -2, 0, POSE), (3, -1, 0, POSE)],
    ),
    "replies with other contents: the server did not know the retry for one": (
        ["1: >1 >>2 late<3 <4 answered, executed twice"],
        [(0, 1, 0, MOVE), (2, 2, 1, MOVE), (2.5, -1, 0, POSE), (3, -2, 0, r8s(1.5, 2.0))],
    ),
    "two replies with other contents to one try": (
        ["1: >1 <2 late<3 answered, executed twice"],
        [(0, 1, 0, MOVE), (1, -1, 0, POSE), (1.5, -1, 0, r8s(1.5, 2.0))],
    ),
    "busy is not a second result": (
        ["1: >1 >>2 late<3 <4 answered, reply late"],
        [(0, 1, 0, MOVE), (2, 2, 1, MOVE), (2.5, -1, BUSY), (3, -2, 0, POSE)],
    ),
    "copies by the network": (
        ["1: >1 =2 <3 =4 answered, answered"],
        [(0, 1, 0, MOVE), (0.01, 1, 0, MOVE), (1, -1, 0, POSE), (1.01, -1, 0, POSE)],
    ),
    "copies of retries and of late replies": (
        ["1: >1 >>2 =3 late<4 =5 <6 answered, reply late"],
        [
            (0, 1, 0, MOVE),
            (2, 2, 1, MOVE),
            (2.1, 2, 1, MOVE),
            (2.2, -1, 0, POSE),
            (2.3, -1, 0, POSE),
            (3, -2, 0, POSE),
        ],
    ),
    "a copy that arrives after the client went on": (
        ["1: >1 <2 =4 answered, answered", "2: >3 <5 answered, answered"],
        [(0, 1, 0, MOVE), (1, -1, 0, POSE), (8, 2, 0, OTHER), (8.1, 1, 0, MOVE), (9, -2, 0, POSE)],
    ),
    "still at work": (
        ["1: >1 ...2 ...3 <4 answered, answered"],
        [(0, 1, 0, MOVE), (80, -1, S_EXECUTING), (160, -1, S_EXECUTING), (200, -1, 0, POSE)],
    ),
    "the first try was at work, its result was lost": (
        ["1: >1 ...2 >>3 <4 answered, reply lost"],
        [(0, 1, 0, MOVE), (80, -1, S_EXECUTING), (1080, 2, 1, MOVE), (1081, -2, 0, POSE)],
    ),
    "only the second try was at work: the first did not arrive": (
        ["1: >1 >>2 ...3 <4 answered, request lost"],
        [(0, 1, 0, MOVE), (1000, 2, 1, MOVE), (1080, -2, S_EXECUTING), (1100, -2, 0, POSE)],
    ),
    "at work and never done": (
        ["1: >1 ...2 unanswered, unanswered", "2: >3 <4 refused, refused"],
        [(0, 1, 0, MOVE), (80, -1, S_EXECUTING), (500, 2, 0, OTHER), (501, -2, BUSY)],
    ),
    "a client that asks without waiting takes its replies by serial": (
        ["1: >1 <3 answered, answered", "2: >2 <5 answered, answered", "3: >4 <6 answered, answered"],
        [
            (0, 1, 0, MOVE),
            (1, 2, 0, OTHER),
            (1.5, -1, 0, POSE),
            (2, 3, 0, MOVE),
            (2.5, -2, 0, POSE),
            (3, -3, 0, POSE),
        ],
    ),
    "a client that asked again after 2 ms had waited for its reply": (
        ["1: >1 late<3 unanswered, reply late", "2: >2 <4 answered, answered"],
        [(0, 1, 0, MOVE), (2, 2, 0, OTHER), (2.5, -1, 0, POSE), (3, -2, 0, POSE)],
    ),
    "a client that asked again just before 2 ms had not waited": (
        ["1: >1 <3 answered, answered", "2: >2 <4 answered, answered"],
        [(0, 1, 0, MOVE), (1.999999, 2, 0, OTHER), (2.5, -1, 0, POSE), (3, -2, 0, POSE)],
    ),
    "a client that asks without waiting loses one": (
        ["1: >1 unanswered, unanswered", "2: >2 <3 answered, answered", "3: >4 <5 answered, answered"],
        [(0, 1, 0, MOVE), (1, 2, 0, OTHER), (2.5, -2, 0, POSE), (200, 3, 0, MOVE), (201, -3, 0, POSE)],
    ),
    "a client that asks without waiting is answered out of order": (
        ["1: >1 <4 answered, answered", "2: >2 <3 answered, answered"],
        [(0, 1, 0, MOVE), (1, 2, 0, OTHER), (2, -2, 0, POSE), (2.5, -1, 0, POSE)],
    ),
    "busy with a later call, so the one before may still be at work": (
        ["1: >1 capture_ended, capture ended", "2: >2 <3 refused, refused"],
        [(0, 1, 0, MOVE), (1, 2, 0, OTHER), (2, -2, BUSY)],
    ),
    "an earlier retry is overtaken by the reply to a later one": (
        ["1: >1 >>2 <3 >>4 answered, cannot tell"],
        [(0, 1, 0, MOVE), (4, 3, 1, MOVE), (4.5, -3, 0, POSE), (4.6, 2, 1, MOVE)],
    ),
    "a retry is overtaken by the next call": (
        ["1: >1 <2 >>4 answered, cannot tell", "2: >3 <5 answered, answered"],
        [(0, 1, 0, MOVE), (3, -1, 0, POSE), (3.1, 3, 0, OTHER), (3.2, 2, 1, MOVE), (4, -3, 0, POSE)],
    ),
    "a reply to nothing": (
        ["stray 1 of None", "1: >2 <3 answered, answered"],
        [(0, -77, 0, POSE), (1, 1, 0, MOVE), (2, -1, 0, POSE)],
    ),
    "the capture began between two tries": (
        ["1: >>1 late<2 >>3 <4 answered, reply late"],
        [(0, 8, 7, MOVE), (1, -7, 0, POSE), (2, 9, 7, MOVE), (3, -9, 0, POSE)],
    ),
    "the capture began before the last try": (
        ["1: >>1 <2 answered, cannot tell"],
        [(0, 8, 7, MOVE), (1, -8, 0, POSE)],
    ),
    "a retry overtook the first try": (
        ["1: >>1 >2 late<3 <4 answered, reply late"],
        [(2, 2, 1, MOVE), (2.1, 1, 0, MOVE), (2.5, -1, 0, POSE), (3, -2, 0, POSE)],
    ),
    "a later retry overtook an earlier one": (
        ["1: >1 >>2 >>3 late<4 <5 answered, reply late"],
        [(0, 1, 0, MOVE), (4, 3, 1, MOVE), (4.1, 2, 1, MOVE), (4.5, -2, 0, POSE), (5, -3, 0, POSE)],
    ),
    "reserved names a request that was another": (
        ["1: >1 <2 answered, answered", "2: >>3 <4 answered, cannot tell"],
        [(0, 1, 0, MOVE), (1, -1, 0, POSE), (8, 2, 1, OTHER), (9, -2, 0, POSE)],
    ),
    "serials wrap from 65535 to 1": (
        ["1: >1 >>2 <3 answered, cannot tell", "2: >4 <5 answered, answered"],
        [
            (0, 65535, 65535, MOVE),
            (2, 1, 65535, MOVE),
            (3, -1, 0, POSE),
            (8, 2, 2, OTHER),
            (9, -2, 0, POSE),
        ],
    ),
    "retries pass through serial 0, each naming the one before": (
        ["1: >1 >>2 >>3 >>4 <5 answered, cannot tell", "2: >6 <7 answered, answered"],
        [
            (0, 65534, 0, MOVE),
            (20, 65535, 65534, MOVE),
            (40, 0, 65535, MOVE),
            (60, 1, 0, MOVE),
            (61, -1, 0, POSE),
            (70, 2, 0, MOVE),
            (71, -2, 0, POSE),
        ],
    ),
    "retries of serial 0 that name the first try": (
        ["1: >1 >>2 >>3 <4 answered, cannot tell"],
        [(0, 0, 0, MOVE), (2, 1, 0, MOVE), (4, 2, 0, MOVE), (5, -2, 0, POSE)],
    ),
    "serial 0 was answered, the same question again is new": (
        ["1: >1 <2 answered, answered", "2: >3 <4 answered, answered"],
        [(0, 0, 0, MOVE), (1, -0.5, 0, POSE), (8, 1, 0, MOVE), (9, -1, 0, POSE)],
    ),
    "the client starts anew with the same serials and bytes": (
        [
            "1: >1 <2 answered, answered",
            "2: >3 unanswered, unanswered",
            "3: >4 <5 answered, answered",
            "4: >6 <7 answered, answered",
        ],
        [
            (0, 1, 0, START_SERVICE),
            (1, -1),
            (2, 2, 0, MOVE),
            (30, 1, 0, START_SERVICE),
            (31, -1),
            (32, 2, 0, MOVE),
            (33, -2, 0, POSE),
        ],
    ),
    "a client whose first request repeats after a while has started anew": (
        ["1: >1 unanswered, unanswered", "2: >2 <3 answered, answered"],
        [(0, 1, 0, START_SERVICE), (3000, 1, 0, START_SERVICE), (3001, -1)],
    ),
    "the capture ends first": (
        ["1: >1 <2 answered, answered", "2: >3 >>4 capture_ended, capture ended"],
        [(0, 1, 0, MOVE), (1, -1, 0, POSE), (8, 2, 0, OTHER), (10, 3, 2, OTHER)],
    ),
    "a copy that the network delays by 100 ms": (
        ["1: >1 =2 <3 answered, answered"],
        [(0, 1, 0, MOVE), (100, 1, 0, MOVE), (101, -1, 0, POSE)],
    ),
    "the same bytes after more than 100 ms are no copy": (
        ["1: >1 unanswered, unanswered", "2: >2 <3 answered, answered"],
        [(0, 1, 0, MOVE), (100.000001, 1, 0, MOVE), (101, -1, 0, POSE)],
    ),
    "the serial of a first try that was never seen is free when its call has settled": (
        ["1: >>1 <2 answered, cannot tell", "2: >3 <4 answered, answered"],
        [(0, 2, 1, MOVE), (1, -2, 0, POSE), (6000, 1, 0, MOVE), (6001, -1, 0, POSE)],
    ),
    "the capture ends first, but a reply was late already": (
        ["1: >1 >>2 late<3 capture_ended, reply late"],
        [(0, 1, 0, MOVE), (2, 2, 1, MOVE), (2.5, -1, 0, POSE)],
    ),
    "a later call was answered just before the end: the reply to the one before may still be on its way": (
        ["1: >1 capture_ended, capture ended", "2: >2 <3 answered, answered"],
        [(0, 1, 0, MOVE), (1, 2, 0, OTHER), (2, -2, 0, POSE)],
    ),
}


@pytest.mark.parametrize("name", PLAYBOOKS)
def test_playbook(name: str) -> None:
    expected, lines = PLAYBOOKS[name]
    script = Script()
    play(script, lines)
    assert summaries(script.track()) == expected


GIVEN_UP = {
    "the capture ends first": ["1: >1 <2 answered, answered", "2: >3 >>4 unanswered, unanswered"],
    "the capture ends first, but a reply was late already": ["1: >1 >>2 late<3 unanswered, reply late"],
}
"""Where the capture reaches far beyond the last attempt, because it holds another client."""


@pytest.mark.parametrize("name", PLAYBOOKS)
def test_playbook_with_another_client_in_between(name: str) -> None:
    expected, lines = PLAYBOOKS[name]
    expected = GIVEN_UP.get(name, expected)
    script, other = Script(), Script()
    play(script, lines)
    play(other, [(0.5, 1, 0, OTHER), (0.7, 1, 0, MOVE), (2.2, -1, 0, POSE), (900, 2, 1, OTHER)])
    mixed = Script()
    mixed.seen = sorted((*script.seen, *other.seen), key=lambda observation: observation.time)
    settled = mixed.track()
    conversation = script.seen[0].flow.conversation
    mine = [
        item
        for item in settled
        if (item.conversation if isinstance(item, Call) else item.observation.flow.conversation)
        is conversation
    ]
    assert [line.partition(": ")[2] for line in summaries(mine)] == [
        line.partition(": ")[2] for line in expected
    ]


def test_a_serial_used_again_on_tcp_is_answered_in_turn() -> None:
    script = Script()
    client = script.client(transport=Transport.TCP)
    client.ask(0, 7, 0, MOVE)
    client.ask(3000, 7, 0, OTHER)
    client.reply(3500, 7, 0, 0, POSE)
    client.reply(3501, 7, 0, 0, r8s(3.0, 4.0))
    client.ask(3600, 8, 0, MOVE)
    client.reply(3601, 8, 0, 0, POSE)
    assert summaries(script.track()) == [
        "1: >1 late<3 unanswered, reply late",
        "2: >2 <4 answered, answered",
        "3: >5 <6 answered, answered",
    ]


def test_a_serial_used_again_on_tcp_while_the_server_is_at_the_first() -> None:
    script = Script()
    client = script.client(transport=Transport.TCP)
    client.ask(0, 7, 0, MOVE)
    client.ask(3000, 7, 0, OTHER)
    client.reply(3400, 7, 0, S_EXECUTING)
    client.reply(9000, 7, 0, 0, POSE)
    client.reply(9001, 7, 0, 0, r8s(3.0, 4.0))
    assert summaries(script.track()) == [
        "1: >1 ...3 late<4 unanswered, reply late",
        "2: >2 <5 answered, answered",
    ]


def test_a_reply_on_tcp_to_a_settled_call_whose_serial_was_used_again_is_a_stray() -> None:
    script = Script()
    client = script.client(transport=Transport.TCP)
    client.ask(0, 7, 0, MOVE)
    client.ask(3000, 7, 0, OTHER)
    client.ask(3600, 8, 0, MOVE)
    client.reply(3601, 8, 0, 0, POSE)
    client.reply(9000, 7, 0, 0, POSE)
    client.reply(9001, 7, 0, 0, r8s(3.0, 4.0))
    assert summaries(script.track()) == [
        "1: >1 unanswered, unanswered",
        "2: >2 unanswered, unanswered",
        "3: >3 <4 answered, answered",
        "stray 5 of 1",
        "stray 6 of 2",
    ]


def test_unanswered_requests_of_one_serial_are_bounded() -> None:
    script = Script()
    client = script.client(transport=Transport.TCP)
    for step in range(MAX_REUSED + 5):
        client.ask(3000 * step, 7, 0, MOVE)
    for serial in range(100, 100 + 3 * MAX_REUSED):
        client.ask(90_000, serial, 0, MOVE)
        client.ask(90_000, serial, 0, MOVE)
    calls = calls_of(script.track())
    assert [call.number for call in calls] == list(range(1, len(script.seen) + 1))


FLOODS: dict[str, tuple[list[str], list[tuple[object, ...]]]] = {
    "tries without end": (
        [
            "1: >1 >>2 >>3 >>4 >>5 >>6 not_followed, not followed",
            "2: >>7 >>8 >>9 >>10 >>11 >>12 not_followed, not followed",
            "3: >>13 <14 answered, cannot tell",
        ],
        [*((20 * n, 1 + n, int(n > 0), MOVE) for n in range(13)), (260, -13, 0, POSE)],
    ),
    "notices without end": (
        ["1: >1 ...2 ...3 ...4 ...5 ...6 not_followed, not followed", "stray 7 of 1", "stray 8 of 1"],
        [(0, 1, 0, MOVE), *((20 * n, -1, S_EXECUTING) for n in range(1, 7)), (140, -1, 0, POSE)],
    ),
    "another answer each time": (
        ["stray 8 of 1", "1: >1 <2 late<3 late<4 late<5 late<6 late<7 answered, executed twice"],
        [(0, 1, 0, MOVE), *((5 * n, -1, 0, r8s(float(n))) for n in range(1, 8))],
    ),
    "copies without end": (
        [
            "1: >1 =2 =3 =4 =5 =6 not_followed, not followed",
            "2: >7 =8 not_followed, not followed",
            "stray 9 of 2",
        ],
        [*((5 * n, 1, 0, MOVE) for n in range(8)), (60, -1, 0, POSE)],
    ),
}


@pytest.mark.parametrize("name", FLOODS)
def test_frames_of_open_calls_are_bounded(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(conversation_pairing, "MAX_EXTRA_FRAMES", 4)
    expected, lines = FLOODS[name]
    script = Script()
    play(script, lines)
    settled = script.track()
    assert summaries(settled) == expected
    assert all(stray.may_answer_evicted for stray in strays_of(settled))


def test_calls_that_have_settled_do_not_count_as_open(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(conversation_pairing, "MAX_EXTRA_FRAMES", 4)
    script = Script()
    client = script.client()
    for start in range(0, 60_000, 6000):
        client.ask(start, 1, 0, MOVE)
        client.ask(start + 2, 2, 1, MOVE)
        client.reply(start + 3, 2, 0, 0, POSE)
    assert {str(call.outcome) for call in calls_of(script.track())} == {"answered"}


def test_nothing_is_a_retry_on_tcp() -> None:
    script = Script()
    client = script.client(transport=Transport.TCP)
    client.ask(0, 1, 0, MOVE)
    client.ask(1, 1, 0, MOVE)
    client.ask(2, 2, 1, MOVE)
    client.reply(3, 1)
    client.reply(4, 1)
    client.reply(5, 2)
    assert [item.partition(": ")[2] for item in summaries(script.track())] == [
        ">1 <4 answered, answered",
        ">2 <5 answered, answered",
        ">3 <6 answered, answered",
    ]


def test_a_late_reply_on_tcp() -> None:
    script = Script()
    client = script.client(transport=Transport.TCP)
    client.ask(0, 1, 0, MOVE)
    client.ask(300, 2, 0, OTHER)
    client.reply(310, 1)
    client.reply(311, 2)
    assert summaries(script.track()) == [
        "1: >1 late<3 unanswered, reply late",
        "2: >2 <4 answered, answered",
    ]


def test_a_server_that_answers_nothing_else_is_waited_for() -> None:
    script = Script()
    client = script.client()
    client.ask(0, 1, 0, MOVE)
    client.ask(600, 2, 0, OTHER)
    client.reply(601, 2, 0, BUSY)
    client.ask(1200, 3, 0, OTHER)
    client.reply(29_000, 1, 0, 0, POSE)
    client.reply(29_000, 3)
    assert summaries(script.track()) == [
        "1: >1 late<5 unanswered, reply late",
        "2: >2 <3 refused, refused",
        "3: >4 <6 answered, answered",
    ]


def test_a_server_that_answers_what_was_asked_later_is_waited_for_no_longer_than_packets_are() -> None:
    script = Script()
    client = script.client()
    client.ask(0, 1, 0, MOVE)
    client.ask(600, 2, 0, OTHER)
    client.reply(10_000, 2)
    client.reply(10_090, 1, 0, 0, POSE)
    client.ask(20_000, 3, 0, MOVE)
    client.ask(20_600, 4, 0, OTHER)
    client.reply(30_000, 4)
    client.ask(30_090, 5, 0, OTHER)
    client.reply(30_200, 3, 0, 0, POSE)
    assert summaries(script.track()) == [
        "1: >1 late<4 unanswered, reply late",
        "2: >2 <3 answered, answered",
        "3: >5 unanswered, unanswered",
        "4: >6 <7 answered, answered",
        "stray 9 of 3",
        "5: >8 capture_ended, capture ended",
    ]


def test_a_reply_that_comes_long_after_its_call_settled_names_it() -> None:
    script = Script()
    client = script.client()
    client.ask(0, 1, 0, MOVE)
    client.ask(16, 2, 0, OTHER)
    client.reply(17, 2, 0, BUSY)
    client.reply(40_000, 1, 0, 0, POSE)
    settled = script.track()
    assert summaries(settled) == [
        "1: >1 unanswered, unanswered",
        "2: >2 <3 refused, refused",
        "stray 4 of 1",
    ]
    assert [stray.observation.number for stray in strays_of(settled)] == [4]


def test_a_large_call_that_settles_leaves_the_newest_call_as_it_is() -> None:
    script = Script()
    client = script.client()
    client.ask(0, 1, 0, slv_move(*[0.0] * (LARGE_CALL // 8)))
    client.ask(1, 2, 0, OTHER)
    client.reply(2, 1)
    client.ask(200, 3, 0, MOVE)
    client.reply(201, 3)
    assert summaries(script.track()) == [
        "1: >1 <3 answered, answered",
        "2: >2 unanswered, unanswered",
        "3: >4 <5 answered, answered",
    ]


def test_the_budget_holds_the_bytes_of_all_open_calls() -> None:
    budget = ByteBudget()
    client = Script().client()
    pairing = ConversationPairing(client.conversation, 0, budget)
    held = [0]
    for request in (client.ask(0, 1, 0, MOVE), client.ask(20, 2, 1, MOVE), client.ask(40, 3, 0, OTHER)):
        pairing.add_request(request, request.item, request.number)  # type: ignore[arg-type]  # a frame
        assert budget.held == pairing.memory_bytes
        held.append(budget.held)
    for reply in (client.reply(41, 3), client.reply(42, 2), client.reply(43, 1)):
        pairing.add_reply(reply, reply.item)  # type: ignore[arg-type]  # a frame
        assert budget.held == pairing.memory_bytes
        held.append(budget.held)
    assert held == sorted(set(held))
    assert len(list(pairing.close(0))) == 2
    assert budget.held == 0
