"""Replies that came too late, twice or never."""

from __future__ import annotations

from bcapscope.protocol.codec.variant import VT, Variant
from tests.analysis.plays.scene import Scene
from tests.analysis.scenes import HOME, ROBOT, Play, Story, Talker, good
from tests.samples.calls import i4, r8s, text

_POSE = r8s(*HOME)
_MOVE = (ROBOT, text("slvMove"), _POSE)


def _in_slave_mode(story: Story) -> Talker:
    client = story.client()
    client.drive(4)
    return client


def _late(story: Story) -> None:
    client = _in_slave_mode(story)
    first = client.ask(82, "Robot_Execute", *_MOVE)
    again = client.ask(84, "Robot_Execute", *_MOVE, reserved=first)
    client.answer(85, first, _POSE)
    client.answer(86, again, _POSE, reserved=first)
    client.move(90, 4)


def _gave_up(story: Story) -> None:
    """The reply of many bug reports: it came after 19 ms, and the client had gone on at 16 ms."""
    client = _in_slave_mode(story)
    first = client.ask(82, "Robot_Execute", *_MOVE, serial=4711)
    second = client.ask(98, "Robot_Execute", ROBOT, text("slvMove"), r8s(0.1, *HOME[1:]))
    client.answer(101, first, _POSE)
    client.answer(102, second, _POSE)
    client.move(106, 4)


def _answered_after(last: float) -> Play:
    """Three attempts 16 ms apart, and a reply so long after the last; the client goes on after it."""

    def play(story: Story) -> None:
        client = _in_slave_mode(story)
        first = client.ask(82, "Robot_Execute", *_MOVE)
        client.ask(98, "Robot_Execute", *_MOVE, reserved=first)
        again = client.ask(114, "Robot_Execute", *_MOVE, reserved=first)
        client.answer(114 + last, again, _POSE)
        client.move(117 + last, 4)

    return play


def _in_time(story: Story) -> None:
    client = _in_slave_mode(story)
    first = client.ask(82, "Robot_Execute", *_MOVE)
    client.answer(97, first, _POSE)
    client.move(98, 4)


def _unanswered(story: Story) -> None:
    client = story.client()
    client.open()
    first = client.ask(50, "Robot_Execute", ROBOT, text("Motor"), i4(1))
    client.ask(1050, "Robot_Execute", ROBOT, text("Motor"), i4(1), reserved=first)
    client.execute(2050, "CurJnt", result=_POSE)


def _capture_ends_first(story: Story) -> None:
    client = story.client()
    client.open()
    client.ask(50, "Robot_Execute", ROBOT, text("Motor"), i4(1))


def _stopped(story: Story) -> None:
    client = story.client()
    client.open()
    first = client.ask(50, "Robot_Execute", *_MOVE)
    for number in range(1, 5):
        client.ask(50 + 16 * number, "Robot_Execute", *_MOVE, reserved=first)
    story.client(50002).call(900, "Service_Start", text(",WDT=400"))


def _goes_on_after_a_while(story: Story) -> None:
    client = story.client()
    client.open()
    first = client.ask(50, "Robot_Execute", *_MOVE)
    client.ask(66, "Robot_Execute", *_MOVE, reserved=first)
    story.client(50002).call(8000, "Service_Start", text(",WDT=400"))
    client.execute(9000, "CurJnt", result=_POSE)


def _still_trying(story: Story) -> None:
    client = story.client()
    client.open()
    first = client.ask(50, "Robot_Execute", *_MOVE)
    client.ask(66, "Robot_Execute", *_MOVE, reserved=first)


def _silent(story: Story) -> None:
    client = story.client()
    first = client.ask(0, "Service_Start", text(""))
    for number in range(1, 4):
        client.ask(1000 * number, "Service_Start", text(""), reserved=first)


def _just_began(story: Story) -> None:
    """Two requests, and the capture ends before either can have been given up."""
    client = story.client()
    client.ask(0, "Service_Start", text(""))
    client.ask(1, "Service_Start", text(""))


def _asks_and_asks(story: Story) -> None:
    client = story.client()
    for number in range(3):
        client.ask(1000 * number, "Service_Start", text(""))


def _twice(story: Story) -> None:
    client = story.client()
    client.open()
    first = client.ask(50, "Robot_Execute", ROBOT, text("GetLogCount"), i4(0))
    again = client.ask(1050, "Robot_Execute", ROBOT, text("GetLogCount"), i4(0), reserved=first)
    client.answer(1051, first, i4(17))
    client.answer(1052, again, i4(18))
    client.close(1100)


def _stored_answer(story: Story) -> None:
    client = story.client()
    client.open()
    first = client.ask(50, "Robot_Execute", ROBOT, text("GetLogCount"), i4(0))
    again = client.ask(1050, "Robot_Execute", ROBOT, text("GetLogCount"), i4(0), reserved=first)
    client.answer(1051, first, i4(17))
    client.answer(1052, again, i4(17))
    client.close(1100)


def _reply_lost(story: Story) -> None:
    client = story.client()
    client.open()
    first = client.ask(50, "Robot_Execute", ROBOT, text("Motor"), i4(1))
    client.answer(52, first)
    again = client.ask(1050, "Robot_Execute", ROBOT, text("Motor"), i4(1), reserved=first)
    client.answer(1051, again, reserved=first)
    client.close(1100)


def _crossed(every: float) -> Play:
    """A client that is paced by a clock, `every` ms after each reply, and a reply 1 ms before a retry."""

    def play(story: Story) -> None:
        client = story.client()
        for number in range(6):
            client.execute(every * number, "CurJnt", result=_POSE, takes=0.5)
        first = client.ask(50, "Robot_Execute", *_MOVE)
        client.answer(57, first, _POSE)
        again = client.ask(58, "Robot_Execute", *_MOVE, reserved=first)
        client.answer(58.1, again, _POSE)

    return play


