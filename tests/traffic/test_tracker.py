"""The tracker, by playbooks: this was seen, so these calls come out."""

from __future__ import annotations

import pytest

from bcapscope.protocol.frame import Malformed, Problem
from bcapscope.traffic.convention import Convention, ReplyReserved
from bcapscope.traffic.exchange import Exchange, Settled
from bcapscope.traffic.lane import (
    COPIES_WITHIN_NS,
    EXECUTION_NS,
    LATE_WITHIN_NS,
    MOST_SHADOWED,
    RETRY_WITHIN_NS,
)
from bcapscope.traffic.observation import Direction, Transport
from bcapscope.traffic.question import MOST_CONVERSATIONS, Question
from bcapscope.traffic.tracker import MOST_OPEN, Tracker
from bcapscope.traffic.verdict import Outcome, Verdict
from tests.traffic.playbook import (
    BUSY,
    CONNECT,
    EXECUTE,
    GET_ROBOT,
    GET_VARIABLE,
    MS,
    S_EXECUTING,
    SERVICE_START,
    START,
    Script,
    calls_of,
    execute,
    i4,
    r8s,
    slv_move,
    strays_of,
    summaries,
    text,
)

POSE = r8s(1.0, 2.0)
MOVE = slv_move(1.0, 2.0)
OTHER = slv_move(3.0, 4.0)
START_SERVICE = (SERVICE_START, (text(""),))


def test_the_retry_story_of_2009_is_one_call() -> None:
    script = Script()
    client = script.client()
    client.ask(0, 1232, 0, MOVE)
    client.ask(2, 1233, 1232, MOVE)
    client.ask(4, 1234, 1232, MOVE)
    client.ask(6, 1235, 1232, MOVE)
    client.reply(6.5, 1233, 1232, 0, POSE)
    client.reply(7.2, 1235, 1232, 0, POSE)
    (call,) = calls_of(script.track())
    assert call.serials == (1232, 1233, 1234, 1235)
    assert call.retries == 3
    assert [reply.number for reply in call.late_replies] == [5]
    assert call.reply is not None
    assert call.reply.number == 6
    assert (call.outcome, call.verdict) == (Outcome.ANSWERED, Verdict.REPLY_LATE)
    assert (call.convention, call.reply_reserved) == (Convention.SEED, ReplyReserved.ECHOED)
    assert (call.latency, call.rtt) == (7_200_000, 1_200_000)
    assert call.question == Question(EXECUTE, "slvMove")
    assert call.hresult == 0


def test_calls_without_trouble() -> None:
    script = Script()
    client = script.client()
    client.ask(0, 1, 1, START_SERVICE)
    client.reply(1, 1)
    client.ask(8, 2, 2, MOVE)
    client.reply(9.5, 2, 0, 0x83500121)
    first, second = calls_of(script.track())
    assert (first.call, first.verdict, first.latency, first.rtt) == (1, Verdict.ANSWERED, MS, MS)
    assert (second.outcome, second.verdict) == (Outcome.REFUSED, Verdict.REFUSED)
    assert second.hresult == 0x83500121
    assert first.late_replies == first.lost_replies == first.notices == first.duplicates == ()
    assert repr(first) == "Exchange(1, 1, None: request 1, reply 2)"


