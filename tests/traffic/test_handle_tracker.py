"""What handles stand for, and what was left behind."""

from __future__ import annotations

import pytest

from bcapscope.protocol.codec.frame import Frame, Framing, Malformed, encode_frame
from bcapscope.protocol.codec.variant import VT, Variant
from bcapscope.protocol.tables.function_table import ObjectClass
from bcapscope.traffic.call_kind import MAX_CONVERSATIONS
from bcapscope.traffic.handle_tracker import (
    MAX_OBJECTS,
    MAX_SESSIONS,
    HandleTracker,
    ServiceSession,
    SessionEnding,
    handle_of,
)
from bcapscope.traffic.observation import Direction
from tests.traffic.playbook import (
    CONNECT,
    DISCONNECT,
    EXECUTE,
    GET_ROBOT,
    GET_VALUE,
    GET_VARIABLE,
    ROBOT_RELEASE,
    SERVICE_START,
    SERVICE_STOP,
    VARIABLE_RELEASE,
    Client,
    Script,
    calls_of,
    i4,
    text,
)

GET_MESSAGE = 18
E_FAIL = 0x80004005


class Person:
    """A client that asks one thing after the other; `labels` tells what each call was about."""

    def __init__(self, script: Script, port: int = 50001) -> None:
        self.client: Client = script.client(port)
        self.serial = 0
        self.ms = 0.0

    def call(self, function: int, *arguments: Variant, gives: int | None = None, code: int = 0) -> None:
        self.serial += 1
        self.ms += 10
        self.client.ask(self.ms, self.serial, self.serial, (function, arguments))
        results = () if gives is None else (i4(gives),)
        self.client.reply(self.ms + 1, self.serial, 0, code, *results)

    def open(self) -> None:
        """Make a controller with handle 1 and a robot with handle 2."""
        self.call(SERVICE_START, text(""))
        self.call(CONNECT, *map(text, ("RC8", "CaoProv.DENSO.VRC", "localhost", "")), gives=1)
        self.call(GET_ROBOT, i4(1), text("Arm"), text(""), gives=2)


def follow(script: Script) -> tuple[list[str | None], tuple[ServiceSession, ...]]:
    """Tell what each call was about, and the sessions."""
    handles = HandleTracker()
    things = [handles.on_call(call) for call in calls_of(script.track())]
    return [None if thing is None else thing.label for thing in things], handles.sessions()


def left(session: ServiceSession) -> list[str]:
    return [thing.label for thing in session.unreleased]


def test_a_session_in_order() -> None:
    script = Script()
    person = Person(script)
    person.open()
    person.call(GET_VARIABLE, i4(1), text("I1"), text(""), gives=3)
    person.call(GET_VALUE, i4(3))
    person.call(EXECUTE, i4(2), text("slvMove"), i4(0))
    person.call(VARIABLE_RELEASE, i4(3))
    person.call(ROBOT_RELEASE, i4(2))
    person.call(DISCONNECT, i4(1))
    person.call(SERVICE_STOP)
    labels, (session,) = follow(script)
    assert labels == [None, None, "RC8", "RC8", "I1", "Arm", "I1", "Arm", "RC8", None]
    assert session.is_clean
    assert (session.started_by_call, session.ending) == (1, SessionEnding.STOPPED)


def test_what_was_not_released_is_left() -> None:
    script = Script()
    person = Person(script)
    person.open()
    person.call(GET_VARIABLE, i4(1), text("I1"), text(""), gives=3)
    person.call(ROBOT_RELEASE, i4(2), code=E_FAIL)
    person.call(SERVICE_STOP)
    _, (session,) = follow(script)
    assert not session.is_clean
    assert left(session) == ["RC8", "Arm", "I1"]
    variable = session.unreleased[2]
    assert (variable.kind, variable.handle, variable.parent) == (ObjectClass.VARIABLE, 3, "RC8")
    assert (variable.created_by_call, variable.known_to_client) == (4, True)


def test_a_session_that_is_still_open() -> None:
    script = Script()
    Person(script).open()
    _, (session,) = follow(script)
    assert (session.ending, left(session)) == (SessionEnding.OPEN, ["RC8", "Arm"])


def test_a_client_that_starts_anew_left_everything() -> None:
    script = Script()
    person = Person(script)
    person.open()
    person.open()
    _, (first, second) = follow(script)
    assert (first.ending, left(first)) == (SessionEnding.RESTARTED, ["RC8", "Arm"])
    assert (second.ending, second.started_by_call) == (SessionEnding.OPEN, 4)


