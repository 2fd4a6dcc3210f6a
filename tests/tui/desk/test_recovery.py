"""What one wants back after an error."""

from __future__ import annotations

from bcapscope.protocol.variant import VT, Variant
from bcapscope.tui.desk.record import Ending, Record, Who
from bcapscope.tui.desk.recovery import LastStay

ROBOT_EXECUTE = 64


def call(command: str, *values: Variant, ending: Ending = Ending.ANSWERED) -> Record:
    arguments = (Variant(VT.I4, 1), Variant(VT.BSTR, command), *values)
    return Record(1, Who.USER, 0, ROBOT_EXECUTE, arguments, ending, None, 0, (), ())


def joints(*values: float) -> Variant:
    return Variant.array(VT.R8, values)


def test_the_mode_and_its_first_set_point_are_kept() -> None:
    stay = LastStay()
    assert (stay.mode, stay.position) == (2, "")
    stay.take(call("slvGetMode"))
    stay.take(call("slvChangeMode", Variant(VT.I2, 0x102)))
    assert (stay.mode, stay.position) == (0x102, "")
    stay.take(call("slvMove", joints(9, 9, 9), ending=Ending.REFUSED))
    stay.take(call("SLVMOVE", joints(1, 2, 3)))
    stay.take(call("slvMove", joints(4, 5, 6)))
    assert stay.position == "@E J(1.00000,2.00000,3.00000)"
    stay.take(call("slvChangeMode", Variant(VT.I2, 0)))
    assert (stay.mode, stay.position) == (0x102, "@E J(1.00000,2.00000,3.00000)")
    stay.take(call("slvChangeMode", Variant(VT.I4, 1)))
    assert (stay.mode, stay.position) == (1, "")