PLAYBOOKS: dict[str, tuple[list[str], list[tuple[object, ...]]]] = {
    "a reply seen in time, and yet a retry: lost behind the place of capture": (
        ["1: >1 lost<2 >>3 <4 answered, reply lost"],
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
    "a client that asks without waiting loses one": (
        ["1: >1 unanswered, unanswered", "2: >2 <3 answered, answered"],
        [(0, 1, 0, MOVE), (1, 2, 0, OTHER), (2.5, -2, 0, POSE)],
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
    "the capture ends first, but a reply was late already": (
        ["1: >1 >>2 late<3 capture_ended, reply late"],
        [(0, 1, 0, MOVE), (2, 2, 1, MOVE), (2.5, -1, 0, POSE)],
    ),
    "the server answered a later call, so it has nothing more to say to the one before": (
        ["1: >1 unanswered, unanswered", "2: >2 <3 answered, answered"],
        [(0, 1, 0, MOVE), (1, 2, 0, OTHER), (2, -2, 0, POSE)],
    ),
}


def play(script: Script, lines: list[tuple[object, ...]], transport: Transport = Transport.UDP) -> None:
    """Write the lines down: (ms, serial, reserved, question), or (ms, -serial, code, *results) for a reply.

    A reply to serial 0 is written as -0.5.
    """
    client = script.client(transport=transport)
    for ms, serial, *rest in lines:
        assert isinstance(ms, int | float)
        assert isinstance(serial, int | float)
        if serial >= 0:
            client.ask(ms, int(serial), *rest)  # type: ignore[arg-type]  # a table of literals
        else:
            code, *results = rest or (0,)
            client.reply(ms, int(-serial), 0, code, *results)  # type: ignore[arg-type]  # likewise


@pytest.mark.parametrize("name", PLAYBOOKS)
def test_playbook(name: str) -> None:
    expected, lines = PLAYBOOKS[name]
    script = Script()
    play(script, lines)
    assert summaries(script.track()) == expected


@pytest.mark.parametrize("name", PLAYBOOKS)
def test_playbook_with_another_client_in_between(name: str) -> None:
    expected, lines = PLAYBOOKS[name]
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
        if (item.conversation if isinstance(item, Exchange) else item.seen.flow.conversation) is conversation
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


def test_a_serial_used_again_on_tcp_long_after_the_first_settled() -> None:
    script = Script()
    client = script.client(transport=Transport.TCP)
    client.ask(0, 7, 0, MOVE)
    client.ask(3000, 7, 0, OTHER)
    client.reply(3400, 7, 0, S_EXECUTING)
    client.reply(9000, 7, 0, 0, POSE)
    client.reply(9001, 7, 0, 0, r8s(3.0, 4.0))
    assert summaries(script.track()) == [
        "1: >1 ...3 unanswered, unanswered",
        "stray 4 of 1",
        "2: >2 <5 answered, answered",
    ]


def test_unanswered_requests_of_one_serial_are_bounded() -> None:
    script = Script()
    client = script.client(transport=Transport.TCP)
    for step in range(MOST_SHADOWED + 5):
        client.ask(3000 * step, 7, 0, MOVE)
    for serial in range(100, 100 + 3 * MOST_SHADOWED):
        client.ask(90_000, serial, 0, MOVE)
        client.ask(90_000, serial, 0, MOVE)
    calls = calls_of(script.track())
    assert [call.call for call in calls] == list(range(1, len(script.seen) + 1))


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


def test_a_reply_that_comes_long_after_its_call_settled_names_it() -> None:
    script = Script()
    client = script.client()
    client.ask(0, 1, 0, MOVE)
    client.ask(16, 2, 0, OTHER)
    client.reply(17, 2, 0, BUSY)
    client.reply(10_000, 1, 0, 0, POSE)
    settled = script.track()
    assert summaries(settled) == [
        "1: >1 unanswered, unanswered",
        "2: >2 <3 refused, refused",
        "stray 4 of 1",
    ]
    assert [stray.seen.number for stray in strays_of(settled)] == [4]


def test_skipped_handles_show_that_a_call_was_executed_more_than_once() -> None:
    script = Script()
    client = script.client()
    client.ask(0, 1, 1, (CONNECT, (text(""), text(""), text(""), text(""))))
    client.reply(1, 1, 0, 0, i4(1))
    get_robot = (GET_ROBOT, (i4(1), text("Arm"), text("")))
    client.ask(2, 2, 2, get_robot)
    client.ask(22, 3, 2, get_robot)
    client.ask(42, 4, 2, get_robot)
    client.reply(43, 4, 0, 0, i4(4))
    client.ask(50, 5, 5, (GET_VARIABLE, (i4(1), text("I1"), text(""))))
    client.reply(51, 5, 0, 0, i4(5))
    _, robot, variable = calls_of(script.track())
    assert (robot.verdict, robot.skipped_handles) == (Verdict.EXECUTED_TWICE, 2)
    assert (variable.verdict, variable.skipped_handles) == (Verdict.ANSWERED, 0)


@pytest.mark.parametrize(
    ("first", "second", "tries"),
    [
        (1, 5, 3),  # more skipped than tries went unanswered
        (5, 1, 3),  # not in sequence
        (1, 2, 3),  # none skipped
        (1, 3, 1),  # not tried again
    ],
)
def test_other_handles_show_nothing(first: int, second: int, tries: int) -> None:
    script = Script()
    client = script.client()
    client.ask(0, 1, 1, (CONNECT, ()))
    client.reply(1, 1, 0, 0, i4(first))
    for step in range(tries):
        client.ask(2 + 20 * step, 2 + step, 2, (GET_ROBOT, (i4(1),)))
    client.reply(100, 1 + tries, 0, 0, i4(second))
    assert calls_of(script.track())[1].skipped_handles == 0


def test_handles_begin_anew_with_the_session() -> None:
    script = Script()
    client = script.client()
    client.ask(0, 1, 1, (CONNECT, ()))
    client.reply(1, 1, 0, 0, i4(1))
    client.ask(2, 2, 2, START_SERVICE)
    client.reply(3, 2)
    client.ask(4, 3, 3, (CONNECT, ()))
    client.ask(24, 4, 3, (CONNECT, ()))
    client.reply(25, 4, 0, 0, i4(3))
    assert calls_of(script.track())[2].verdict is Verdict.CANNOT_TELL


@pytest.mark.parametrize("result", [text("no handle"), r8s(1.0)])
def test_a_result_that_is_no_handle_is_left_alone(result: object) -> None:
    script = Script()
    client = script.client()
    client.ask(0, 1, 1, (CONNECT, ()))
    client.reply(1, 1, 0, 0, result)  # type: ignore[arg-type]  # a Variant
    client.ask(2, 2, 2, (CONNECT, ()))
    client.reply(3, 2, 0, 0)
    assert [call.verdict for call in calls_of(script.track())] == [Verdict.ANSWERED] * 2


CONVENTIONS: dict[str, tuple[Transport, list[tuple[int, int, object]], list[str]]] = {
    "0 first tells nothing yet": (Transport.UDP, [(1, 0, MOVE), (2, 0, OTHER)], ["unknown"] * 2),
    "a second try tells nothing either": (Transport.UDP, [(1, 0, MOVE), (2, 1, MOVE)], ["unknown"]),
    "the first serial in the third try": (
        Transport.UDP,
        [(1, 0, MOVE), (2, 1, MOVE), (3, 1, MOVE)],
        ["seed"],
    ),
    "the serial before in the third try": (
        Transport.UDP,
        [(1, 0, MOVE), (2, 1, MOVE), (3, 2, MOVE)],
        ["chain"],
    ),
    "the own serial": (Transport.UDP, [(1, 1, MOVE), (2, 1, MOVE), (3, 1, MOVE)], ["own"]),
    "another client on the same port": (Transport.UDP, [(1, 1, MOVE), (2, 0, OTHER)], ["unknown"] * 2),
    "first tries never seen, one before named": (Transport.UDP, [(8, 7, MOVE), (9, 8, MOVE)], ["chain"]),
    "first tries never seen, the first named": (Transport.UDP, [(8, 7, MOVE), (9, 7, MOVE)], ["unknown"]),
    "TCP, 0": (Transport.TCP, [(1, 0, MOVE)], ["tcp0"]),
    "TCP, 1": (Transport.TCP, [(2, 1, MOVE)], ["tcp1"]),
    "TCP, 1 of serial 1": (Transport.TCP, [(1, 1, MOVE)], ["unknown"]),
    "TCP, 1 again": (Transport.TCP, [(1, 1, MOVE), (2, 1, OTHER)], ["tcp1"] * 2),
    "TCP, the own serial": (Transport.TCP, [(1, 1, MOVE), (2, 2, OTHER)], ["own"] * 2),
    "TCP, something else": (Transport.TCP, [(1, 9, MOVE)], ["unknown"]),
}


@pytest.mark.parametrize("name", CONVENTIONS)
def test_the_convention_is_named(name: str) -> None:
    transport, requests, expected = CONVENTIONS[name]
    script = Script()
    client = script.client(transport=transport)
    for step, (serial, reserved, question) in enumerate(requests):
        client.ask(3 * step, serial, reserved, question)  # type: ignore[arg-type]  # a table of literals
    assert [call.convention for call in calls_of(script.track())] == [Convention(word) for word in expected]


@pytest.mark.parametrize(
    ("asked", "answered", "expected"),
    [
        (1, 0, ReplyReserved.ZERO),
        (1, 1, ReplyReserved.ECHOED),
        (1, 9, ReplyReserved.UNKNOWN),
        (0, 0, ReplyReserved.UNKNOWN),
    ],
)
def test_what_replies_carry_is_noted(asked: int, answered: int, expected: ReplyReserved) -> None:
    script = Script()
    client = script.client()
    client.ask(0, 1, asked, MOVE)
    client.reply(1, 1, answered)
    assert calls_of(script.track())[0].reply_reserved is expected


def test_bytes_that_are_no_frame_belong_to_no_call() -> None:
    script = Script()
    client = script.client()
    client.see(0, Direction.REQUEST, Malformed(b"x", (Problem(0, "soh", "no frame"),)))
    assert script.track() == []


def test_calls_settle_by_time_alone() -> None:
    script = Script()
    client = script.client()
    answered = client.ask(0, 1, 1, MOVE)
    reply = client.reply(1, 1)
    tracker = Tracker()
    assert list(tracker.observe(answered)) == []
    assert [call.call for call in tracker.open] == [1]
    assert tracker.open[0].outcome is Outcome.CAPTURE_ENDED
    assert list(tracker.observe(reply)) == []
    assert list(tracker.expire(reply.time + RETRY_WITHIN_NS - 1)) == []
    assert summaries(tracker.expire(reply.time + RETRY_WITHIN_NS)) == ["1: >1 <2 answered, answered"]
    assert tracker.open == []
    silent = client.ask(6000, 2, 2, MOVE)
    assert list(tracker.observe(silent)) == []
    assert list(tracker.expire(silent.time + EXECUTION_NS - 1)) == []
    assert summaries(tracker.expire(silent.time + EXECUTION_NS)) == ["2: >3 unanswered, unanswered"]


def test_a_call_settles_soon_once_the_client_goes_on() -> None:
    script = Script()
    client = script.client()
    tracker = Tracker()
    tracker.observe(client.ask(0, 1, 1, MOVE))
    reply = client.reply(1, 1)
    tracker.observe(reply)
    tracker.observe(client.ask(8, 2, 2, OTHER))
    assert summaries(tracker.expire(reply.time + COPIES_WITHIN_NS)) == ["1: >1 <2 answered, answered"]
    gone_on = client.ask(200, 3, 3, MOVE)
    tracker.observe(gone_on)
    assert list(tracker.expire(gone_on.time + LATE_WITHIN_NS - 1)) == []
    assert summaries(tracker.expire(gone_on.time + LATE_WITHIN_NS)) == ["2: >3 unanswered, unanswered"]


def test_calls_of_a_conversation_come_in_order_and_others_do_not_wait() -> None:
    script = Script()
    slow, quick = script.client(1), script.client(2)
    tracker = Tracker()
    tracker.observe(slow.ask(0, 1, 1, MOVE))
    settled: list[Settled] = []
    for step in range(100):
        settled += tracker.observe(quick.ask(8 * step, 1 + step, 1 + step, MOVE))
        settled += tracker.observe(quick.reply(8 * step + 1, 1 + step))
    assert len(settled) > 80
    assert {call.conversation for call in calls_of(settled)} == {quick.conversation}
    settled += tracker.close()
    assert sorted(call.call for call in calls_of(settled)) == list(range(1, 102))
    for client in (slow, quick):
        numbers = [call.call for call in calls_of(settled) if call.conversation is client.conversation]
        assert numbers == sorted(numbers)


def test_a_clock_that_is_set_back_stops_nothing() -> None:
    script = Script()
    client = script.client()
    for step in range(1, 60):
        client.ask(3_600_000 - 120_000 * step, step, step, MOVE)
        client.reply(3_600_000 - 120_000 * step + 1, step)
    calls = calls_of(script.track())
    assert [call.verdict for call in calls] == [Verdict.ANSWERED] * 59


def test_open_calls_are_bounded_and_the_busiest_makes_room() -> None:
    script = Script()
    patient, flood = script.client(1), script.client(2)
    tracker = Tracker()
    tracker.observe(patient.ask(0, 1, 1, MOVE))
    settled: list[Settled] = []
    for step in range(3 * MOST_OPEN):
        settled += tracker.observe(flood.ask(0.001 * step, step % 65536, step % 65536, MOVE))
        assert len(tracker.open) <= MOST_OPEN if step % 1000 == 0 else True
    assert patient.conversation in {call.conversation for call in tracker.open}
    settled += tracker.close()
    assert [call.call for call in calls_of(settled) if call.conversation is flood.conversation] == list(
        range(2, 3 * MOST_OPEN + 2)
    )


def test_conversations_are_bounded_and_the_silent_one_goes_first() -> None:
    script = Script()
    tracker = Tracker()
    settled: list[Settled] = []
    clients = [script.client(port) for port in range(MOST_CONVERSATIONS + 2)]
    for step, client in enumerate(clients):
        settled += tracker.observe(client.ask(0.001 * step, 1, 1, MOVE))
    assert [call.conversation for call in calls_of(settled)] == [
        client.conversation for client in clients[:2]
    ]
    assert {call.outcome for call in calls_of(settled)} == {Outcome.UNANSWERED}
    assert len(tracker.open) == MOST_CONVERSATIONS


def test_time_starts_anywhere() -> None:
    script = Script()
    client = script.client()
    client.ask(-START / MS, 1, 1, MOVE)
    client.reply(-START / MS, 1)
    assert summaries(script.track()) == ["1: >1 <2 answered, answered"]


def test_execute_questions_are_told() -> None:
    script = Script()
    client = script.client()
    client.ask(0, 1, 1, execute("CurPos"))
    assert calls_of(script.track())[0].question == Question(EXECUTE, "CurPos")