def test_a_refused_start_ends_nothing() -> None:
    script = Script()
    person = Person(script)
    person.open()
    person.call(SERVICE_START, text(""), code=E_FAIL)
    _, (session,) = follow(script)
    assert session.started_by_call == 1


def test_a_handle_is_used_again_after_its_release() -> None:
    script = Script()
    person = Person(script)
    person.open()
    person.call(ROBOT_RELEASE, i4(2))
    person.call(GET_ROBOT, i4(1), text("Other"), text(""), gives=2)
    person.call(EXECUTE, i4(2), text("CurPos"), i4(0))
    labels, _ = follow(script)
    assert labels[3:] == ["Arm", "RC8", "Other"]


def test_a_handle_that_is_given_again_replaces_the_one_before() -> None:
    script = Script()
    person = Person(script)
    person.open()
    person.call(GET_VARIABLE, i4(1), text("I1"), text(""), gives=3)
    person.call(GET_ROBOT, i4(1), text("Other"), text(""), gives=2)
    person.call(EXECUTE, i4(2), text("CurPos"), i4(0))
    labels, (session,) = follow(script)
    assert labels[5] == "Other"
    assert left(session) == ["RC8", "I1", "Other"]


def test_handles_are_counted_apart_for_each_class() -> None:
    script = Script()
    person = Person(script)
    person.call(CONNECT, *map(text, ("RC7", "", "", "")), gives=1)
    person.call(GET_ROBOT, i4(1), text("Arm"), text(""), gives=1)
    person.call(EXECUTE, i4(1), text("slvMove"), i4(0))
    person.call(GET_VARIABLE, i4(1), text("I1"), text(""), gives=1)
    person.call(GET_VALUE, i4(1))
    assert follow(script)[0] == [None, "RC7", "Arm", "RC7", "I1"]


def test_handles_belong_to_their_client() -> None:
    script = Script()
    one, two = Person(script, 1), Person(script, 2)
    one.open()
    two.call(CONNECT, *map(text, ("Mine", "", "", "")), gives=2)
    one.call(EXECUTE, i4(2), text("slvMove"), i4(0))
    two.call(EXECUTE, i4(2), text("slvMove"), i4(0))
    script.seen.sort(key=lambda observation: observation.time)
    handles = HandleTracker()
    calls = [call for call in calls_of(script.track()) if call.kind.function_id == EXECUTE]
    for call in calls_of(script.track()):
        thing = handles.on_call(call)
        if call.number in {call.number for call in calls}:
            expected = "Arm" if call.conversation is one.client.conversation else None
            assert (thing.label if thing else None) == expected


def test_a_capture_that_begins_in_the_middle() -> None:
    script = Script()
    person = Person(script)
    person.call(EXECUTE, i4(2), text("slvMove"), i4(0))
    person.call(ROBOT_RELEASE, i4(2))
    labels, sessions = follow(script)
    assert labels == [None, None]
    assert sessions == ()
    person.call(SERVICE_STOP)
    _, (session,) = follow(script)
    assert (session.started_by_call, session.ending, session.is_clean) == (None, SessionEnding.STOPPED, True)


def test_names_are_optional() -> None:
    script = Script()
    person = Person(script)
    person.call(CONNECT, *map(text, ("", "", "", "")), gives=1)
    person.call(GET_MESSAGE, i4(1), gives=2)
    person.call(CONNECT, gives=3)
    person.call(CONNECT, i4(7), gives=4)
    _, (session,) = follow(script)
    assert left(session) == ["Controller 1", "Message 2", "Controller 3", "Controller 4"]


def test_what_the_client_never_heard_of_is_left() -> None:
    script = Script()
    client = script.client()
    client.ask(0, 1, 1, (CONNECT, (text("RC8"),)))
    client.reply(1, 1, 0, 0, i4(1))
    get_robot = (GET_ROBOT, (i4(1), text("Arm"), text("")))
    client.ask(2, 2, 2, get_robot)
    client.ask(22, 3, 2, get_robot)
    client.ask(42, 4, 2, get_robot)
    client.reply(43, 4, 0, 0, i4(4))
    client.ask(50, 5, 5, (EXECUTE, (i4(4), text("slvMove"), i4(0))))
    labels, (session,) = follow(script)
    assert labels == [None, "RC8", "Arm"]
    assert [(thing.handle, thing.known_to_client) for thing in session.unreleased] == [
        (2, False),
        (3, False),
        (1, True),
        (4, True),
    ]


