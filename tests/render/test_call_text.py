"""Calls as lines and trees."""

from __future__ import annotations

import unicodedata
from collections.abc import Callable
from dataclasses import replace

import pytest
from hypothesis import given
from hypothesis import strategies as st

from bcapscope.protocol.tables.function_table import ObjectClass
from bcapscope.render.call_text import CallRenderer, milliseconds, session_text
from bcapscope.render.color_palette import ANSI
from bcapscope.render.timestamp import TimeFormat
from bcapscope.traffic.call import CallState, StrayReply
from bcapscope.traffic.handle_tracker import HandleTracker, ServiceSession, SessionEnding, TrackedObject
from bcapscope.traffic.observation import Transport
from tests.render.calls import script, settled
from tests.render.scenes import HOSTILE
from tests.traffic.playbook import CONNECT, MOVE, POSE, START, Script, calls_of, execute, strays_of, text


def line_of(play: Script) -> str:
    """Write the only call of a script, behind its question."""
    (call,) = calls_of(play.track())
    return CallRenderer().line(call).split(" udp  ")[1]


def test_all_calls_as_lines(golden: Callable[[str, bytes], None]) -> None:
    renderer = CallRenderer()
    golden("call-lines.txt", "".join(f"{renderer.line(*each)}\n" for each in settled()).encode())


def test_all_calls_as_trees(golden: Callable[[str, bytes], None]) -> None:
    renderer = CallRenderer(TimeFormat.EPOCH)
    lines = [line for each in settled() for line in renderer.tree(*each)]
    golden("call-trees.txt", "".join(f"{line}\n" for line in lines).encode())


def test_all_calls_in_colour(golden: Callable[[str, bytes], None]) -> None:
    renderer = CallRenderer(palette=ANSI)
    lines = [line for each in settled() for line in renderer.tree(*each)]
    golden("call-trees.ansi", "".join(f"{line}\n" for line in lines).encode())


def test_colours_are_all_that_they_add() -> None:
    for each in settled():
        plain, coloured = CallRenderer(), CallRenderer(palette=ANSI)
        text = "\n".join(coloured.tree(*each))
        for shade in ("number", "name", "problem", "good", "bad", "dim", "reset"):
            text = text.replace(getattr(ANSI, shade), "")
        assert text == "\n".join(plain.tree(*each))


@pytest.mark.parametrize(
    ("lines", "expected"),
    [
        ([(1, 0)], "Robot_Execute slvMove  S_OK  1.000 ms  frames 1 > 2"),
        ([(1, 0x0F200501)], "Robot_Execute slvMove  S_BUF_FULL  1.000 ms  frames 1 > 2"),
        (
            [(1, 0x83500121)],
            "Robot_Execute slvMove  0x83500121 (slvMove while slave mode is off)  1.000 ms  frames 1 > 2",
        ),
        ([], "Robot_Execute slvMove  capture ended  frame 1"),
        (
            [(0.5, 0x900), (0.7, 0x900), (3, 0)],
            "Robot_Execute slvMove  S_OK  3.000 ms  2 S_EXECUTING  frames 1 > 4",
        ),
    ],
)
def test_how_a_call_ended(lines: list[tuple[float, int]], expected: str) -> None:
    play = Script()
    client = play.client()
    client.ask(0, 7, 0, MOVE)
    for ms, code in lines:
        client.reply(ms, 7, 0, code)
    assert line_of(play) == expected


def test_a_chain_is_drawn_under_its_origin() -> None:
    play = Script()
    client = play.client()
    client.ask(0, 1232, 0, MOVE)
    client.ask(2, 1233, 1232, MOVE)
    client.reply(2.5, 1232, 0, 0, POSE)
    client.reply(3.25, 1233, 1232, 0, POSE)
    (call,) = calls_of(play.track())
    head, *tree = CallRenderer().tree(call)
    assert head.endswith("3.250 ms  1 retry, reply late  frames 1,2 > 3,4")
    assert [line.strip() for line in tree] == [
        "├─ request    frame 1      serial  1232  reserved     0  +0.000 ms at 0.000 ms",
        "├─ retry      frame 2      serial  1233  reserved  1232  +2.000 ms at 2.000 ms",
        "├─ late reply frame 3      serial  1232  reserved     0  +0.500 ms at 2.500 ms  S_OK  discarded",
        "└─ reply      frame 4      serial  1233  reserved  1232  +0.750 ms at 3.250 ms  S_OK",
    ]


