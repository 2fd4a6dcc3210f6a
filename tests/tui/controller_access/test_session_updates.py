"""The Tester's status after each call."""

from __future__ import annotations

import pytest

from bcapscope.client.controller_target import ControllerTarget
from bcapscope.client.handle_table import ObjectHandle
from bcapscope.live.controller.history_record import HistoryRecord, Initiator, RecordOutcome
from bcapscope.live.controller.session_updates import SessionStatus
from bcapscope.protocol.codec.frame import Frame, encode_frame
from bcapscope.protocol.codec.variant import EMPTY, VT, Variant
from bcapscope.protocol.tables.function_table import ObjectClass
from bcapscope.protocol.tables.hresult import E_INVALIDARG, E_NOT_IN_SLAVE_MODE, S_OK

ROBOT = ObjectHandle(ObjectClass.ROBOT, 2, ("Arm", ""), None)
STATUS = SessionStatus(ControllerTarget("10.0.0.1"), open_objects=(ROBOT,), robot=ROBOT, round_trip=7)
ROBOT_EXECUTE = 64
LEVEL_4_ERROR = 0x84200106


def robot_call(command: str, parameter: Variant = EMPTY, code: int | None = S_OK) -> HistoryRecord:
    """Return the record of a command; without a result code it was not answered."""
    outcome = RecordOutcome.UNANSWERED
    if code is not None:
        outcome = RecordOutcome.REFUSED if code & 0x80000000 else RecordOutcome.ANSWERED
    reply = None if code is None else Frame(encode_frame(1, 0, code, ()))
    arguments = (Variant(VT.I4, 2), Variant(VT.BSTR, command), parameter)
    return HistoryRecord(1, Initiator.USER, 0, ROBOT_EXECUTE, arguments, outcome, reply, 9, (), ())


def after(status: SessionStatus, record: HistoryRecord) -> SessionStatus:
    return status.after_call(record, status.open_objects)


def test_a_robot_that_is_released_is_no_longer_selected() -> None:
    assert STATUS.after_call(robot_call("CurJnt"), (ROBOT,)).robot == ROBOT
    left = STATUS.after_call(robot_call("CurJnt"), ())
    assert (left.robot, left.open_objects) == (None, ())


def test_only_a_reply_has_a_round_trip() -> None:
    assert after(STATUS, robot_call("CurJnt")).round_trip == 9
    assert after(STATUS, robot_call("CurJnt", code=E_INVALIDARG)).round_trip == 9
    assert after(STATUS, robot_call("CurJnt", code=None)) == STATUS


def test_who_holds_the_arm() -> None:
    refused = after(STATUS, robot_call("TakeArm", code=E_INVALIDARG))
    held = after(refused, robot_call("TakeArm"))
    assert (refused.holds_arm, held.holds_arm) == (False, True)
    assert after(held, robot_call("CurJnt")).holds_arm
    assert after(held, robot_call("GiveArm", code=None)).holds_arm
    assert not after(held, robot_call("GiveArm")).holds_arm


@pytest.mark.parametrize(
    ("command", "code", "mode"),
    [
        ("slvMove", S_OK, 2),
        ("slvMove", None, 2),
        ("slvMove", E_INVALIDARG, 2),
        ("slvMove", E_NOT_IN_SLAVE_MODE, 0),
        ("slvMove", LEVEL_4_ERROR, 0),
        ("slvChangeMode", E_INVALIDARG, 2),
        ("slvChangeMode", S_OK, 0),
    ],
)
def test_what_ends_slave_mode(command: str, code: int | None, mode: int) -> None:
    in_slave_mode = after(STATUS, robot_call("slvChangeMode", Variant(VT.I4, 2)))
    assert in_slave_mode.slave_mode == 2
    assert after(in_slave_mode, robot_call(command, Variant(VT.I4, 0), code)).slave_mode == mode
