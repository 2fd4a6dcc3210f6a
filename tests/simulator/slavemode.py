"""A client in slave mode."""

from __future__ import annotations

from bcapscope.protocol.codec.variant import Variant
from bcapscope.simulator.argument_values import i4
from tests.simulator.simulation import Operator, Simulation

HOME = (0.0, 0.0, 90.0, 0.0, 90.0, 0.0)
UNDERFLOW, OVERFLOW, OUTSIDE, REFUSED = 0x84201482, 0x83201483, 0x83500121, 0x83501032
FULL = 0x0F200501


def started(profile: str = "rc8", mode: int | None = None) -> Operator:
    """An operator in slave mode, by joints; the mode that waits unless another is asked for."""
    operator = Operator(Simulation(profile))
    operator.ready()
    chosen = mode if mode is not None else 0x002 if profile == "rc7" else 0x202
    assert operator.slave(chosen).hresult == 0
    return operator


def send(operator: Operator, first: float) -> int:
    """Send a set point whose J1 is `first` degrees away from home; return the result."""
    return operator.point(first, *HOME[1:]).hresult


def current_errors(operator: Operator) -> list[int]:
    """Read the current errors as clients do, the newest first."""
    count = operator.command("GetCurErrorCount").value
    assert isinstance(count, int)
    found = []
    for index in range(count):
        info = operator.command("GetCurErrorInfo", i4(index)).value
        assert isinstance(info, tuple)
        assert isinstance(info[0], Variant)
        assert isinstance(info[0].value, int)
        found.append(info[0].value & 0xFFFFFFFF)
    newest = operator.read("@ERROR_CODE").value
    assert isinstance(newest, int)
    assert newest & 0xFFFFFFFF == (found[0] if found else 0)
    return found