def test_a_handle_that_came_late_and_is_used_all_the_same() -> None:
    script = Script()
    client = script.client()
    client.ask(0, 1, 1, (CONNECT, (text("RC8"),)))
    client.ask(20, 2, 2, (GET_VALUE, (i4(9),)))
    client.reply(30, 1, 0, 0, i4(1))
    client.ask(40, 3, 3, (DISCONNECT, (i4(1),)))
    labels, (session,) = follow(script)
    assert labels == [None, None, "RC8"]
    assert [(thing.handle, thing.known_to_client) for thing in session.unreleased] == [(1, True)]


def test_functions_that_are_none_are_left_alone() -> None:
    script = Script()
    Person(script).call(4000, i4(1))
    assert follow(script) == ([None], ())


@pytest.mark.parametrize(
    ("request_frame", "expected"),
    [
        (Frame(encode_frame(1, 0, 64, [i4(7)])), 7),
        (Frame(encode_frame(1, 0, 64, [i4(-7)])), -7),
        (Frame(encode_frame(1, 0, 64, [Variant(VT.UI4, 7)])), 7),
        (Frame(encode_frame(1, 0, 64, [Variant(VT.I2, 7)])), 7),
        (Frame(encode_frame(1, 0, 64, [text("7")])), None),
        (Frame(encode_frame(1, 0, 64, [Variant(VT.BOOL, True)])), None),
        (Frame(encode_frame(1, 0, 64, [])), None),
        (Frame(encode_frame(1, 0, 64, [i4(0x01020304)])), 0x01020304),
        (Frame(encode_frame(1, 0, 64, [i4(7)])[:27]), None),
        (Frame(encode_frame(1, 0, 64, [i4(0x04000007)])[:29]), None),
        (Frame(encode_frame(9, 1, 64, [i4(7), text("a" * 40)], Framing.VERSION_1_ZLIB)), 7),
    ],
)
def test_the_handle_of_a_request(request_frame: Frame, expected: int | None) -> None:
    assert handle_of(request_frame) == expected


def test_objects_are_bounded() -> None:
    script = Script()
    person = Person(script)
    person.call(CONNECT, text("RC8"), gives=1)
    for handle in range(2, MAX_OBJECTS + 10):
        person.call(GET_VARIABLE, i4(1), text(f"I{handle}"), text(""), gives=handle)
    _, (session,) = follow(script)
    assert len(session.unreleased) == MAX_OBJECTS
    assert session.unreleased[-1].label == f"I{MAX_OBJECTS + 9}"


def test_sessions_are_bounded() -> None:
    script = Script()
    person = Person(script)
    for _ in range(MAX_SESSIONS + 5):
        person.call(SERVICE_START, text(""))
        person.call(SERVICE_STOP)
    _, sessions = follow(script)
    assert len(sessions) == MAX_SESSIONS


def test_clients_are_bounded_and_the_silent_one_is_told_first() -> None:
    script = Script()
    Person(script, 0).call(SERVICE_STOP)
    for port in range(1, MAX_CONVERSATIONS + 3):
        person = Person(script, port)
        person.ms = 100.0 * port
        person.call(CONNECT, text(f"{port}"), gives=1)
    _, (stopped, *sessions) = follow(script)
    assert stopped.is_clean
    handles = HandleTracker(max_ended=0)
    for call in calls_of(script.track()):
        handles.on_call(call)
    assert len(handles.sessions()) == MAX_CONVERSATIONS
    assert [left(session) for session in sessions] == [
        [f"{port}"] for port in range(1, MAX_CONVERSATIONS + 3)
    ]


def test_a_release_whose_reply_may_be_missing_counts() -> None:
    script = Script()
    person = Person(script)
    person.open()
    person.client.ask(100, 50, 50, (ROBOT_RELEASE, (i4(2),)))
    person.client.see(101, Direction.RESPONSE, Malformed(b"", (), 44))
    _, (session,) = follow(script)
    assert left(session) == ["RC8"]


def test_a_client_that_is_gone_is_forgotten_with_its_objects() -> None:
    script = Script()
    person = Person(script, 1)
    person.call(CONNECT, text("one"), gives=1)
    (call,) = calls_of(script.track())
    for most, ended in ((0, []), (1, [SessionEnding.OPEN])):
        handles = HandleTracker(max_ended=most)
        handles.on_call(call)
        handles.close_conversation(call.conversation)
        assert [session.ending for session in handles.sessions()] == ended
        handles.close_conversation(call.conversation)
