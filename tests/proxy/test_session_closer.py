"""What clients left open is given back, and nothing else is done."""

from __future__ import annotations

import pytest

from bcapscope.protocol.codec.frame import Frame, encode_frame
from bcapscope.protocol.codec.variant import EMPTY, VT, Variant
from bcapscope.protocol.retry.reserved_convention import ReservedConvention
from bcapscope.protocol.tables.function_table import function_by_name
from bcapscope.proxy.session_closer import SessionCloser
from bcapscope.traffic.handle_tracker import HandleTracker
from bcapscope.traffic.observation import (
    SERVER_PORT,
    Conversation,
    Direction,
    Endpoint,
    Flow,
    Observation,
    Transport,
)
from bcapscope.traffic.pipeline import Pipeline
from bcapscope.traffic.slave_mode_tracker import SlaveModeTracker
from tests.english import english


class Session:
    """Makes calls and answers them."""

    def __init__(self, transport: Transport = Transport.UDP, own: bool = False) -> None:
        self.conversation = Conversation(Endpoint("a", 1), Endpoint("b", 2), transport, SERVER_PORT)
        handles, self.slave_mode = HandleTracker(), SlaveModeTracker()
        self.closer = SessionCloser(handles, self.slave_mode)
        self.pipeline = Pipeline(self.closer, handles=handles, slave_mode=self.slave_mode)
        self._serial = self._time = self._number = 0
        self._own = own

    def call(self, name: str, *arguments: Variant, code: int = 0, result: int | None = None) -> None:
        function = function_by_name(name)
        assert function is not None
        self._serial += 1
        first = self._serial if self._own else 0
        self._see(Direction.REQUEST, encode_frame(self._serial, first, function.id, arguments))
        answer = () if result is None else (Variant(VT.I4, result),)
        self._see(Direction.RESPONSE, encode_frame(self._serial, first, code, answer))

    def _see(self, direction: Direction, raw: bytes) -> None:
        self._time += 1_000_000
        self._number += 1
        flow = Flow(self.conversation, direction)
        self.pipeline.add(Observation(self._number, self._time, self._time, flow, Frame(raw), 0))

    def begin(self) -> None:
        """Get a robot with handle 5."""
        self.call("Service_Start", Variant(VT.BSTR, ""))
        text = Variant(VT.BSTR, "")
        self.call("Controller_Connect", text, text, text, text, result=3)
        self.call("Controller_GetRobot", Variant(VT.I4, 3), Variant(VT.BSTR, "Arm"), text, result=5)

    def execute(self, command: str, parameter: Variant = EMPTY, code: int = 0) -> None:
        self.call("Robot_Execute", Variant(VT.I4, 5), Variant(VT.BSTR, command), parameter, code=code)

    def settle(self) -> None:
        """Let all calls settle."""
        self._time += 10**10
        self.pipeline.expire(self._time)

    def ends(self) -> list[tuple[str, int, int, tuple[object, ...]]]:
        """Return of each frame that would be sent: function id as text, serial, reserved, arguments."""
        self.settle()
        found: list[tuple[str, int, int, tuple[object, ...]]] = []
        for sequence in self.closer.close_sequences():
            for raw in sequence.requests:
                frame = Frame(raw)
                assert frame.problems == ()
                values = tuple(argument.variant.value for argument in frame.arguments)
                found.append((str(frame.code), frame.serial, frame.reserved, values))
        return found


def test_everything_is_given_back_newest_first() -> None:
    session = Session()
    session.begin()
    session.execute("TakeArm")
    session.execute("slvChangeMode", Variant(VT.I4, 0x102))
    session.execute("slvMove")
    assert session.ends() == [
        ("64", 7, 0, (5, "slvChangeMode", 0)),
        ("64", 8, 0, (5, "GiveArm", None)),
        ("84", 9, 0, (5,)),
        ("4", 10, 0, (3,)),
        ("2", 11, 0, ()),
    ]
    state = session.closer.close_sequences()[0].open_state
    assert english(state) == "slave mode is on and the arm is held"


def test_serials_continue_after_the_last_of_many_set_points() -> None:
    session = Session()
    session.begin()
    session.execute("slvChangeMode", Variant(VT.I4, 0x102))
    for _ in range(6):
        session.execute("slvMove", Variant(VT.R8 | 0x2000, (0.0,) * 6, 6))
    assert [serial for _, serial, *_ in session.ends()] == [11, 12, 13, 14]


def test_the_clients_convention_is_kept() -> None:
    session = Session(own=True)
    session.begin()
    assert [(serial, reserved) for _, serial, reserved, _ in session.ends()] == [(4, 4), (5, 5), (6, 6)]
    assert session.closer._last_calls[session.conversation].convention is ReservedConvention.OWN


def test_what_was_given_back_is_not_given_back_again() -> None:
    session = Session()
    session.begin()
    session.execute("TakeArm")
    session.execute("slvChangeMode", Variant(VT.I4 | 0x2000, (0x102,), 1))
    session.execute("SLVCHANGEMODE", Variant(VT.I4, 0))
    session.execute("GiveArm")
    session.call("Robot_Release", Variant(VT.I4, 5))
    assert [name for name, *_ in session.ends()] == ["4", "2"]


def test_what_was_refused_is_not_open() -> None:
    session = Session()
    session.begin()
    session.execute("TakeArm", code=0x80004005)
    session.execute("slvChangeMode", Variant(VT.I4, 0x102), code=0x80004005)
    assert [name for name, *_ in session.ends()] == ["84", "4", "2"]
    assert session.closer.close_sequences()[0].open_state is None


@pytest.mark.parametrize("transport", list(Transport)[:2])
def test_who_has_left_or_is_on_tcp_is_let_alone(transport: Transport) -> None:
    session = Session(transport)
    session.begin()
    if transport is Transport.UDP:
        session.call("Service_Stop")
    assert session.ends() == []


def test_who_is_gone_is_forgotten() -> None:
    session = Session()
    session.begin()
    session.execute("TakeArm")
    session.ends()
    session.pipeline.close_conversation(session.conversation)
    assert english(session.closer.pop_left_open(session.conversation)) == "the arm is held"
    assert session.closer.pop_left_open(session.conversation) is None
    assert session.ends() == []


def test_who_is_in_slave_mode_and_whose_set_points_are_accepted() -> None:
    session = Session()
    session.begin()
    session.execute("slvChangeMode", Variant(VT.I4, 0x102))
    session.execute("slvMove")
    session.settle()
    assert list(session.slave_mode.clients_in_slave_mode()) == [session.conversation]
    session.execute("slvMove", code=0x84201482)
    session.settle()
    assert list(session.slave_mode.clients_in_slave_mode()) == []
    session.execute("slvChangeMode", Variant(VT.I4, 0x102))
    session.settle()
    assert list(session.slave_mode.clients_in_slave_mode()) == [session.conversation]
    session.execute("slvChangeMode", Variant(VT.I4, 0))
    session.settle()
    assert list(session.slave_mode.clients_in_slave_mode()) == []