def test_a_reply_to_no_call() -> None:
    play = Script()
    client = play.client()
    client.reply(1, 9, 0, 0x80070006)
    (stray,) = strays_of(play.track())
    (line,) = CallRenderer().tree(stray)
    assert line.endswith(
        "reply with serial 9 answers no request that was seen  E_HANDLE (handle is not valid)  frame 1"
    )
    assert "too late for call 7 " in CallRenderer().line(
        StrayReply(stray.observation, 7, may_answer_evicted=False)
    )


def test_what_was_not_followed_is_not_said_to_be_unanswered_or_late() -> None:
    play = Script()
    client = play.client()
    client.ask(0, 1, 0, MOVE)
    client.reply(1, 9)
    call, stray = calls_of(play.track())[0], strays_of(play.track())[0]
    call.state = CallState.EVICTED
    assert CallRenderer().line(call).endswith("Robot_Execute slvMove  not followed  frame 1")
    for found in (stray, replace(stray, call_number=1)):
        line = CallRenderer().line(replace(found, may_answer_evicted=True))
        assert "serial 9 may belong to a call that was not followed to the end  S_OK" in line


def test_the_object_is_named() -> None:
    play = Script()
    play.client().ask(0, 1, 0, execute("Motor", 3))
    (call,) = calls_of(play.track())
    for name, shown in (("Arm", "hRobot=3 (Arm)"), ("", "hRobot=3 "), ("\x1b[2J", "hRobot=3 (\\x1b[2J)")):
        thing = TrackedObject(ObjectClass.ROBOT, 3, name, "", 1, True)
        assert f"Robot_Execute Motor {shown}" in CallRenderer().line(call, thing)


@given(st.text(max_size=200))
def test_names_from_the_wire_are_harmless(name: str) -> None:
    play = Script()
    client = play.client()
    client.ask(0, 1, 0, execute(name))
    client.ask(1, 2, 0, (CONNECT, (text(name),)))
    for call in calls_of(play.track()):
        for line in CallRenderer().tree(call, TrackedObject(ObjectClass.ROBOT, 1, name, "", 1, True)):
            assert_harmless(line)


def assert_harmless(line: str) -> None:
    line.encode("utf-8")
    assert not [char for char in line if unicodedata.category(char)[0] == "C"]


def test_times_count_from_what_is_given() -> None:
    renderer = CallRenderer()
    renderer.set_time_origin(START - 2_000_000_000)
    call = calls_of(script().track())[0]
    assert renderer.line(call).startswith("     1     2.001000 ")


# sessions


def session(ending: SessionEnding, *names: str) -> ServiceSession:
    left = tuple(TrackedObject(ObjectClass.VARIABLE, n, name, "", n, True) for n, name in enumerate(names, 1))
    return ServiceSession(script().client(1, Transport.TCP).conversation, 1, ending, left)


@pytest.mark.parametrize(
    ("given_session", "expected"),
    [
        (session(SessionEnding.STOPPED), "ended by Service_Stop"),
        (session(SessionEnding.RESTARTED), "started again without Service_Stop"),
        (
            session(SessionEnding.OPEN, "I1", ""),
            "no Service_Stop seen; not released: Variable I1, Variable 2",
        ),
        (
            session(SessionEnding.OPEN, *"abcdefgh"),
            "no Service_Stop seen; not released: Variable a, Variable b, Variable c, Variable d, Variable e, "
            "Variable f and 2 more",
        ),
    ],
)
def test_how_a_session_ended(given_session: ServiceSession, expected: str) -> None:
    assert session_text(given_session) == f"10.0.0.2:1 > 10.0.0.1:5007: {expected}"


def test_sessions_of_hostile_objects_are_harmless() -> None:
    assert_harmless(session_text(session(SessionEnding.OPEN, HOSTILE)))
    assert len(session_text(session(SessionEnding.OPEN, "x" * 60_000))) < 1000
    handles = HandleTracker()
    for call in calls_of(script().track()):
        handles.on_call(call)
    for each in handles.sessions():
        assert_harmless(session_text(each))


# parts


def test_milliseconds() -> None:
    assert [milliseconds(ns) for ns in (0, 1_234_567, -500_000)] == ["0.000", "1.235", "-0.500"]


def test_frames_of_a_call() -> None:
    texts = {CallRenderer().line(call).rpartition("  ")[2] for call in calls_of(script().track())}
    assert {"frames 10,11,12 > 13,14", "frame 28"} <= texts
