"""What one wants back after an error."""

from __future__ import annotations

from bcapscope.live.controller.error_recovery import LastSlaveSession
from bcapscope.live.controller.history_record import HistoryRecord, Initiator, RecordOutcome
from bcapscope.protocol.codec.variant import VT, Variant

ROBOT_EXECUTE = 64


def call(command: str, *values: Variant, ending: RecordOutcome = RecordOutcome.ANSWERED) -> HistoryRecord:
    arguments = (Variant(VT.I4, 1), Variant(VT.BSTR, command), *values)
    return HistoryRecord(1, Initiator.USER, 0, ROBOT_EXECUTE, arguments, ending, None, 0, (), ())


def joints(*values: float) -> Variant:
    return Variant.array(VT.R8, values)


def test_the_mode_and_its_first_set_point_are_kept() -> None:
    stay = LastSlaveSession()
    assert (stay.mode, stay.move_position) == (2, "")
    stay.on_record(call("slvGetMode"))
    stay.on_record(call("slvChangeMode", Variant(VT.I2, 0x102)))
    assert (stay.mode, stay.move_position) == (0x102, "")
    stay.on_record(call("slvMove", joints(9, 9, 9), ending=RecordOutcome.REFUSED))
    stay.on_record(call("SLVMOVE", joints(1, 2, 3)))
    stay.on_record(call("slvMove", joints(4, 5, 6)))
    assert stay.move_position == "@E J(1.00000,2.00000,3.00000)"
    stay.on_record(call("slvChangeMode", Variant(VT.I2, 0)))
    assert (stay.mode, stay.move_position) == (0x102, "@E J(1.00000,2.00000,3.00000)")
    stay.on_record(call("slvChangeMode", Variant(VT.I4, 1)))
    assert (stay.mode, stay.move_position) == (1, "")