def _retried(story: Story) -> None:
    client = story.client()
    client.open()
    first = client.ask(50, "Robot_Execute", ROBOT, text("Motor"), i4(1))
    again = client.ask(1050, "Robot_Execute", ROBOT, text("Motor"), i4(1), reserved=first)
    client.answer(1051, again, reserved=first)
    client.close(1100)


def _waits_in_slave_mode(takes: float) -> Play:
    """Set points in a waiting mode, tried each 2 ms, of which one takes so many ms."""

    def play(story: Story) -> None:
        client = story.client()
        client.open()
        client.ready()
        client.enter(40)
        for number in range(20):
            begin, wait = 50 + 16 * number, takes if number == 10 else 7.9
            first = client.ask(begin, "Robot_Execute", *_MOVE)
            tries = [first]
            for late in range(2, int(wait) + 1, 2):
                tries.append(client.ask(begin + late, "Robot_Execute", *_MOVE, reserved=first))
            client.answer(begin + wait, tries[-1], _POSE, reserved=first)
        client.leave(400)

    return play


def _very_late(story: Story) -> None:
    client = story.client()
    client.open()
    asked = client.ask(50, "Robot_Execute", ROBOT, text("CurJnt"), Variant(VT.EMPTY, None))
    for number in range(40):
        client.execute(100 + 100 * number, "CurJnt", result=_POSE)
    client.answer(4300, asked, _POSE)
    client.close(4400)


def _to_nothing(story: Story) -> None:
    client = story.client()
    client.open()
    client.answer(50, 700, i4(1))
    client.close(60)


def _to_a_later_serial(answers: bool) -> Play:
    """A reply to the serial after the latest one, which the client uses later or never."""

    def play(story: Story) -> None:
        client = story.client()
        client.open()
        client.answer(40, client.serial + 1, i4(1))
        if not answers:
            client.serial += 1
        client.close(50)

    return play


def _begins_with_reply(story: Story) -> None:
    client = story.client()
    client.answer(0, 700, i4(1))
    client.open(10)
    client.close(60)


SCENES = (
    Scene(
        "late-reply",
        _late,
        (23, 24, 25, 26),
        (
            "The reply to slvMove 12 came 3.0 ms after the request",
            "Your client had given up after 2.0 ms",
            "1 retry",
        ),
        _in_time,
    ),
    Scene(
        "client-gave-up",
        _gave_up,
        (23, 25),
        ("The reply to slvMove 4711 came 19 ms after the request. Your client had given up after 16 ms",),
        _late,
    ),
    Scene(
        "client-gave-up",
        _answered_after(35),
        (23, 24, 25, 26),
        ("came 35 ms after the request. Your client had probably given up after 16 ms",),
        _answered_after(31),
    ),
    Scene(
        "no-reply",
        _goes_on_after_a_while,
        (9, 10),
        ("sent slvMove 5 twice and got no reply. It continued after 8.95 s.",),
        _stopped,
    ),
    Scene(
        "no-reply",
        _unanswered,
        (9, 10),
        (
            "At 0.050 s your client sent Motor 5 twice and got no reply",
            "continued after 2 s",
            "does not show",
        ),
        _capture_ends_first,
    ),
    Scene(
        "client-stopped",
        _stopped,
        (9, 10, 11, 12, 13),
        (
            "sent slvMove 5 5 times in 64 ms without any reply",
            "the remaining 787 ms of the capture",
            "80000900",
        ),
        _still_trying,
    ),
    Scene(
        "controller-silent",
        _silent,
        (1, 4),
        ("192.168.0.1:5007 never answered your client", "1 call with 4 attempts in 3 s"),
        _capture_ends_first,
    ),
    Scene(
        "controller-silent",
        _asks_and_asks,
        (1, 3),
        ("192.168.0.1:5007 never answered your client, which made 3 calls in 2 s",),
        _just_began,
    ),
    Scene(
        "executed-twice",
        _twice,
        (9, 10, 11, 12),
        ("GetLogCount 5", "different results"),
        _stored_answer,
        "late-reply",
    ),
    Scene(
        "reply-lost",
        _reply_lost,
        (9, 10, 11, 12),
        ("reply to Motor 5 was captured after 2.0 ms", "retried"),
        _retried,
    ),
    Scene(
        "retried",
        _crossed(8),
        (13, 14, 15, 16),
        ("reply to slvMove 7 was captured 1.0 ms before a retry", "the two crossed on the network"),
        _crossed(0.6),
    ),
    Scene("reply-lost", _crossed(0.6), (13, 14, 15, 16), ("captured after 7.0 ms",), _crossed(8)),
    Scene(
        "retried",
        _retried,
        (9, 10, 11),
        ("your client sent Motor 5", "1 s later, after 2 attempts"),
        good,
    ),
    Scene(
        "retried",
        _waits_in_slave_mode(13.9),
        (65, 66, 67, 68, 69, 70, 71, 72),
        ("The reply came 14 ms later, after 7 attempts",),
        _waits_in_slave_mode(7.9),
    ),
    Scene("very-late-reply", _very_late, (90,), ("a reply to call 5 (serial 5)",), _late),
    Scene("reply-to-nothing", _to_a_later_serial(True), (9,), ("serial 5",), _to_a_later_serial(False)),
    Scene("reply-to-nothing", _to_nothing, (9,), ("serial 700",), _begins_with_reply),
)
